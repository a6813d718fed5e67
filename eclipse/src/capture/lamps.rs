//! Known light: one distant lamp a photograph, and shapes that are no mesh, as photometric stereo has them.

use std::path::Path;

use glam::Vec3;
use render::{camera::Projection, mesh::Mesh};

use super::{
    Capture, CaptureError,
    error::At,
    transforms::{Shape, Transforms, TransformsFrame},
};

/// How far a direction's length may be from one: what is written with three digits is.
const TOLERANCE: f64 = 2e-3;
/// Parts that half a turn of a ball is cut into.
const SPHERE_ROWS: u32 = 128;
/// Radii of the object that an orthographic camera stands off.
const STAND_OFF: f32 = 4.0;

/// The light of a capture whose lamps are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamps {
    /// The lamp of each frame.
    pub lamps: Vec<Lamp>,
    /// Whether the object is a ball: what faces a lamp is lit by it then, and no ray needs to be cast.
    pub ball: bool,
}

/// A lamp so far away that its light is the same everywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Unit vector towards it.
    pub direction: Vec3,
    /// What a white surface that faces it reflects, linear RGB.
    pub strength: [f32; 3],
}

/// The lamps of all frames; `None` where no frame has one. `names` are the frames' names.
pub(super) fn lamps<'a>(
    path: &Path,
    transforms: &Transforms,
    names: impl Iterator<Item = &'a str>,
) -> Result<Option<Vec<Lamp>>, CaptureError> {
    if transforms.frames.iter().all(|frame| frame.lamp.is_none()) {
        return match transforms.projection() {
            Projection::Perspective => Ok(None),
            Projection::Orthographic => Err(CaptureError::OrthographicLight { path: path.into() }),
        };
    }
    let frames = transforms.frames.iter().zip(names);
    frames
        .map(|(frame, name)| lamp(frame, At { path, frame: name }))
        .collect::<Result<_, _>>()
        .map(Some)
}

fn lamp(frame: &TransformsFrame, at: At<'_>) -> Result<Lamp, CaptureError> {
    let Some(lamp) = &frame.lamp else {
        return Err(CaptureError::LampMissing {
            path: at.path.into(),
            frame: at.frame.into(),
        });
    };
    let fail = |field, problem: String| at.field(field, problem);
    let direction = numbers(&lamp.direction).map_err(|problem| fail("lamp.direction", problem))?;
    let length = direction.iter().map(|v| v * v).sum::<f64>().sqrt();
    if (length - 1.0).abs() > TOLERANCE {
        let problem = format!(
            "has the length {length:.4}; expected a unit vector from the object to the lamp: divide it by its length"
        );
        return Err(fail("lamp.direction", problem));
    }
    let strength = match &lamp.strength {
        None => [1.0; 3],
        Some(strength) => numbers(strength).map_err(|problem| fail("lamp.strength", problem))?,
    };
    if strength.iter().any(|s| *s < 0.0) || strength.iter().sum::<f64>() <= 0.0 {
        let problem =
            format!("is {strength:?}; expected light: no number negative, and not all zero");
        return Err(fail("lamp.strength", problem));
    }
    Ok(Lamp {
        direction: Vec3::from_array(direction.map(|v| (v / length) as f32)),
        strength: strength.map(|s| s as f32),
    })
}

/// Three finite numbers, or what is wrong with them.
fn numbers(values: &[f64]) -> Result<[f64; 3], String> {
    let three = <[f64; 3]>::try_from(values)
        .map_err(|_| format!("has {} numbers; expected 3", values.len()))?;
    let single = three.map(|v| v as f32);
    if single.iter().any(|v| !v.is_finite()) {
        return Err(format!("is {three:?}; expected finite numbers"));
    }
    Ok(three)
}

/// The mesh that stands for a shape; `path` only names the file in errors.
pub(super) fn mesh_of(shape: &Shape, path: &Path) -> Result<Mesh, CaptureError> {
    let fail = |field, problem| CaptureError::Shape {
        path: path.into(),
        field,
        problem,
    };
    let sphere = &shape.sphere;
    let centre = numbers(&sphere.centre).map_err(|problem| fail("centre", problem))?;
    let radius = sphere.radius as f32;
    if !(radius.is_finite() && radius > 0.0) {
        let problem = format!("is {}; expected a positive length", sphere.radius);
        return Err(fail("radius", problem));
    }
    let centre = Vec3::from_array(centre.map(|v| v as f32));
    Ok(Mesh::sphere(centre, radius, SPHERE_ROWS))
}

impl Capture {
    /// Moves orthographic cameras off the object, along their viewing directions, which changes no image.
    pub(super) fn stand_off(&mut self) {
        let away = STAND_OFF * self.mesh.bounding_radius();
        let cameras = self.frames.iter_mut().map(|frame| &mut frame.camera);
        for camera in cameras.filter(|c| c.projection == Projection::Orthographic) {
            let back = camera.direction_from(Vec3::ZERO);
            let along = camera.centre().dot(back);
            camera.world_from_camera.w_axis += ((away - along) * back).extend(0.0);
        }
    }
}
