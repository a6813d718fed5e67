//! One `transforms.json`, as Blender/NeRF and nerfstudio write it; nerfstudio's splits keep frames for training.

use std::{
    collections::HashSet,
    path::{Component, Path, PathBuf},
};

use super::{Format, Source, source};
use crate::{
    capture::{
        CaptureError,
        paths::Folder,
        transforms::{Transforms, TransformsFrame, read_transforms},
    },
    files::slashed,
};

pub(super) const FORMAT: Format = Format {
    name: "Blender/NeRF or nerfstudio",
    sign: "transforms.json",
    leaves_folder_open: false,
    read,
};

fn read(folder: &Folder) -> Option<Result<Source, CaptureError>> {
    let path = folder.path().join("transforms.json");
    path.exists().then(|| {
        folder.check_own(&path)?;
        let transforms = read_transforms(&path)?;
        let all = transforms.frames.len();
        let transforms = training(transforms, &path)?;
        let points = transforms.ply_file_path.as_deref();
        Ok(Source {
            left_out: all - transforms.frames.len(),
            // What is not there, or not to be read, is told of where the mesh is looked for.
            points: points.and_then(|name| folder.ply(&path, name).ok()),
            ..source(&path, transforms)
        })
    })
}

/// Leaves the frames of `train_filenames`; without that, those of no other split.
fn training(mut transforms: Transforms, path: &Path) -> Result<Transforms, CaptureError> {
    let own = |frame: &TransformsFrame| plain(&frame.file_path);
    let known: HashSet<PathBuf> = transforms.frames.iter().map(own).collect();
    let split = |field: &'static str, names: &Option<Vec<String>>| {
        let mut split = HashSet::new();
        for name in names.iter().flatten() {
            let plain = plain(name);
            if !known.contains(&plain) {
                return Err(CaptureError::Split {
                    path: path.into(),
                    field,
                    name: name.clone(),
                });
            }
            split.insert(plain);
        }
        Ok(split)
    };
    let train = split("train_filenames", &transforms.train_filenames)?;
    let val = split("val_filenames", &transforms.val_filenames)?;
    let test = split("test_filenames", &transforms.test_filenames)?;
    let all_others = transforms.train_filenames.is_none();
    transforms.frames.retain(|frame| {
        let own = own(frame);
        match all_others {
            true => !val.contains(&own) && !test.contains(&own),
            false => train.contains(&own),
        }
    });
    if transforms.frames.is_empty() {
        return Err(CaptureError::NoTraining { path: path.into() });
    }
    Ok(transforms)
}

/// A path without needless dots: `./images/a.png` and `images/a.png` are one file.
fn plain(name: &str) -> PathBuf {
    let name = slashed(name);
    let parts = Path::new(&name).components();
    parts.filter(|part| *part != Component::CurDir).collect()
}
