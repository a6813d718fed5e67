//! Mesh files: glTF 2.0 (binary or not), Wavefront OBJ and Stanford PLY in; binary glTF out.
//!
//! glTF is y up by definition and is turned to z up, with all node transforms applied; OBJ and PLY are read raw.
//! Texture coordinates follow glTF: v grows downwards.

mod gltf_accessor;
mod gltf_in;
mod gltf_out;
mod gltf_surface;
mod looks;
mod obj;
mod ply;
mod ply_header;
mod polygon;
mod raw;

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use glam::Vec3;
use render::mesh::Mesh;

use crate::{
    files::{atomic, folder_of, read_limited},
    wording::counted,
};

pub use gltf_in::{Load, parse_glb, parse_gltf};
pub use gltf_out::{GlbSurface, GlbTextures, encode_glb};
pub use gltf_surface::{MeshSurface, SurfaceMaps, parse_surfaced_glb};
pub use looks::parse_looks;
pub use obj::parse_obj;
pub use ply::{parse_ply, parse_ply_points};

/// Largest mesh file that is read, in bytes; of glTF also the most that all its buffers may hold together.
pub const MAX_FILE: u64 = 1 << 31;
/// Most vertices that are read: some 2 GiB of positions, normals and texture coordinates.
pub const MAX_VERTICES: usize = 1 << 26;
/// Most faces that are read, those that name a vertex twice among them: 768 MiB of indices.
pub const MAX_FACES: usize = 1 << 26;

/// Reads a mesh; the format goes by the extension (`glb`, `gltf`, `obj`, `ply`), upper or lower case.
///
/// Missing normals are computed from the faces around each position, weighted by angle. Faces that name a vertex twice
/// are dropped. Buffers of a `.gltf` must lie in its folder.
pub fn read_mesh(path: &Path) -> Result<Mesh, MeshIoError> {
    let bytes = read(path)?;
    let mesh = match extension(path).as_str() {
        "glb" | "gltf" => parse_gltf(&bytes, &mut |uri, most| read_beside(path, uri, most)),
        "obj" => parse_obj(&bytes),
        "ply" => parse_ply(&bytes),
        _ => return Err(MeshIoError::Extension { path: path.into() }),
    };
    mesh.map_err(|source| MeshIoError::Parse {
        path: path.into(),
        source,
    })
}

/// Reads the positions of a PLY file that holds points alone, as programs keep what they triangulated; `None` where it has faces.
///
/// # Errors
/// A file that cannot be read, or is no PLY file.
pub fn read_point_cloud(path: &Path) -> Result<Option<Vec<Vec3>>, MeshIoError> {
    parse_ply_points(&read(path)?).map_err(|source| MeshIoError::Parse {
        path: path.into(),
        source,
    })
}

/// What a mesh file says of the surface's looks, which [`read_mesh`] passes over, in the words of [`parse_looks`]; nothing for a file
/// that cannot be read, which reading the mesh tells of.
pub fn looks_of(path: &Path) -> Vec<&'static str> {
    let extension = extension(path);
    read(path).map_or(Vec::new(), |bytes| parse_looks(&bytes, &extension))
}

/// Reads a mesh that [`write_glb`] wrote, together with the material on it.
///
/// # Errors
/// As [`read_mesh`], and a file with another number of primitives than one, or without a material.
pub fn read_surfaced_glb(path: &Path) -> Result<(Mesh, MeshSurface), MeshIoError> {
    parse_surfaced_glb(&read(path)?).map_err(|source| MeshIoError::Parse {
        path: path.into(),
        source,
    })
}

/// Writes a binary glTF 2.0 file (y up) that Blender and other programs open.
pub fn write_glb(path: &Path, mesh: &Mesh, surface: &GlbSurface) -> Result<(), MeshIoError> {
    let bytes = encode_glb(mesh, surface).map_err(|reason| MeshIoError::Encode {
        path: path.into(),
        reason,
    })?;
    atomic::write(path, |file| file.write_all(&bytes)).map_err(|source| MeshIoError::Write {
        path: path.into(),
        source,
    })
}

/// By which the format goes, in lower case.
fn extension(path: &Path) -> String {
    let own = path.extension().unwrap_or_default();
    own.to_string_lossy().to_ascii_lowercase()
}

fn read(path: &Path) -> Result<Vec<u8>, MeshIoError> {
    read_limited(path, MAX_FILE).map_err(|source| MeshIoError::Read {
        path: path.into(),
        source,
    })
}

/// A buffer of at most `most` bytes that a `.gltf` names, which must not lead out of its folder.
fn read_beside(path: &Path, uri: &str, most: u64) -> Result<Vec<u8>, String> {
    let folder = folder_of(path);
    let fail = |error: std::io::Error| format!("its buffer {uri:?} cannot be read: {error}");
    let folder = folder.canonicalize().map_err(fail)?;
    let file = folder.join(uri).canonicalize().map_err(fail)?;
    if !file.starts_with(&folder) {
        return Err(format!(
            "its buffer {uri:?} lies outside the mesh's folder: put it beside the mesh"
        ));
    }
    read_limited(&file, most).map_err(fail)
}

/// Why a mesh could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshIoError {
    /// The file cannot be opened or read.
    #[error("cannot read the mesh {}: {source}; check that it exists and may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The extension is none of those known.
    #[error("{} has no known mesh extension: export it as .glb, .gltf, .obj or .ply", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// The content is not a usable mesh.
    #[error("the mesh {} {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: MeshParseError,
    },
    /// The mesh or its surface cannot be written.
    #[error("cannot write the mesh {}: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {source}; check that the folder exists, may be written, and that the disk is not full", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What is wrong with the content of a mesh file. The messages continue "the mesh FILE …".
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshParseError {
    /// The bytes do not follow the format.
    #[error("is damaged or truncated ({0}); export it again")]
    Syntax(String),
    /// The file uses a part of the format that is not supported.
    #[error("uses {0}, which is not supported; export it without")]
    Unsupported(String),
    /// The shape is where something else puts it, which is not computed here.
    #[error("{what}, which is not supported: {remedy}, and export it again")]
    NotInPlace {
        /// What is so, as `has ...`.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// More than is read.
    #[error(
        "has more than {most} {what}, the most that is read; export only the object, or simplify it"
    )]
    TooLarge {
        /// Of what: `vertices`, `normals`, `texture coordinates`, `faces`, `bytes of buffers` or `values in its JSON`.
        what: &'static str,
        /// The most that is read.
        most: u64,
    },
    /// There is nothing to see.
    #[error(
        "has no faces ({}): a point cloud does not do, export a triangle mesh", counted(*vertices, "vertex")
    )]
    NoFaces {
        /// Vertices it has.
        vertices: usize,
    },
    /// A face names a vertex that is not there.
    #[error(
        "has a face (number {face}, from 0) that names vertex {index}, but the mesh has {}; export it again", counted(*vertices, "vertex")
    )]
    Index {
        /// The face, counted from 0.
        face: usize,
        /// The index it names.
        index: i64,
        /// Vertices there are.
        vertices: usize,
    },
    /// Positions that are NaN or infinite.
    #[error(
        "has {} with coordinates that are not finite, the first is number {first} (from 0); repair it, or delete them", counted(*count, "vertex")
    )]
    NotFinite {
        /// How many.
        count: usize,
        /// The first, counted from 0.
        first: usize,
    },
    /// Nothing says what the surface is like.
    #[error("has no materials ({0}); expected the mesh.glb of a run")]
    NoMaterials(&'static str),
    /// All vertices lie at one point.
    #[error("has no extent: all its vertices lie at one point")]
    NoExtent,
}
