//! One `transforms.json`, as Blender/NeRF and nerfstudio write it; nerfstudio's splits keep frames for training.

use std::{collections::HashSet, path::Path};

use super::{Format, Source, source};
use crate::capture::{
    CaptureError,
    paths::Folder,
    transforms::{Transforms, read_transforms},
};

pub(super) const FORMAT: Format = Format {
    name: "Blender/NeRF or nerfstudio",
    sign: "transforms.json",
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
    let known: HashSet<&str> = transforms
        .frames
        .iter()
        .map(|frame| frame.file_path.as_str())
        .collect();
    let splits = [
        ("train_filenames", &transforms.train_filenames),
        ("val_filenames", &transforms.val_filenames),
        ("test_filenames", &transforms.test_filenames),
    ];
    for (field, names) in splits {
        let stray = names
            .iter()
            .flatten()
            .find(|name| !known.contains(name.as_str()));
        if let Some(name) = stray {
            return Err(CaptureError::Split {
                path: path.into(),
                field,
                name: name.clone(),
            });
        }
    }
    let set = |names: &Option<Vec<String>>| -> HashSet<String> {
        names.iter().flatten().cloned().collect()
    };
    match &transforms.train_filenames {
        Some(names) => {
            let kept: HashSet<String> = names.iter().cloned().collect();
            transforms
                .frames
                .retain(|frame| kept.contains(&frame.file_path));
        }
        None => {
            let (val, test) = (
                set(&transforms.val_filenames),
                set(&transforms.test_filenames),
            );
            transforms.frames.retain(|frame| {
                !val.contains(&frame.file_path) && !test.contains(&frame.file_path)
            });
        }
    }
    if transforms.frames.is_empty() {
        return Err(CaptureError::NoTraining { path: path.into() });
    }
    Ok(transforms)
}
