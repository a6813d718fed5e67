//! Where pictures go: EXR and PNG files, by numbers or names, in a folder of their own.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use render::image::Image;
use serde::{Deserialize, Serialize};

use super::{RelightError, views::plain};
use crate::{
    files::{atomic, claim, lock::Lock, read_limited},
    image_io::{ExrOptions, Precision, linear_to_srgb, write_exr_with, write_png8},
};

/// What tells a folder of pictures from others, and how they were made.
const RECORD: &str = "relight.json";
/// Largest record that is read, in bytes.
const MAX_RECORD: u64 = 1 << 26;
/// The files of a picture.
const EXTENSIONS: [&str; 2] = ["exr", "png"];

/// How pictures were made, written beside them.
#[derive(Clone, Debug, Serialize)]
pub struct Record {
    /// The folder of the reconstruction.
    pub object: PathBuf,
    /// The light's file, or the folder with a file for each picture.
    pub environment: PathBuf,
    /// Whether its directions are told in the axes of the world or of each camera.
    pub axes: &'static str,
    /// How the light was said to be laid out; `None` where its file had to tell.
    pub convention: Option<&'static str>,
    /// Stops of exposure.
    pub exposure: f32,
    /// Degrees by which the light was turned.
    pub rotate: f32,
    /// Whether the light is seen beside the object.
    pub backdrop: bool,
    /// Paths a pixel.
    pub samples: usize,
    /// Seed of the random numbers.
    pub seed: u64,
    /// The pictures, as their files are called but for the extension.
    pub pictures: Vec<String>,
    /// Camera to world of each picture, rows of 4 × 4, in the object's own frame.
    pub cameras: Vec<[[f32; 4]; 4]>,
}

/// A folder that holds pictures and nothing else.
pub struct Folder {
    path: PathBuf,
    _lock: Lock,
}

impl Folder {
    /// Makes the folder, or takes one of earlier pictures, which are removed: a record is of all pictures beside it, even when the
    /// run is interrupted.
    ///
    /// # Errors
    /// [`RelightError::Occupied`] when it holds anything else, so that nobody's photographs are written over.
    pub fn prepare(path: &Path, record: &Record) -> Result<Self, RelightError> {
        let failed = |source| RelightError::write(path, source);
        if !claim(path, RECORD).map_err(failed)? {
            return Err(RelightError::Occupied { path: path.into() });
        }
        let lock = Lock::acquire(path)?;
        let mut stale = Vec::new();
        for entry in fs::read_dir(path).map_err(failed)? {
            let entry = entry.map_err(failed)?.path();
            if is_picture(&entry) {
                stale.push(entry);
            }
        }
        stale.extend(recorded(path));
        for file in stale {
            match fs::remove_file(&file) {
                // Those with numbers are told by their names and in the record.
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(RelightError::write(&file, source));
                }
                _ => remove_empty_folders(&file, path),
            }
        }
        let text = serde_json::to_vec_pretty(record).map_err(|error| failed(error.into()))?;
        let written = atomic::write(&path.join(RECORD), |file| {
            io::Write::write_all(file, &[&text[..], b"\n"].concat())
        });
        written.map_err(failed)?;
        Ok(Self {
            path: path.into(),
            _lock: lock,
        })
    }

    /// Writes the picture `name`, one of the record's: EXR as it is, and PNG with the sRGB curve, its colours not multiplied by the
    /// coverage.
    ///
    /// # Errors
    /// A file or folder that cannot be written; a file is whole or not there.
    pub fn picture(&self, name: &str, picture: &Image) -> Result<(), RelightError> {
        let [exr, png] = files(&self.path, name);
        if let Some(parent) = exr.parent() {
            fs::create_dir_all(parent).map_err(|source| RelightError::write(parent, source))?;
        }
        let options = ExrOptions {
            precision: Precision::Float,
            ..Default::default()
        };
        write_exr_with(&exr, picture, &["R", "G", "B", "A"], &options)?;
        write_png8(&png, &shown(picture))?;
        Ok(())
    }
}

/// The files of the picture `name`; a dot in the name begins no extension.
fn files(folder: &Path, name: &str) -> [PathBuf; 2] {
    EXTENSIONS.map(|extension| folder.join(format!("{name}.{extension}")))
}

/// The files of an earlier record's pictures; none where there is no record, or none that can be read.
fn recorded(folder: &Path) -> Vec<PathBuf> {
    /// The part that matters here; earlier versions, which had numbers only, lack it.
    #[derive(Default, Deserialize)]
    struct Part {
        #[serde(default)]
        pictures: Vec<String>,
    }
    let bytes = read_limited(&folder.join(RECORD), MAX_RECORD).unwrap_or_default();
    let part: Part = serde_json::from_slice(&bytes).unwrap_or_default();
    // Whoever wrote the record: what lies outside the folder is not ours to remove.
    let names = part.pictures.iter().filter_map(|name| plain(name));
    names.flat_map(|name| files(folder, &name)).collect()
}

/// Removes the folders between `file`, which is gone, and `folder` that nothing is left in.
fn remove_empty_folders(file: &Path, folder: &Path) {
    let inner = file.ancestors().skip(1);
    let mut inner = inner.take_while(|parent| *parent != folder);
    // The first that cannot be removed is not empty, and no other around it.
    let _ = inner.try_for_each(fs::remove_dir);
}

/// Whether a file is a picture of ours, by its name: a number.
fn is_picture(path: &Path) -> bool {
    let stem = path.file_stem().and_then(|stem| stem.to_str());
    path.extension()
        .is_some_and(|extension| EXTENSIONS.iter().any(|own| extension == *own))
        && stem.is_some_and(|stem| stem.parse::<usize>().is_ok())
}

/// As PNG files hold pictures: colours of their own, and the share of the pixel that has them.
fn shown(picture: &Image) -> Image {
    let encoded = picture.data.chunks_exact(4).flat_map(|pixel| {
        let alpha = pixel[3];
        let color = |value: f32| {
            let straight = if alpha > 0.0 { value / alpha } else { 0.0 };
            linear_to_srgb(straight)
        };
        [color(pixel[0]), color(pixel[1]), color(pixel[2]), alpha]
    });
    Image {
        data: encoded.collect(),
        ..*picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of these pictures under one map.
    fn record(pictures: &[&str]) -> Record {
        Record {
            object: "run".into(),
            environment: "studio.exr".into(),
            axes: "world",
            convention: None,
            exposure: 0.0,
            rotate: 0.0,
            backdrop: false,
            samples: 1,
            seed: 0,
            pictures: pictures.iter().map(|name| (*name).to_owned()).collect(),
            cameras: vec![[[0.0; 4]; 4]; pictures.len()],
        }
    }

    #[test]
    fn pictures_of_another_light_are_gone_before_its_record_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut record = record(&["000", "001", "002"]);
        let pictures = ["000.exr", "000.png", "002.png"].map(|name| folder.path().join(name));
        drop(Folder::prepare(folder.path(), &record).unwrap());
        let other = folder.path().join("notes.txt");
        for path in pictures.iter().chain([&other]) {
            fs::write(path, "x").unwrap();
        }
        record.convention = Some("mitsuba");
        record.backdrop = true;
        drop(Folder::prepare(folder.path(), &record).unwrap());
        assert!(!pictures.iter().any(|path| path.exists()) && other.exists());
        let written = fs::read(folder.path().join(RECORD)).unwrap();
        let written: serde_json::Value = serde_json::from_slice(&written).unwrap();
        assert_eq!(written["convention"], "mitsuba");
        assert_eq!(written["backdrop"], true);
    }

    #[test]
    fn pictures_by_name_are_written_and_removed_with_their_folders_and_nothing_outside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("relit");
        let mut record = record(&["test/view.001", "../outside"]);
        let outside = folder.path().join("outside.png");
        fs::write(&outside, "x").unwrap();
        let written = Folder::prepare(&path, &record).unwrap();
        let picture = Image::filled(2, 1, 4, 0.5);
        written.picture("test/view.001", &picture).unwrap();
        drop(written);
        for name in ["test/view.001.exr", "test/view.001.png"] {
            assert!(path.join(name).is_file(), "{name}");
        }
        record.pictures = vec!["000".to_owned()];
        drop(Folder::prepare(&path, &record).unwrap());
        assert!(!path.join("test").exists() && outside.is_file());
    }

    #[test]
    fn half_covered_pixels_keep_their_colour_in_png() {
        let picture = Image {
            width: 2,
            height: 1,
            channels: 4,
            data: vec![0.25, 0.25, 0.25, 0.5, 0.0, 0.0, 0.0, 0.0],
        };
        let shown = shown(&picture);
        assert_eq!(shown.data[3], 0.5);
        assert!((shown.data[0] - linear_to_srgb(0.5)).abs() < 1e-6);
        assert_eq!(shown.data[4..], [0.0; 4]);
    }
}
