//! Where the files of a capture lie.

use std::path::{Path, PathBuf};

use super::{CaptureError, transforms::Transforms};

/// Image extensions that are tried for a `file_path` without one.
const EXTENSIONS: [&str; 10] = [
    "exr", "hdr", "png", "jpg", "jpeg", "EXR", "HDR", "PNG", "JPG", "JPEG",
];

/// A capture's folder.
pub(super) struct Folder {
    path: PathBuf,
    canonical: PathBuf,
    allow_outside: bool,
}

impl Folder {
    pub fn new(path: &Path, allow_outside: bool) -> Result<Self, CaptureError> {
        let canonical = path.canonicalize().map_err(|source| CaptureError::Read {
            path: path.into(),
            source,
        })?;
        Ok(Self {
            path: path.into(),
            canonical,
            allow_outside,
        })
    }

    /// The image that `name`, of a frame's `field`, stands for.
    pub fn image(
        &self,
        frame: &str,
        field: &'static str,
        name: &str,
    ) -> Result<PathBuf, CaptureError> {
        let path = self.join(name);
        let Some(found) = find(&path) else {
            let known = path
                .extension()
                .is_some_and(|own| EXTENSIONS.iter().any(|extension| *extension == own));
            let hint = if known {
                String::new()
            } else {
                ", nor with .exr, .hdr, .png, .jpg or .jpeg added".into()
            };
            return Err(CaptureError::Missing {
                frame: frame.into(),
                field,
                path,
                hint,
            });
        };
        self.check(field, found)
    }

    /// Whether `name` stands for an image that is there.
    pub fn has_image(&self, name: &str) -> bool {
        find(&self.join(name)).is_some()
    }

    /// Refuses a file by which the folder is told to be a capture, `path` within it, that is a link out of it.
    ///
    /// One that is not there is for its reader to tell of.
    pub fn check_own(&self, path: &Path) -> Result<(), CaptureError> {
        match path.canonicalize() {
            Ok(canonical) if !self.holds(&canonical) => {
                Err(CaptureError::Linked { path: path.into() })
            }
            _ => Ok(()),
        }
    }

    /// The folder, as the user named it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The mesh: the one asked for, else one in the folder, else the one that `transforms.json` names.
    pub fn mesh(
        &self,
        asked: Option<&Path>,
        transforms: &Transforms,
    ) -> Result<PathBuf, CaptureError> {
        if let Some(path) = asked {
            // Named by the user, not by the capture: it may lie anywhere.
            return Ok(path.into());
        }
        let own =
            ["mesh.glb", "mesh.gltf", "mesh.obj", "mesh.ply"].map(|name| self.path.join(name));
        if let Some(path) = own.into_iter().find(|path| path.exists()) {
            return self.check("mesh", path);
        }
        match &transforms.ply_file_path {
            Some(name) => self.ply(name),
            None => Err(CaptureError::NoMesh {
                path: self.path.clone(),
            }),
        }
    }

    /// The file that `ply_file_path` names: the mesh, or sparse points.
    pub fn ply(&self, name: &str) -> Result<PathBuf, CaptureError> {
        self.check("ply_file_path", self.join(name))
    }

    fn join(&self, name: &str) -> PathBuf {
        // Files made on Windows may carry its separators.
        self.path.join(name.replace('\\', "/"))
    }

    /// Refuses what leads out of the folder, by dots, as an absolute path or through links.
    fn check(&self, field: &'static str, path: PathBuf) -> Result<PathBuf, CaptureError> {
        let canonical = path.canonicalize().map_err(|source| CaptureError::Read {
            path: path.clone(),
            source,
        })?;
        if self.holds(&canonical) {
            return Ok(path);
        }
        Err(CaptureError::Outside { field, path })
    }

    /// Whether a file may be read that lies there, links and dots resolved.
    fn holds(&self, canonical: &Path) -> bool {
        self.allow_outside || canonical.starts_with(&self.canonical)
    }
}

/// The image file that `path` stands for, with or without its extension.
fn find(path: &Path) -> Option<PathBuf> {
    // The name as it is comes first: "view.001" has an extension that is none.
    let candidates = [path.to_owned()]
        .into_iter()
        .chain(EXTENSIONS.iter().map(|extension| {
            let mut name = path.as_os_str().to_owned();
            name.push(".");
            name.push(extension);
            name.into()
        }));
    candidates.into_iter().find(|path: &PathBuf| path.is_file())
}
