//! What the photographs and cameras of a capture may be written as: a format a file, and one list.
//!
//! Every format is read into [`Transforms`], which all that follows works on.

mod blender_splits;
pub mod colmap;
mod nerfstudio;
mod stanford_orb;

use std::path::{Path, PathBuf};

use glam::Vec3;

use super::{CaptureError, paths::Folder, transforms::Transforms};
use crate::mesh_io::read_point_cloud;

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
    /// Sparse points in the axes of the files, where they are there: COLMAP's `points3D`, or what nerfstudio's `ply_file_path`
    /// names, which may be the mesh as well. See [`read_points`].
    pub points: Option<PathBuf>,
    /// The file of the object's shape, where one was found: what was asked for, or the capture's own.
    pub mesh: Option<PathBuf>,
    /// What was chosen where the capture leaves a choice, for whoever meant another: a sentence each.
    pub notes: Vec<String>,
    /// Other files of the capture that might be meant, and are not used.
    pub other_meshes: Vec<PathBuf>,
}

/// One way to describe a capture.
struct Format {
    name: &'static str,
    /// The file that tells a capture of this format, for people.
    sign: &'static str,
    /// Whether it names photographs without the folder that they lie in.
    leaves_folder_open: bool,
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
            let source = source?;
            return match folder.images() {
                Some(images) if !format.leaves_folder_open => Err(CaptureError::ImagesNamed {
                    path: source.path,
                    images: images.into(),
                }),
                _ => Ok(Source {
                    format: format.name,
                    ..source
                }),
            };
        }
    }
    let signs = FORMATS.map(|format| format!("{} ({})", format.sign, format.name));
    Err(CaptureError::NoFormat {
        path: folder.path().into(),
        signs: signs.join(", "),
    })
}

/// Reads the points of [`Source::points`]; `None` where the file is a mesh.
///
/// # Errors
/// A file that cannot be read, or understood.
pub fn read_points(path: &Path) -> Result<Option<Vec<Vec3>>, CaptureError> {
    match path
        .extension()
        .is_some_and(|own| own.eq_ignore_ascii_case("ply"))
    {
        true => Ok(read_point_cloud(path)?),
        false => colmap::read_points(path).map(Some),
    }
}

/// The source in the file `path`, of which nothing else is known yet.
fn source(path: &Path, transforms: Transforms) -> Source {
    Source {
        format: "",
        path: path.into(),
        transforms,
        left_out: 0,
        points: None,
        mesh: None,
        notes: Vec::new(),
        other_meshes: Vec::new(),
    }
}
