//! `transforms_train.json` beside `transforms_val.json` and `transforms_test.json`, as the synthetic NeRF scenes have them.
//!
//! The training photographs are the capture; the others are counted and left for whoever wants to test.

use super::{Format, Source, nerfstudio::read_file, source};
use crate::capture::{CaptureError, paths::Folder};

pub(super) const FORMAT: Format = Format {
    name: "Blender's splits",
    sign: "transforms_train.json",
    read,
};

fn read(folder: &Folder) -> Option<Result<Source, CaptureError>> {
    let path = folder.path().join("transforms_train.json");
    path.exists().then(|| {
        let transforms = read_file(&path)?;
        let mut left_out = 0;
        for split in ["transforms_val.json", "transforms_test.json"] {
            let path = folder.path().join(split);
            if path.exists() {
                left_out += read_file(&path)?.frames.len();
            }
        }
        Ok(Source {
            left_out,
            ..source(&path, transforms)
        })
    })
}
