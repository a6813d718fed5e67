//! Checkpoints in a run's folder: the latest and the one before it.

use std::{fs, io, path::Path};

use render::{camera::Projection, image::Image};

use super::{Checkpoint, CheckpointError, codec};
use crate::{
    capture::Capture,
    files::{atomic, read_limited},
};

const LATEST: &str = "checkpoint.bin";
const PREVIOUS: &str = "checkpoint.prev.bin";
/// Largest checkpoint that is read, in bytes.
const MAX_FILE: u64 = 1 << 32;

/// Writes `folder/checkpoint.bin` whole or not at all, keeping its predecessor as `checkpoint.prev.bin`.
///
/// # Errors
/// [`CheckpointError::Io`]; whatever was there before is untouched then.
pub fn save(folder: &Path, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
    let path = folder.join(LATEST);
    let bytes = codec::encode(checkpoint);
    let failed = |source| CheckpointError::Io {
        action: "write",
        path: path.clone(),
        source,
    };
    let written =
        atomic::stage(&path, |file| io::Write::write_all(file, &bytes)).map_err(failed)?;
    match fs::rename(&path, folder.join(PREVIOUS)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed(error)),
        _ => written
            .persist(&path)
            .map_err(|error| failed(error.error))?,
    };
    Ok(())
}

/// Whether a run has left a checkpoint in `folder`, good or not.
pub fn is_in(folder: &Path) -> bool {
    [LATEST, PREVIOUS]
        .iter()
        .any(|name| folder.join(name).is_file())
}

/// Reads the latest checkpoint of `folder`, or its predecessor when the latest is missing or damaged.
///
/// # Errors
/// [`CheckpointError::Missing`] when there is none, [`CheckpointError::BothUnreadable`] when both are damaged.
pub fn load(folder: &Path) -> Result<Checkpoint, CheckpointError> {
    let read = |name: &str| {
        let path = folder.join(name);
        match read_limited(&path, MAX_FILE) {
            Ok(bytes) => codec::decode(&bytes),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                Err(CheckpointError::Missing {
                    path: folder.to_owned(),
                })
            }
            Err(source) => Err(CheckpointError::Io {
                action: "read",
                path,
                source,
            }),
        }
    };
    let latest = match read(LATEST) {
        Ok(checkpoint) => return Ok(checkpoint),
        Err(error @ CheckpointError::Version { .. }) => return Err(error),
        Err(error) => error,
    };
    read(PREVIOUS).map_err(|previous| match (&latest, &previous) {
        (CheckpointError::Missing { .. }, _) => previous,
        _ => CheckpointError::BothUnreadable {
            path: folder.to_owned(),
            latest: Box::new(latest),
            previous: Box::new(previous),
        },
    })
}

/// A number that changes with any pixel, mask, camera, lamp or vertex of the capture, and not with where it lies on disk.
pub fn fingerprint(capture: &Capture) -> u64 {
    let mut bytes = Vec::new();
    let mut floats = |values: &[f32]| values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    let mut parts = Vec::new();
    for position in &capture.mesh.positions {
        floats(&position.to_array());
    }
    floats(&capture.centre.to_array());
    for frame in &capture.frames {
        let camera = &frame.camera;
        floats(&[camera.width as f32, camera.height as f32]);
        // Perspective is what all cameras had before there was another projection: it adds nothing.
        if camera.projection == Projection::Orthographic {
            floats(&[1.0]);
        }
        floats(&camera.focal);
        floats(&camera.principal);
        floats(&camera.distortion);
        floats(&camera.world_from_camera.to_cols_array());
        parts.extend([pixels(&frame.image), pixels(&frame.mask)]);
    }
    for lamp in capture.lamps.iter().flat_map(|known| &known.lamps) {
        floats(&lamp.direction.to_array());
        floats(&lamp.strength);
    }
    for face in &capture.mesh.faces {
        face.iter()
            .for_each(|index| bytes.extend(index.to_le_bytes()));
    }
    parts
        .iter()
        .for_each(|part: &u64| bytes.extend(part.to_le_bytes()));
    codec::crc64(&bytes)
}

fn pixels(image: &Image) -> u64 {
    codec::crc64(bytemuck::cast_slice(&image.data))
}
