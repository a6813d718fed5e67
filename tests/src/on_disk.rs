//! Captures on disk, to be changed by hand before they are read.

use std::{fs, path::PathBuf};

use eclipse::capture::{Capture, LoadOptions, write};
use glam::Vec3;
use render::image::Image;
use serde_json::Value;
use tempfile::TempDir;

use crate::small_capture::small_capture;

/// A written capture and its `transforms.json`.
pub fn written(centre: Vec3) -> (TempDir, Capture, Value) {
    let folder = tempfile::tempdir().unwrap();
    let capture = small_capture(centre);
    write(&folder.path().join("capture"), &capture).unwrap();
    let folder_path = folder.path().join("capture");
    let json =
        serde_json::from_slice(&fs::read(folder_path.join("transforms.json")).unwrap()).unwrap();
    (folder, capture, json)
}

/// Writes its `transforms.json` again.
pub fn save(folder: &TempDir, json: &Value) {
    fs::write(
        folder.path().join("capture/transforms.json"),
        json.to_string(),
    )
    .unwrap();
}

/// The capture in a folder.
pub fn load(folder: &TempDir) -> Capture {
    Capture::load(&folder.path().join("capture"), &LoadOptions::default())
        .unwrap_or_else(|error| panic!("{error}"))
}

/// A written capture to be spoiled.
pub struct Spoiled {
    _folder: TempDir,
    /// Its folder.
    pub path: PathBuf,
    /// Its `transforms.json`, which [`Spoiled::says`] writes.
    pub json: Value,
}

impl Spoiled {
    /// One that nothing is wrong with yet.
    pub fn fresh() -> Self {
        let (folder, _, json) = written(Vec3::new(0.5, 0.0, 0.0));
        Self {
            path: folder.path().join("capture"),
            _folder: folder,
            json,
        }
    }

    /// The message, which must hold all `parts`.
    #[track_caller]
    pub fn says(&self, parts: &[&str]) {
        fs::write(self.path.join("transforms.json"), self.json.to_string()).unwrap();
        self.load_says(parts);
    }

    /// The same of the files as they are.
    #[track_caller]
    pub fn load_says(&self, parts: &[&str]) {
        let message = match Capture::load(&self.path, &LoadOptions::default()) {
            Ok(_) => panic!("loaded, where {parts:?} was expected"),
            Err(error) => error.to_string(),
        };
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in {message:?}");
        }
        // What is wrong with several frames is a list.
        let listed = message.contains(" frames cannot be used:\n");
        assert!(listed || !message.contains('\n'), "one line: {message}");
    }
}

/// The message after `spoil` changed `transforms.json`.
#[track_caller]
pub fn json_says(spoil: impl Fn(&mut Value), parts: &[&str]) {
    let mut capture = Spoiled::fresh();
    spoil(&mut capture.json);
    capture.says(parts);
}

/// The message after `spoil` changed the files of the capture.
#[track_caller]
pub fn files_say(spoil: impl Fn(&PathBuf), parts: &[&str]) {
    let capture = Spoiled::fresh();
    spoil(&capture.path);
    capture.load_says(parts);
}

/// An image of nothing but 0.5.
pub fn grey(width: usize, height: usize, channels: usize) -> Image {
    Image::filled(width, height, channels, 0.5)
}
