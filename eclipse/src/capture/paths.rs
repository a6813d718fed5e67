//! Where the files of a capture lie.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
};

use super::{CaptureError, LoadOptions, error::At, transforms::Transforms};
use crate::files::slashed;

/// Image extensions that are tried for a `file_path` without one.
const EXTENSIONS: [&str; 10] = [
    "exr", "hdr", "png", "jpg", "jpeg", "EXR", "HDR", "PNG", "JPG", "JPEG",
];

/// Names of a capture's mesh, the first that is there is taken.
const MESHES: [&str; 4] = ["mesh.glb", "mesh.gltf", "mesh.obj", "mesh.ply"];

/// A capture's folder.
pub(super) struct Folder {
    path: PathBuf,
    canonical: PathBuf,
    allow_outside: bool,
    images: Option<Images>,
    cameras_alone: bool,
}

/// A folder that the user named, which stands for [`IMAGES`] wherever it lies.
struct Images {
    path: PathBuf,
    canonical: PathBuf,
}

/// The folder of a capture in which programs that do not say where photographs lie expect them.
pub(super) const IMAGES: &str = "images/";

impl Folder {
    pub fn new(path: &Path, allow_outside: bool) -> Result<Self, CaptureError> {
        let canonical = path.canonicalize().map_err(|source| CaptureError::Read {
            path: path.into(),
            source,
        })?;
        if canonical.is_file() {
            return Err(CaptureError::File {
                path: path.into(),
                hint: format!("give its own: {}", capture_folder(path).display()),
            });
        }
        Ok(Self {
            path: path.into(),
            canonical,
            allow_outside,
            images: None,
            cameras_alone: false,
        })
    }

    /// The same with the photographs where the options say.
    pub fn with_images(self, options: &LoadOptions) -> Result<Self, CaptureError> {
        let Some(path) = &options.images else {
            return Ok(self);
        };
        let canonical = path.canonicalize().map_err(|error| error.to_string());
        let canonical = canonical.and_then(|canonical| match canonical.is_dir() {
            true => Ok(canonical),
            false => Err("it is no folder".to_owned()),
        });
        let canonical = canonical.map_err(|problem| CaptureError::Images {
            path: path.clone(),
            problem,
        })?;
        let path = path.clone();
        Ok(Self {
            images: Some(Images { path, canonical }),
            ..self
        })
    }

    /// The same for whoever asks for cameras: photographs need not be there.
    pub fn for_cameras(self) -> Self {
        Self {
            cameras_alone: true,
            ..self
        }
    }

    /// Whether photographs need not be there.
    pub fn is_for_cameras(&self) -> bool {
        self.cameras_alone
    }

    /// The folder that the user named for the photographs.
    pub fn images(&self) -> Option<&Path> {
        self.images.as_ref().map(|images| &*images.path)
    }

    /// The image that `name`, of a frame's `field`, stands for.
    pub fn image(
        &self,
        at: At<'_>,
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
                described: at.path.into(),
                frame: at.frame.into(),
                field,
                path,
                hint,
            });
        };
        self.check(at.place(), field, found)
    }

    /// Whether `name` stands for an image that is there.
    pub fn has_image(&self, name: &str) -> bool {
        find(&self.join(name)).is_some()
    }

    /// Whether `name` stands for a folder that is there.
    pub fn has_folder(&self, name: &str) -> bool {
        self.join(name).is_dir()
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

    /// The mesh: the one asked for, else one in the folder, else the one that the file `described`, of these `transforms`, names.
    pub fn mesh(
        &self,
        asked: Option<&Path>,
        described: &Path,
        transforms: &Transforms,
    ) -> Result<PathBuf, CaptureError> {
        if let Some(path) = asked {
            // Named by the user, not by the capture: it may lie anywhere.
            return Ok(path.into());
        }
        if let Some(path) = self.own_meshes().into_iter().next() {
            return self.check(self.path.display().to_string(), "mesh", path);
        }
        match &transforms.ply_file_path {
            Some(name) => self.ply(described, name),
            None => Err(CaptureError::NoMesh {
                path: self.path.clone(),
                hint: self.candidates(),
            }),
        }
    }

    /// Meshes that lie in the folder under the names of a capture's own, that which is taken first.
    pub fn own_meshes(&self) -> Vec<PathBuf> {
        let own = MESHES.map(|name| self.path.join(name)).into_iter();
        own.filter(|path| path.exists()).collect()
    }

    /// What to do where there is no mesh, by what else is there.
    fn candidates(&self) -> String {
        let is_mesh = |path: &PathBuf| {
            let extension = path.extension().unwrap_or_default().to_string_lossy();
            let known = MESHES.map(|name| &name["mesh.".len()..]);
            let plain = !path.to_string_lossy().contains(char::is_control);
            plain && known.contains(&&*extension.to_lowercase()) && path.is_file()
        };
        let entries = std::fs::read_dir(&self.path).into_iter().flatten();
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let mut found: Vec<PathBuf> = paths.filter(is_mesh).collect();
        found.sort();
        let Some(first) = found.first() else {
            return "put the object's shape there, or name it with --mesh".to_owned();
        };
        let name = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        };
        let names: Vec<String> = found.iter().take(5).map(name).collect();
        let more = if found.len() > 5 { ", …" } else { "" };
        let extension = first.extension().unwrap_or_default().to_string_lossy();
        format!(
            "there is {}{more}: if that is the object's shape, give --mesh {}, or rename it to mesh.{}",
            names.join(", "),
            first.display(),
            extension.to_lowercase()
        )
    }

    /// The file that `ply_file_path` in `described` names: the mesh, or sparse points.
    pub fn ply(&self, described: &Path, name: &str) -> Result<PathBuf, CaptureError> {
        let place = described.display().to_string();
        self.check(place, "ply_file_path", self.join(name))
    }

    fn join(&self, name: &str) -> PathBuf {
        let name = slashed(name);
        match (&self.images, name.strip_prefix(IMAGES)) {
            (Some(images), Some(rest)) => images.path.join(rest),
            _ => self.path.join(name),
        }
    }

    /// Refuses what leads out of the folder, by dots, as an absolute path or through links.
    fn check(
        &self,
        place: String,
        field: &'static str,
        path: PathBuf,
    ) -> Result<PathBuf, CaptureError> {
        let canonical = path.canonicalize().map_err(|source| CaptureError::Read {
            path: path.clone(),
            source,
        })?;
        if self.holds(&canonical) {
            return Ok(path);
        }
        Err(CaptureError::Outside { place, field, path })
    }

    /// Whether a file may be read that lies there, links and dots resolved.
    fn holds(&self, canonical: &Path) -> bool {
        let in_images = |images: &Images| canonical.starts_with(&images.canonical);
        self.allow_outside
            || canonical.starts_with(&self.canonical)
            || self.images.as_ref().is_some_and(in_images)
    }
}

/// The folder of the capture that the file `path` belongs to.
fn capture_folder(path: &Path) -> &Path {
    let parent = path.parent().unwrap_or(Path::new(""));
    // Of COLMAP's models, numbered or alone.
    let is_number = |name: &OsStr| name.to_string_lossy().parse::<u32>().is_ok();
    let numbered = parent.file_name().is_some_and(is_number);
    let models = match numbered {
        true => parent.parent().unwrap_or(parent),
        false => parent,
    };
    let up = match models.ends_with("sparse") {
        true => 1 + usize::from(numbered),
        false => 0,
    };
    match parent.ancestors().nth(up) {
        None => parent,
        Some(folder) if folder == Path::new("") => Path::new("."),
        Some(folder) => folder,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_belong_to_the_folder_of_their_capture() {
        for (file, folder) in [
            ("transforms.json", "."),
            ("a/b/transforms.json", "a/b"),
            ("a/sparse/0/images.bin", "a"),
            ("a/sparse/12/images.bin", "a"),
            ("a/12/transforms.json", "a/12"),
            ("a/sparse/images.txt", "a"),
            ("sparse/0/images.bin", "."),
            ("/transforms.json", "/"),
        ] {
            assert_eq!(capture_folder(Path::new(file)), Path::new(folder), "{file}");
        }
    }
}
