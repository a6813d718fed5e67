//! Writing a capture: `transforms.json`, one half-float RGBA EXR a frame, `mesh.glb`.

use std::{
    fs,
    io::{self, Write},
    path::Path,
};

use render::{
    camera::{Camera, Projection},
    image::Image,
};
use serde_json::{Value, json};

use super::{Capture, CaptureError, Frame};
use crate::{
    files::{atomic, folder_of},
    image_io::{ExrOptions, Precision, write_exr_with},
    mesh_io::{GlbSurface, write_glb},
};

/// Largest finite half float.
const HALF_MAX: f32 = 65504.0;

/// Writes `capture` to the folder `path`, which must not exist or be empty; `capture.path` does not matter.
///
/// All is written beside `path` and renamed at the end: when anything fails, nothing is left. Positions are written in
/// the capture's own frame ([`Capture::centre`] added back).
pub fn write(path: &Path, capture: &Capture) -> Result<(), CaptureError> {
    write_with(path, capture, |_| Ok(()))
}

/// [`write()`] with more files: `extra` is given the folder being written, before it takes its name.
pub fn write_with<E: From<CaptureError>>(
    path: &Path,
    capture: &Capture,
    extra: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let fail = |source: io::Error| CaptureError::Write {
        path: path.into(),
        source,
    };
    vacant(path)?;
    fs::create_dir_all(folder_of(path)).map_err(fail)?;
    let staging = atomic::stage_folder(path).map_err(fail)?;
    for frame in &capture.frames {
        write_frame(staging.path(), frame)?;
    }
    let mut mesh = capture.mesh.clone();
    for position in &mut mesh.positions {
        *position += capture.centre;
    }
    write_glb(
        &staging.path().join("mesh.glb"),
        &mesh,
        &GlbSurface::default(),
    )
    .map_err(CaptureError::from)?;
    let transforms = format!("{:#}\n", transforms(capture));
    let path_of_it = staging.path().join("transforms.json");
    atomic::write(&path_of_it, |file| file.write_all(transforms.as_bytes())).map_err(fail)?;
    extra(staging.path())?;
    if path.exists() {
        fs::remove_dir(path).map_err(fail)?;
    }
    fs::rename(staging.path(), path).map_err(fail)?;
    // The folder has its name now: nothing of it is to be cleaned up.
    let _ = staging.keep();
    Ok(())
}

/// Checks that nothing is where a capture is to be written, before it is made with much work.
pub(crate) fn vacant(path: &Path) -> Result<(), CaptureError> {
    if fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some()) || path.is_file() {
        return Err(CaptureError::Occupied { path: path.into() });
    }
    Ok(())
}

fn write_frame(folder: &Path, frame: &Frame) -> Result<(), CaptureError> {
    let Frame {
        name, image, mask, ..
    } = frame;
    let pixels = image.data.chunks_exact(3).zip(&mask.data);
    let data: Vec<f32> = pixels
        .flat_map(|(rgb, &alpha)| [rgb[0], rgb[1], rgb[2], alpha])
        .collect();
    // Half floats would turn brighter values into infinities.
    let bright = data.iter().any(|value| value.abs() > HALF_MAX);
    let precision = if bright {
        Precision::Float
    } else {
        Precision::Half
    };
    let rgba = Image {
        channels: 4,
        data,
        ..*image
    };
    let options = ExrOptions {
        precision,
        ..ExrOptions::default()
    };
    let path = folder.join(format!("{name}.exr"));
    write_exr_with(&path, &rgba, &["R", "G", "B", "A"], &options).map_err(CaptureError::WriteImage)
}

/// `transforms.json`, intrinsics shared where all frames have the same.
fn transforms(capture: &Capture) -> Value {
    let intrinsics: Vec<Value> = capture
        .frames
        .iter()
        .map(|frame| intrinsics(&frame.camera))
        .collect();
    let shared = intrinsics.windows(2).all(|pair| pair[0] == pair[1]);
    let frames = capture
        .frames
        .iter()
        .zip(&intrinsics)
        .map(|(frame, intrinsics)| {
            let mut pose = frame.camera.world_from_camera;
            pose.w_axis += capture.centre.extend(0.0);
            let rows: Vec<[f32; 4]> = (0..4).map(|row| pose.row(row).to_array()).collect();
            let mut entry = if shared {
                json!({})
            } else {
                intrinsics.clone()
            };
            entry["file_path"] = format!("{}.exr", frame.name).into();
            entry["transform_matrix"] = json!(rows);
            entry
        });
    let lamps = capture
        .lamps
        .iter()
        .flat_map(|known| &known.lamps)
        .map(Some);
    let frames = frames.zip(lamps.chain(std::iter::repeat(None)));
    let frames = frames.map(|(mut entry, lamp)| {
        if let Some(lamp) = lamp {
            let direction = lamp.direction.to_array();
            entry["lamp"] = json!({ "direction": direction, "strength": lamp.strength });
        }
        entry
    });
    let frames: Value = frames.collect();
    let mut root = if shared {
        intrinsics.first().cloned().unwrap_or(json!({}))
    } else {
        json!({})
    };
    let orthographic = |frame: &Frame| frame.camera.projection == Projection::Orthographic;
    let model = if capture.frames.iter().any(orthographic) {
        "ORTHOGRAPHIC"
    } else {
        "OPENCV"
    };
    root["camera_model"] = model.into();
    if capture.lamps.as_ref().is_some_and(|lamps| lamps.ball) {
        let [x, y, z] = capture.centre.to_array();
        root["shape"] = json!({
            "sphere": { "centre": [x, y, z], "radius": capture.mesh.bounding_radius() }
        });
    }
    root["frames"] = frames;
    root
}

fn intrinsics(camera: &Camera) -> Value {
    let [fl_x, fl_y] = camera.focal;
    let [cx, cy] = camera.principal;
    if camera.projection == Projection::Orthographic {
        return json!({
            "pixels_per_unit": fl_x, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height,
        });
    }
    let [k1, k2, p1, p2] = camera.distortion;
    let angle = 2.0 * (0.5 * camera.width as f64 / f64::from(fl_x)).atan();
    json!({
        "camera_angle_x": angle, "fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height,
        "k1": k1, "k2": k2, "p1": p1, "p2": p2,
    })
}
