//! Checkpoints in a run's folder: the latest and the one before it.

use std::{fs, io, path::Path};

use render::{camera::Projection, image::Image};
use tempfile::NamedTempFile;

use super::{Checkpoint, CheckpointError, codec};
use crate::{
    capture::Capture,
    files::{atomic, read_limited},
};

const LATEST: &str = "checkpoint.bin";
const PREVIOUS: &str = "checkpoint.prev.bin";
/// Largest checkpoint that is read, in bytes.
const MAX_FILE: u64 = 1 << 32;

/// Writes `folder/checkpoint.bin` whole or not at all, keeping its predecessor as `checkpoint.prev.bin` where that is whole.
///
/// At any moment one of the two is whole, once one has been.
///
/// # Errors
/// [`CheckpointError::Io`]; whatever was there before is untouched then.
pub fn save(folder: &Path, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
    let path = folder.join(LATEST);
    let staged = begin(folder, checkpoint)?;
    atomic::persist(staged, &path).map_err(|error| unwritten(&path, error))
}

/// All of [`save`] but its last step, at which the new checkpoint takes the place of the latest.
fn begin(folder: &Path, checkpoint: &Checkpoint) -> Result<NamedTempFile, CheckpointError> {
    let path = folder.join(LATEST);
    // A damaged one must not take the place of its predecessor, by which the run went on.
    let keep = read_limited(&path, MAX_FILE).is_ok_and(|bytes| is_good(&bytes));
    let bytes = codec::encode(checkpoint);
    let staged = atomic::stage(&path, |file| io::Write::write_all(file, &bytes))
        .map_err(|error| unwritten(&path, error))?;
    if keep {
        fs::rename(&path, folder.join(PREVIOUS)).map_err(|error| unwritten(&path, error))?;
    }
    Ok(staged)
}

/// Whether a run can go on from these bytes, with this program or with another.
fn is_good(bytes: &[u8]) -> bool {
    matches!(
        codec::decode(bytes),
        Ok(_) | Err(CheckpointError::Version { .. })
    )
}

fn unwritten(path: &Path, source: io::Error) -> CheckpointError {
    CheckpointError::Io {
        action: "write",
        path: path.to_owned(),
        source,
    }
}

/// Whether a run has left a checkpoint in `folder`, good or not.
pub fn is_in(folder: &Path) -> bool {
    [LATEST, PREVIOUS]
        .iter()
        .any(|name| folder.join(name).is_file())
}

/// Whether the run in `folder` was one of this capture; `None` where it left no good checkpoint.
pub fn is_of(folder: &Path, capture: &Capture) -> Option<bool> {
    let begun = load(folder).ok()?;
    Some(begun.capture == fingerprint(capture))
}

/// Reads the latest checkpoint of `folder`, or its predecessor when the latest is missing or damaged.
///
/// # Errors
/// [`CheckpointError::Missing`] when there is none, [`CheckpointError::Unreadable`] or
/// [`CheckpointError::BothUnreadable`] when they are damaged,
/// [`CheckpointError::Version`] when the latest is whole and of another format.
pub fn load(folder: &Path) -> Result<Checkpoint, CheckpointError> {
    let latest = match read(folder, LATEST) {
        Ok(checkpoint) => return Ok(checkpoint),
        Err(error @ CheckpointError::Version { .. }) => return Err(error),
        Err(error) => error,
    };
    read(folder, PREVIOUS).map_err(|previous| match (&latest, &previous) {
        (CheckpointError::Missing { .. }, _) | (_, CheckpointError::Version { .. }) => previous,
        (_, CheckpointError::Missing { .. }) => CheckpointError::Unreadable {
            path: folder.to_owned(),
            latest: Box::new(latest),
        },
        _ => CheckpointError::BothUnreadable {
            path: folder.to_owned(),
            latest: Box::new(latest),
            previous: Box::new(previous),
        },
    })
}

/// Why a run in `folder` cannot go on from its latest checkpoint, but has to from the one before, if that is so. A latest one that is
/// missing is none that was lost: the run ended while one took the other's place.
pub fn passed_over(folder: &Path) -> Option<CheckpointError> {
    match read(folder, LATEST) {
        Err(CheckpointError::Missing { .. }) | Ok(_) => None,
        Err(damage) => read(folder, PREVIOUS).is_ok().then_some(damage),
    }
}

fn read(folder: &Path, name: &str) -> Result<Checkpoint, CheckpointError> {
    let path = folder.join(name);
    match read_limited(&path, MAX_FILE) {
        Ok(bytes) => codec::decode(&bytes),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(CheckpointError::Missing {
            path: folder.to_owned(),
        }),
        Err(source) => Err(CheckpointError::Io {
            action: "read",
            path,
            source,
        }),
    }
}

/// A number that changes with any pixel, mask, camera, lamp, vertex or normal of the capture, and not with where it lies on disk.
pub fn fingerprint(capture: &Capture) -> u64 {
    let mut bytes = Vec::new();
    let mut floats = |values: &[f32]| values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    let mut parts = Vec::new();
    for vector in capture.mesh.positions.iter().chain(&capture.mesh.normals) {
        floats(&vector.to_array());
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::settings::Settings;

    fn checkpoint(iteration: u64) -> Checkpoint {
        Checkpoint {
            settings: Settings::default(),
            capture: 7,
            iteration,
            seconds: 1.0,
            arrays: BTreeMap::new(),
        }
    }

    /// A folder with two checkpoints, the latest spoiled.
    fn spoiled(spoil: impl Fn(&mut Vec<u8>)) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &checkpoint(1)).unwrap();
        save(folder.path(), &checkpoint(2)).unwrap();
        let path = folder.path().join(LATEST);
        let mut bytes = fs::read(&path).unwrap();
        spoil(&mut bytes);
        fs::write(path, bytes).unwrap();
        folder
    }

    fn iteration(folder: &tempfile::TempDir) -> u64 {
        load(folder.path()).unwrap().iteration
    }

    #[test]
    fn a_run_that_went_on_from_the_predecessor_can_be_killed_at_any_moment() {
        let folder = spoiled(|bytes| bytes.truncate(40));
        assert_eq!(iteration(&folder), 1);
        let damage = passed_over(folder.path()).unwrap().to_string();
        assert!(damage.contains("damaged"), "{damage}");
        // Killed before the new one is in its place.
        drop(begin(folder.path(), &checkpoint(3)).unwrap());
        assert_eq!(iteration(&folder), 1);
        save(folder.path(), &checkpoint(3)).unwrap();
        assert_eq!(iteration(&folder), 3);
        assert!(passed_over(folder.path()).is_none());
        // A whole one is kept, and can be gone on from as well.
        drop(begin(folder.path(), &checkpoint(4)).unwrap());
        assert_eq!(iteration(&folder), 3);
        assert!(passed_over(folder.path()).is_none());
    }

    #[test]
    fn a_damaged_version_is_damage_and_another_one_is_refused() {
        let version = |version: u32| {
            move |bytes: &mut Vec<u8>| bytes[8..12].copy_from_slice(&version.to_le_bytes())
        };
        for damage in [0, 1 << 16, u32::MAX] {
            assert_eq!(iteration(&spoiled(version(damage))), 1);
        }
        let folder = spoiled(|bytes| {
            version(2)(bytes);
            bytes[30] ^= 1;
        });
        assert_eq!(iteration(&folder), 1);
        let refused = |folder: &tempfile::TempDir| {
            matches!(
                load(folder.path()),
                Err(CheckpointError::Version { found: 2, .. })
            )
        };
        let folder = spoiled(version(2));
        assert!(refused(&folder));
        // Also where only its predecessor is whole.
        fs::rename(folder.path().join(LATEST), folder.path().join(PREVIOUS)).unwrap();
        fs::write(folder.path().join(LATEST), "").unwrap();
        assert!(refused(&folder));
    }
}
