//! A scene of Stanford-ORB's `blender_HDR` or `blender_LDR`: `transforms_{train,test,novel}.json`, photographs without alpha, and
//! their masks as `<folder>_mask/<name>.png`.

use std::path::Path;

use super::{Format, Source, blender_splits::frames_of, source};
use crate::{
    capture::{CaptureError, paths::Folder, transforms::read_transforms},
    files::slashed,
    image_io::stem,
};

pub(super) const FORMAT: Format = Format {
    name: "Stanford-ORB",
    sign: "transforms_train.json with train_mask",
    leaves_folder_open: false,
    read,
};

fn read(folder: &Folder) -> Option<Result<Source, CaptureError>> {
    let path = folder.path().join("transforms_train.json");
    let ours = path.exists() && folder.path().join("train_mask").is_dir();
    ours.then(|| {
        folder.check_own(&path)?;
        let mut transforms = read_transforms(&path)?;
        for frame in &mut transforms.frames {
            // One that is not there is an oversight: the error names the file.
            let mask = || mask_path(&frame.file_path);
            frame.mask_path = frame.mask_path.take().or_else(|| Some(mask()));
        }
        Ok(Source {
            left_out: frames_of(folder, ["transforms_test.json", "transforms_novel.json"])?,
            ..source(&path, transforms)
        })
    })
}

/// `train/0003` has its mask in `train_mask/0003.png`.
fn mask_path(file_path: &str) -> String {
    let path = slashed(file_path);
    let path = Path::new(stem(&path));
    let folder = path.parent().unwrap_or(Path::new("")).to_string_lossy();
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!("{folder}_mask/{name}.png")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_has_the_whole_name_of_its_photograph() {
        for (photograph, mask) in [
            ("train/0003", "train_mask/0003.png"),
            ("./train/0003.exr", "./train_mask/0003.png"),
            ("train\\view.001", "train_mask/view.001.png"),
        ] {
            assert_eq!(mask_path(photograph), mask);
        }
    }
}
