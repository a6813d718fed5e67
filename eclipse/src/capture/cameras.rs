//! Cameras alone: from a `transforms.json` whose photographs need not be there, or from a capture of any format.

use std::path::{Path, PathBuf};

use render::camera::Camera;

use super::{
    CaptureError,
    error::At,
    formats,
    paths::Folder,
    pose::{camera, declared_size, rigid_pose},
    transforms::{Transforms, read_transforms},
};
use crate::{files::folder_of, image_io::read_size};

/// Widest or highest picture that is rendered, in pixels.
pub const MAX_PICTURE_SIDE: usize = 8192;

/// Every camera of the file `path`, or of the capture in the folder `path`, in its order and in its own frame, each with its frame's
/// `file_path`.
///
/// Sizes are `w` and `h`, else those of the photograph, else `size`; with `size` all cameras are brought to that size. Files outside
/// of the folder are read if `allow_outside`.
///
/// # Errors
/// [`CaptureError`] as for a capture; a frame of unknown size, of more than [`MAX_PICTURE_SIDE`] pixels a side, and one whose shape is
/// not that of `size`.
pub fn read_cameras(
    path: &Path,
    size: Option<[usize; 2]>,
    allow_outside: bool,
) -> Result<Vec<(String, Camera)>, CaptureError> {
    let (json, transforms, folder) = described(path, allow_outside)?;
    let mut cameras = Vec::with_capacity(transforms.frames.len());
    for frame in &transforms.frames {
        let name = &frame.file_path;
        let at = At {
            path: &json,
            frame: name,
        };
        let intrinsics = frame.intrinsics.or(&transforms.intrinsics);
        let pose = rigid_pose(at, transforms.pose_of(frame))?;
        let own = match declared_size(at, &intrinsics)? {
            [Some(width), Some(height)] => [width, height],
            _ if folder.has_image(name) => {
                let image = folder.image(at, "file_path", name)?;
                let size = read_size(&image).map_err(|source| CaptureError::Image {
                    frame: name.clone(),
                    source,
                })?;
                [size.width, size.height]
            }
            _ => size.ok_or_else(|| {
                let problem = "is missing, or `h`, and the photograph is not there to tell; \
                               add them, or give the size on the command line";
                at.field("w", problem.to_owned())
            })?,
        };
        let camera = camera(at, transforms.projection(), &intrinsics, own, pose)?;
        let camera = match size {
            None => camera,
            Some(size) => resized(at, camera, size)?,
        };
        let [width, height] = [camera.width, camera.height];
        if width.max(height) > MAX_PICTURE_SIDE {
            let problem = format!(
                "and `h` are {width} × {height}, but pictures have at most {MAX_PICTURE_SIDE} pixels a side; \
                 give a smaller size on the command line"
            );
            return Err(at.field("w", problem));
        }
        cameras.push((name.clone(), camera));
    }
    Ok(cameras)
}

/// What the file `path` says of all frames that it has; of the capture in the folder `path` what says how it was taken.
///
/// # Errors
/// [`CaptureError`] where it cannot be read.
pub fn read_described(path: &Path, allow_outside: bool) -> Result<Transforms, CaptureError> {
    described(path, allow_outside).map(|(_, transforms, _)| transforms)
}

/// The same between the file that says it and the folder that its files lie in.
fn described(
    path: &Path,
    allow_outside: bool,
) -> Result<(PathBuf, Transforms, Folder), CaptureError> {
    if path.is_dir() {
        let folder = Folder::new(path, allow_outside)?.for_cameras();
        let source = formats::read(&folder)?;
        return Ok((source.path, source.transforms, folder));
    }
    let transforms = read_transforms(path)?;
    let folder = Folder::new(folder_of(path), allow_outside)?;
    Ok((path.into(), transforms, folder))
}

/// The same view with other pixels.
fn resized(at: At<'_>, camera: Camera, size: [usize; 2]) -> Result<Camera, CaptureError> {
    let [width, height] = size;
    let scale = width as f32 / camera.width as f32;
    if (camera.height as f32 * scale - height as f32).abs() > 1.0 {
        let (own_width, own_height) = (camera.width, camera.height);
        let problem = format!(
            "and `h` are {own_width} × {own_height}, another shape than the {width} × {height} asked for; \
             ask for {width} × {:.0}",
            own_height as f32 * scale
        );
        return Err(at.field("w", problem));
    }
    Ok(scaled(camera, size))
}

/// The same view with other pixels, of whatever shape: what is seen stays where it is in the picture.
pub(super) fn scaled(camera: Camera, [width, height]: [usize; 2]) -> Camera {
    let own = [camera.width, camera.height];
    let scale = |values: [f32; 2]| {
        let along = |axis: usize| [width, height][axis] as f64 / own[axis] as f64;
        [0, 1].map(|axis| (f64::from(values[axis]) * along(axis)) as f32)
    };
    Camera {
        width,
        height,
        focal: scale(camera.focal),
        principal: scale(camera.principal),
        ..camera
    }
}
