//! What the photographs and cameras of a capture may be written as: a format a file, and one list.
//!
//! Every format is read into [`Transforms`], which all that follows works on.

mod blender_splits;
pub mod colmap;
mod nerfstudio;
mod stanford_orb;

use std::path::{Path, PathBuf};

use super::{CaptureError, paths::Folder, transforms::Transforms};

/// The photographs and cameras that a capture describes, before any image is read.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Source {
    /// The format it was written in.
    pub format: &'static str,
    /// The file that names the photographs.
    pub path: PathBuf,
    /// What it says.
    pub transforms: Transforms,
    /// Photographs that it keeps for validation and tests, which are left out.
    pub left_out: usize,
    /// COLMAP's `points3D`, where it is there.
    pub points: Option<PathBuf>,
}

/// One way to describe a capture.
struct Format {
    name: &'static str,
    /// The file that tells a capture of this format, for people.
    sign: &'static str,
    /// Reads it, where its sign is there.
    read: fn(&Folder) -> Option<Result<Source, CaptureError>>,
}

/// All formats, the first whose sign a folder has is taken: whoever converted a COLMAP model meant the result.
const FORMATS: [Format; 4] = [
    nerfstudio::FORMAT,
    stanford_orb::FORMAT,
    blender_splits::FORMAT,
    colmap::FORMAT,
];

/// Finds and reads what describes the capture in `folder`.
pub(super) fn read(folder: &Folder) -> Result<Source, CaptureError> {
    for format in FORMATS {
        if let Some(source) = (format.read)(folder) {
            return source.map(|source| Source {
                format: format.name,
                ..source
            });
        }
    }
    let signs = FORMATS.map(|format| format!("{} ({})", format.sign, format.name));
    Err(CaptureError::NoFormat {
        path: folder.path().into(),
        signs: signs.join(", "),
    })
}

/// The source in the file `path`, of which nothing else is known yet.
fn source(path: &Path, transforms: Transforms) -> Source {
    Source {
        format: "",
        path: path.into(),
        transforms,
        left_out: 0,
        points: None,
    }
}
