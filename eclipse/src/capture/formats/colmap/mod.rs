//! COLMAP's sparse models: `cameras`, `images` and `points3D`, binary or text, in `sparse/0` or the folder itself; of several
//! (`sparse/0`, `sparse/1`, …) the one with the most images is read.
//!
//! The files are described at <https://colmap.github.io/format.html>. Photographs lie in `images/`, or where
//! [`LoadOptions::images`](crate::capture::LoadOptions::images) says, masks in `masks/` (under
//! COLMAP's name, `NAME.png` added to the whole file name, or the photograph's own). Poses become camera to world with OpenGL
//! axes; the model's frame is kept, in which the mesh must be. Which way is up in it is arbitrary, where nobody aligned the model:
//! [`LoadOptions::up`](crate::capture::LoadOptions::up) says it.

mod binary;
mod camera;
mod models;
mod text;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use glam::{DMat3, DQuat, DVec3, Vec3};

use self::models::Chosen;
use super::{Format, Source, source};
use crate::{
    capture::{
        CaptureError,
        error::{At, all_good},
        paths::{Folder, IMAGES},
        transforms::{Intrinsics, MAX_FRAMES, Transforms, TransformsFrame},
    },
    files::read_limited,
    image_io::stem,
};

pub(super) const FORMAT: Format = Format {
    name: "COLMAP",
    sign: "sparse/0/images.bin or .txt",
    leaves_folder_open: true,
    read,
};

/// Largest file of a model that is read, in bytes.
pub const MAX_MODEL: u64 = 1 << 31;

/// How the files of a model are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// `.bin`, little-endian.
    Binary,
    /// `.txt`.
    Text,
}

impl Encoding {
    /// COLMAP itself prefers the binary files where both are there.
    const ALL: [Self; 2] = [Self::Binary, Self::Text];

    fn extension(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }
}

/// A photograph with its pose, as a model has it.
struct ModelImage {
    name: String,
    camera: u32,
    /// Rotation from world to camera: w x y z.
    rotation: [f64; 4],
    translation: [f64; 3],
}

/// What is wrong with a file: where in it, and what.
struct Problem {
    place: String,
    problem: String,
}

impl Problem {
    fn new(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            problem: problem.into(),
        }
    }

    fn at(self, path: &Path) -> CaptureError {
        CaptureError::Model {
            path: path.into(),
            place: self.place,
            problem: self.problem,
        }
    }
}

fn read(folder: &Folder) -> Option<Result<Source, CaptureError>> {
    let Chosen {
        place,
        encoding,
        note,
    } = models::choose(folder)?;
    let source = read_model(folder, &place, encoding);
    Some(source.map(|source| Source {
        notes: note.into_iter().collect(),
        ..source
    }))
}

fn read_model(folder: &Folder, place: &Path, encoding: Encoding) -> Result<Source, CaptureError> {
    let files = ["cameras", "images", "points3D"].map(|name| file(place, name, encoding));
    for path in &files {
        folder.check_own(path)?;
    }
    let [cameras, images, points] = files;
    let bytes = [&cameras, &images].map(|path| read_file(path));
    let [camera_bytes, image_bytes] = bytes;
    let mut transforms = parse_model(
        [&camera_bytes?, &image_bytes?],
        encoding,
        [&cameras, &images],
    )?;
    if !folder.is_for_cameras() && !folder.has_folder(IMAGES) {
        return Err(CaptureError::NoImages {
            path: images,
            folder: folder.path().join(IMAGES),
        });
    }
    let frames = transforms.frames.iter_mut();
    all_good(&images, frames.map(|frame| locate(folder, &images, frame)))?;
    Ok(Source {
        points: points.is_file().then_some(points),
        ..source(&images, transforms)
    })
}

fn file(place: &Path, name: &str, encoding: Encoding) -> PathBuf {
    place.join(format!("{name}.{}", encoding.extension()))
}

fn read_file(path: &Path) -> Result<Vec<u8>, CaptureError> {
    read_limited(path, MAX_MODEL).map_err(|source| CaptureError::ReadModel {
        path: path.into(),
        source,
    })
}

/// Gives a frame the paths of its photograph and its mask, in place of the bare name that the model has.
fn locate(folder: &Folder, path: &Path, frame: &mut TransformsFrame) -> Result<(), CaptureError> {
    let name = std::mem::take(&mut frame.file_path);
    frame.file_path = format!("{IMAGES}{name}");
    if folder.is_for_cameras() {
        return Ok(());
    }
    let at = At { path, frame: &name };
    folder.image(at, "NAME", &frame.file_path)?;
    if folder.path().join("masks").is_dir() {
        let masks = [
            format!("masks/{name}.png"),
            format!("masks/{name}"),
            format!("masks/{}", stem(&name)),
        ];
        let mask = masks.iter().find(|mask| folder.has_image(mask));
        // Masks of some photographs only are an oversight: the error names the file that COLMAP would look for.
        let mask = mask.unwrap_or(&masks[0]);
        folder.image(at, "masks", mask)?;
        frame.mask_path = Some(mask.clone());
    }
    Ok(())
}

/// Parses `cameras` and `images`; `paths` only name them in errors. Frames are sorted by name, which `file_path` holds.
pub fn parse_model(
    [cameras, images]: [&[u8]; 2],
    encoding: Encoding,
    paths: [&Path; 2],
) -> Result<Transforms, CaptureError> {
    let cameras = match encoding {
        Encoding::Binary => binary::cameras(cameras),
        Encoding::Text => text::cameras(cameras),
    };
    let cameras = cameras.map_err(|problem| problem.at(paths[0]))?;
    let images = match encoding {
        Encoding::Binary => binary::images(images),
        Encoding::Text => text::images(images),
    };
    let at_images = |problem: Problem| problem.at(paths[1]);
    let mut images = images.map_err(at_images)?;
    if images.is_empty() {
        return Err(at_images(Problem::new(
            "the file",
            "holds no images; expected at least one that COLMAP registered",
        )));
    }
    if images.len() > MAX_FRAMES {
        let count = images.len();
        return Err(at_images(Problem::new(
            "the file",
            format!("holds {count} images; at most {MAX_FRAMES} are read: leave some out"),
        )));
    }
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let frames = images.iter().map(|image| frame(image, &cameras));
    let frames: Result<Vec<TransformsFrame>, Problem> = frames.collect();
    Ok(Transforms {
        frames: frames.map_err(at_images)?,
        ..Transforms::default()
    })
}

/// Reads the positions of a model's sparse points, in the model's frame.
pub fn read_points(path: &Path) -> Result<Vec<Vec3>, CaptureError> {
    let text = path.extension().is_some_and(|extension| extension == "txt");
    let encoding = if text {
        Encoding::Text
    } else {
        Encoding::Binary
    };
    parse_points(&read_file(path)?, encoding, path)
}

/// Parses `points3D`; `path` only names it in errors.
pub fn parse_points(
    bytes: &[u8],
    encoding: Encoding,
    path: &Path,
) -> Result<Vec<Vec3>, CaptureError> {
    let points = match encoding {
        Encoding::Binary => binary::points(bytes),
        Encoding::Text => text::points(bytes),
    };
    points.map_err(|problem| problem.at(path))
}

fn frame(
    image: &ModelImage,
    cameras: &BTreeMap<u32, Intrinsics>,
) -> Result<TransformsFrame, Problem> {
    let place = || format!("image {:?}", image.name);
    let Some(intrinsics) = cameras.get(&image.camera) else {
        return Err(Problem::new(
            place(),
            format!(
                "has CAMERA_ID {}, which the cameras file does not have; expected one of its {} cameras",
                image.camera,
                cameras.len()
            ),
        ));
    };
    let [w, x, y, z] = image.rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    if !length.is_finite() || length < 1e-6 {
        return Err(Problem::new(
            place(),
            format!(
                "has QW QX QY QZ = {:?}; expected a quaternion of length 1",
                image.rotation
            ),
        ));
    }
    let translation = DVec3::from(image.translation);
    if !translation.is_finite() {
        return Err(Problem::new(
            place(),
            "has TX TY TZ that are not finite; expected a translation",
        ));
    }
    let world_from_camera = DMat3::from_quat(rotation.normalize()).transpose();
    let position = -(world_from_camera * translation);
    // COLMAP's cameras look along +z with y down; OpenGL's along −z with y up.
    let [right, up, back] = [
        world_from_camera.x_axis,
        -world_from_camera.y_axis,
        -world_from_camera.z_axis,
    ];
    let row = |axis: usize| vec![right[axis], up[axis], back[axis], position[axis]];
    Ok(TransformsFrame {
        scene_name: None,
        lamp: None,
        camera_model: None,
        file_path: image.name.clone(),
        mask_path: None,
        transform_matrix: vec![row(0), row(1), row(2), vec![0.0, 0.0, 0.0, 1.0]],
        intrinsics: intrinsics.clone(),
    })
}

/// A photograph's name, which must be one.
fn checked_name(name: &str, place: &str) -> Result<String, Problem> {
    if name.is_empty() {
        return Err(Problem::new(
            place,
            "has no NAME; expected the photograph's file name",
        ));
    }
    if name.contains(char::is_control) {
        let problem = format!("has the NAME {name:?}, with control characters; rename the image");
        return Err(Problem::new(place, problem));
    }
    Ok(name.to_owned())
}
