//! `transforms_train.json` beside `transforms_val.json` and `transforms_test.json`, as the synthetic NeRF scenes have them.
//!
//! The training photographs are the capture; the others are counted and left for whoever wants to test.

use super::{Format, Source, source};
use crate::capture::{
    CaptureError,
    paths::Folder,
    transforms::{count_frames, read_transforms},
};

pub(super) const FORMAT: Format = Format {
    name: "Blender's splits",
    sign: "transforms_train.json",
    leaves_folder_open: false,
    read,
};

fn read(folder: &Folder) -> Option<Result<Source, CaptureError>> {
    let path = folder.path().join("transforms_train.json");
    path.exists().then(|| {
        folder.check_own(&path)?;
        let transforms = read_transforms(&path)?;
        Ok(Source {
            left_out: frames_of(folder, ["transforms_val.json", "transforms_test.json"])?,
            ..source(&path, transforms)
        })
    })
}

/// How many frames these files have, as far as they are there: nothing else of them is used, so that nothing else must be right.
pub(super) fn frames_of(folder: &Folder, splits: [&str; 2]) -> Result<usize, CaptureError> {
    let paths = splits.map(|split| folder.path().join(split)).into_iter();
    let counts = paths.filter(|path| path.exists()).map(|path| {
        folder.check_own(&path)?;
        count_frames(&path)
    });
    counts.sum()
}
