//! From the fields of a frame to a checked camera.

use glam::{DMat3, DMat4, DVec3, Mat4};
use render::camera::{Camera, Projection};

use super::{CaptureError, error::At, transforms::Intrinsics};

/// How far a rotation's columns may be from orthonormal before it is refused; below it they are made so.
const TOLERANCE: f64 = 1e-3;

/// How far the last row may be from 0, 0, 0, 1.
const LAST_ROW: f64 = 1e-6;

/// The camera-to-world matrix given by `rows`, made exactly rigid.
pub(super) fn rigid_pose(at: At<'_>, rows: &[Vec<f64>]) -> Result<DMat4, CaptureError> {
    let fail = |problem: String| at.pose(problem);
    if !matches!(rows.len(), 3 | 4) || rows.iter().any(|row| row.len() != 4) {
        let shape = match rows.first() {
            None => "is missing or empty".to_owned(),
            Some(row) => format!(
                "has {} rows, the first of {} numbers, where 4 of 4 are expected",
                rows.len(),
                row.len()
            ),
        };
        return Err(fail(shape));
    }
    if rows.iter().flatten().any(|value| !value.is_finite()) {
        return Err(fail("holds numbers that are not finite".into()));
    }
    let last = rows.get(3).into_iter().flatten();
    let off = last
        .zip([0.0, 0.0, 0.0, 1.0])
        .map(|(v, exact)| (v - exact).abs());
    // Poses that were inverted or multiplied miss it by rounding errors.
    if off.fold(0.0, f64::max) > LAST_ROW {
        return Err(fail(format!(
            "has the last row {:?} where [0, 0, 0, 1] is expected (is it transposed?)",
            rows[3]
        )));
    }
    let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
    let [x, y, z] = [0, 1, 2].map(column);
    let determinant = DMat3::from_cols(x, y, z).determinant();
    let lengths = [x.length(), y.length(), z.length()];
    let scale = lengths.iter().sum::<f64>() / 3.0;
    let skew = x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs());
    // Relative to the columns' lengths: a tiny scale is no singularity.
    if scale == 0.0 || determinant.abs() <= 1e-6 * scale.powi(3) {
        return Err(fail("is singular".into()));
    }
    let even = lengths
        .iter()
        .all(|length| (length / scale - 1.0).abs() < TOLERANCE);
    if !even || skew > TOLERANCE * scale * scale {
        return Err(fail(
            "is not a rotation: its columns are not perpendicular and of equal length".into(),
        ));
    }
    if determinant < 0.0 {
        return Err(fail(
            "mirrors (its determinant is negative): flip the sign of one column".into(),
        ));
    }
    if (scale - 1.0).abs() > TOLERANCE {
        return Err(fail(format!(
            "scales by {scale:.6}: divide its first three columns by that"
        )));
    }
    let x = x.normalize();
    let y = (y - y.dot(x) * x).normalize();
    Ok(DMat4::from_cols(
        x.extend(0.0),
        y.extend(0.0),
        x.cross(y).extend(0.0),
        column(3).extend(1.0),
    ))
}

/// The image size that the intrinsics declare, where they do.
pub(super) fn declared_size(
    at: At<'_>,
    intrinsics: &Intrinsics,
) -> Result<[Option<usize>; 2], CaptureError> {
    let size = |field: &'static str, value: Option<f64>| match value {
        // Some programs write sizes as 1080.0.
        Some(value) if value < 1.0 || value.fract() != 0.0 || value > 1e6 => {
            let problem = format!("is {value}; expected the image's size in whole pixels");
            Err(at.field(field, problem))
        }
        value => Ok(value.map(|value| value as usize)),
    };
    Ok([size("w", intrinsics.w)?, size("h", intrinsics.h)?])
}

/// The camera of a frame of `width` × `height` pixels, `pose` being rigid.
pub(super) fn camera(
    at: At<'_>,
    projection: Projection,
    intrinsics: &Intrinsics,
    [width, height]: [usize; 2],
    pose: DMat4,
) -> Result<Camera, CaptureError> {
    let fail = |field, problem: String| at.field(field, problem);
    let i = intrinsics;
    // First: of such a lens focal lengths and k1 to k4 mean something else.
    for (field, is_so) in [
        ("is_fisheye", i.is_fisheye == Some(true)),
        ("latlong", i.latlong == Some(true)),
        ("ftheta_p0", i.ftheta_p0.is_some()),
    ] {
        if is_so {
            return Err(fail(
                field,
                "says that the lens is no perspective one, which is not supported; undistort the images to a pinhole camera".into(),
            ));
        }
    }
    let focal = match projection {
        Projection::Perspective => focal_lengths(i, [width, height]),
        Projection::Orthographic => magnification(i),
    }
    .map_err(|(field, problem)| fail(field, problem))?;
    for (field, value) in [("k3", i.k3), ("k4", i.k4)] {
        if value.is_some_and(|value| value != 0.0) {
            return Err(fail(field, "is not zero, which is not supported; undistort the images, or fit k1 k2 p1 p2 only".into()));
        }
    }
    let principal = [
        i.cx.unwrap_or(0.5 * width as f64),
        i.cy.unwrap_or(0.5 * height as f64),
    ]
    .map(|value| value as f32);
    let distortion = [i.k1, i.k2, i.p1, i.p2].map(|value| value.unwrap_or(0.0) as f32);
    if principal
        .iter()
        .chain(&distortion)
        .any(|value| !value.is_finite())
    {
        return Err(fail(
            "cx",
            "or a distortion coefficient is too large to be one".into(),
        ));
    }
    Ok(Camera {
        width,
        height,
        projection,
        focal,
        principal,
        distortion,
        world_from_camera: Mat4::from_cols_array(&pose.to_cols_array().map(|v| v as f32)),
    })
}

/// Focal lengths in pixels, or the field that does not give them and why.
fn focal_lengths(
    i: &Intrinsics,
    [width, height]: [usize; 2],
) -> Result<[f32; 2], (&'static str, String)> {
    let length = |field, value: Option<f64>| match value {
        Some(value) if value <= 0.0 => Err((
            field,
            format!("is {value}; expected a positive focal length in pixels"),
        )),
        value => Ok(value),
    };
    let from_angle = |field, angle: Option<f64>, size: usize| match angle {
        Some(angle) if angle <= 0.0 || angle >= std::f64::consts::PI => Err((
            field,
            format!("is {angle}; expected an angle of view between 0 and π, in radians"),
        )),
        angle => Ok(angle.map(|angle| 0.5 * size as f64 / (0.5 * angle).tan())),
    };
    let focal_x =
        length("fl_x", i.fl_x)?.or(from_angle("camera_angle_x", i.camera_angle_x, width)?);
    let focal_y =
        length("fl_y", i.fl_y)?.or(from_angle("camera_angle_y", i.camera_angle_y, height)?);
    let Some(focal_x) = focal_x.or(focal_y) else {
        return Err((
            "camera_angle_x",
            "is missing, and fl_x too; expected one of them, shared or in the frame".into(),
        ));
    };
    let focal = [focal_x, focal_y.unwrap_or(focal_x)].map(|value| value as f32);
    if focal
        .iter()
        .any(|value| !value.is_finite() || *value <= 0.0)
    {
        return Err((
            "camera_angle_x",
            format!("gives the focal lengths {focal:?}, which no camera has"),
        ));
    }
    Ok(focal)
}

/// The pixels that a unit of length takes in an orthographic camera's image.
fn magnification(i: &Intrinsics) -> Result<[f32; 2], (&'static str, String)> {
    const FIELD: &str = "pixels_per_unit";
    let Some(value) = i.pixels_per_unit else {
        return Err((
            FIELD,
            "is missing; an orthographic camera needs it, shared or in the frame: the pixels that a unit of length takes".into(),
        ));
    };
    let single = value as f32;
    if !(single.is_finite() && single > 0.0) {
        return Err((
            FIELD,
            format!("is {value}; expected a positive number of pixels"),
        ));
    }
    Ok([single; 2])
}
