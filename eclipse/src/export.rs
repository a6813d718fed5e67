//! Results as other programs load them: the light, the object and a small scene, nothing to be turned there.
//!
//! Our world is right-handed with z up. Programs with y up see its (x, y, z) as (x, z, −y), as glTF does: `mesh.glb` and, for
//! Mitsuba, `mesh.ply` are written so. The environment map follows each program's own equirectangular layout, so that it loads
//! without a rotation, beside that mesh. With d a unit direction of our world and p = (x, z, −y) of it:
//!
//! | program | world | u of a direction | v | rows |
//! | --- | --- | --- | --- | --- |
//! | Blender (Cycles) | z up | ½ − atan2(d.y, d.x)/2π: centre +x, azimuth falls to the right | acos(d.z)/π | centred |
//! | Mitsuba 3 | y up | atan2(p.x, −p.z)/2π: left edge −z, +x a quarter in | acos(p.y)/π | the first and the last lie at the poles |
//! | three.js | y up | ½ + atan2(p.z, p.x)/2π: centre +x, the same pixels as Blender's | acos(p.y)/π | centred |
//!
//! Columns are centred everywhere. Mitsuba's map has 2H + 1 rows for our H: every one of ours is among them and the others lie
//! halfway, so that its bilinear lookup gives our light exactly.
//!
//! Materials go as glTF with `KHR_materials_specular`; `mesh.ply` carries them at its vertices. Scenes bounce light once, as the
//! reconstruction does. Diffuse objects look the same there: Mitsuba 3.9 and Blender 4.2 were within 0.2 % of our brightness. Glossy ones
//! nearly, as each program has a coat of its own: Blender was 2 to 3 % brighter, Mitsuba's `principled` a tenth to a seventh.

mod blender;
mod environment;
mod mitsuba;
mod ply;
mod threejs;

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
    str::FromStr,
};

use render::camera::Camera;
use render::convention::Convention;

use crate::{
    files::{
        atomic, claim,
        lock::{Lock, LockError},
        read_limited,
    },
    image_io::{
        EnvironmentIoError, EnvironmentOptions, ExrOptions, ImageIoError, read_environment,
        write_exr_with,
    },
    layout::{CONVENTION, ENVIRONMENT, MESH},
    mesh_io::{self, MeshSurface},
    relight::{Object, Orbit, RelightError},
};

pub use environment::laid_out;

/// The file by which a folder of an export is known; it says what the others are.
const NOTES: &str = "export.txt";
/// Pixels across and down that scenes ask for.
const SIZE: usize = 512;
/// From where scenes look at the object: the first picture of `eclipse relight`.
const VIEW: Orbit = Orbit {
    frames: 1,
    size: [SIZE, SIZE],
    elevation: 20.0,
    azimuth: 0.0,
    distance: 5.0,
};

/// A program to export for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// Blender: `scene.py`.
    Blender,
    /// Mitsuba 3: `scene.xml` and `mesh.ply`.
    Mitsuba,
    /// three.js: `index.html`.
    ThreeJs,
}

impl Program {
    /// Every program.
    pub const ALL: [Self; 3] = [Self::Blender, Self::Mitsuba, Self::ThreeJs];

    /// Its layout of environment maps.
    pub fn convention(self) -> Convention {
        match self {
            Self::Blender => Convention::Blender,
            Self::Mitsuba => Convention::Mitsuba,
            Self::ThreeJs => Convention::ThreeJs,
        }
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        self.convention().name()
    }

    /// The scene's file.
    pub fn scene(self) -> &'static str {
        match self {
            Self::Blender => "scene.py",
            Self::Mitsuba => "scene.xml",
            Self::ThreeJs => "index.html",
        }
    }

    /// How the scene is looked at.
    fn usage(self) -> &'static str {
        match self {
            Self::Blender => "blender --python scene.py",
            Self::Mitsuba => "mitsuba scene.xml",
            Self::ThreeJs => "python3 -m http.server, then open the address it names",
        }
    }
}

impl FromStr for Program {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|program| program.name() == name);
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("unknown program `{name}`; use one of {names}")
        })
    }
}

/// What a scene needs to know.
struct Scene<'a> {
    object: &'a Object,
    /// In the object's own frame.
    camera: Camera,
    /// The point looked at, in our world.
    target: glam::Vec3,
    /// The horizontal field of view in degrees.
    field_of_view: f32,
}

/// Writes the result in `folder` to `out` for `program`: `environment.exr`, `mesh.glb` and a scene, the scene last.
///
/// # Errors
/// [`ExportError`], naming the file; every file is whole or not there.
pub fn export(folder: &Path, program: Program, out: &Path) -> Result<(), ExportError> {
    let object = Object::read(folder).map_err(ExportError::Object)?;
    let light = read_environment(&folder.join(ENVIRONMENT), &EnvironmentOptions::default())?;
    let mesh = folder.join(MESH);
    // Textures and all that the reader does not need stay as they are.
    let glb = read_limited(&mesh, mesh_io::MAX_FILE)
        .map_err(|source| ExportError::Read { path: mesh, source })?;

    if !claim(out, NOTES).map_err(|source| ExportError::write(out, source))? {
        return Err(ExportError::Occupied { path: out.into() });
    }
    let _lock = Lock::acquire(out)?;
    // Another program's scene would find this one's light, turned: it goes.
    let others = Program::ALL.into_iter().filter(|other| *other != program);
    for name in others.map(Program::scene).chain([mitsuba::MESH]) {
        remove(&out.join(name))?;
    }
    write(&out.join(NOTES), notes(program, &object).as_bytes())?;
    let mut options = ExrOptions::default();
    let convention = program.convention();
    let name = convention.name().to_owned();
    options.metadata.insert(CONVENTION.to_owned(), name);
    let map = laid_out(light.image(), convention);
    write_exr_with(&out.join(ENVIRONMENT), &map, &["R", "G", "B"], &options)?;
    write(&out.join(MESH), &glb)?;
    if program == Program::Mitsuba {
        write(&out.join(mitsuba::MESH), &ply::encode(&object))?;
    }
    let camera = VIEW.cameras(object.mesh.bounding_radius()).remove(0);
    let scene = Scene {
        target: object.centre,
        field_of_view: 2.0
            * (0.5 * camera.width as f32 / camera.focal[0])
                .atan()
                .to_degrees(),
        camera: Camera {
            world_from_camera: glam::Mat4::from_translation(object.centre)
                * camera.world_from_camera,
            ..camera
        },
        object: &object,
    };
    let text = match program {
        Program::Blender => blender::scene(&scene),
        Program::Mitsuba => mitsuba::scene(&scene),
        Program::ThreeJs => threejs::scene(&scene),
    };
    write(&out.join(program.scene()), text.as_bytes())
}

/// What the files are, for people.
fn notes(program: Program, object: &Object) -> String {
    let mut text = format!("Written by eclipse export --for {}.\n\n", program.name());
    let mut line = |name: &str, what: &str| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{name:<16} {what}");
    };
    line(program.scene(), program.usage());
    line(
        ENVIRONMENT,
        "the light, in the program's own layout: load it without a rotation",
    );
    let materials = match object.surface {
        MeshSurface::Vertices(_) => "at its vertices (COLOR_0, _ROUGHNESS, _SPECULAR)",
        MeshSurface::Maps(_) => "in textures",
    };
    line(
        MESH,
        &format!("the object, y up, its materials {materials} and KHR_materials_specular"),
    );
    if program == Program::Mitsuba {
        line(
            mitsuba::MESH,
            "the object, y up, its materials at its vertices",
        );
    }
    text
}

fn remove(path: &Path) -> Result<(), ExportError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(ExportError::write(path, error))
        }
        _ => Ok(()),
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    atomic::write(path, |file| std::io::Write::write_all(file, bytes))
        .map_err(|source| ExportError::write(path, source))
}

/// A vector as most scene formats want it: y up.
fn y_up(v: glam::Vec3) -> glam::Vec3 {
    glam::Vec3::new(v.x, v.z, -v.y)
}

/// Why a result could not be exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// There is no object, or it has no materials.
    #[error(transparent)]
    Object(RelightError),
    /// There is no light.
    #[error(transparent)]
    Light(#[from] EnvironmentIoError),
    /// A file of the result cannot be read.
    #[error("cannot read {}: {source}; check that it may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The folder holds something else.
    #[error("{} holds other files: name a new folder with --out", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// Another run writes to the folder.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The map could not be written.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// The file system refused.
    #[error("cannot write {}: {source}; check that the folder may be written and that the disk is not full", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
}

impl ExportError {
    fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write {
            path: path.to_owned(),
            source,
        }
    }
}
