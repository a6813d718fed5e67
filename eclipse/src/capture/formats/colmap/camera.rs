//! COLMAP's camera models, and which of them are understood.

use super::Problem;
use crate::capture::transforms::Intrinsics;

/// A camera model: its number in binary files, its name in text files, and what its parameters are.
pub(super) struct CameraModel {
    number: i32,
    name: &'static str,
    pub parameters: &'static [Parameter],
}

/// What a parameter of a camera is.
#[derive(Clone, Copy)]
pub(super) enum Parameter {
    Focal,
    FocalX,
    FocalY,
    CentreX,
    CentreY,
    K1,
    K2,
    P1,
    P2,
}

use Parameter::{CentreX, CentreY, Focal, FocalX, FocalY, K1, K2, P1, P2};

/// The models that a camera with OpenCV's `k1 k2 p1 p2` can be.
static SUPPORTED: [CameraModel; 5] = [
    CameraModel {
        number: 0,
        name: "SIMPLE_PINHOLE",
        parameters: &[Focal, CentreX, CentreY],
    },
    CameraModel {
        number: 1,
        name: "PINHOLE",
        parameters: &[FocalX, FocalY, CentreX, CentreY],
    },
    CameraModel {
        number: 2,
        name: "SIMPLE_RADIAL",
        parameters: &[Focal, CentreX, CentreY, K1],
    },
    CameraModel {
        number: 3,
        name: "RADIAL",
        parameters: &[Focal, CentreX, CentreY, K1, K2],
    },
    CameraModel {
        number: 4,
        name: "OPENCV",
        parameters: &[FocalX, FocalY, CentreX, CentreY, K1, K2, P1, P2],
    },
];

/// COLMAP's other models, by number, so that a message can name them.
static OTHERS: [&str; 6] = [
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
];

impl CameraModel {
    pub fn by_number(number: i32, place: &str) -> Result<&'static Self, Problem> {
        let found = SUPPORTED.iter().find(|model| model.number == number);
        found.ok_or_else(|| {
            let other = usize::try_from(number)
                .ok()
                .and_then(|number| OTHERS.get(number.checked_sub(SUPPORTED.len())?));
            unsupported(
                place,
                &other.map_or(format!("number {number}"), |name| (*name).to_owned()),
            )
        })
    }

    pub fn by_name(name: &str, place: &str) -> Result<&'static Self, Problem> {
        let found = SUPPORTED.iter().find(|model| model.name == name);
        found.ok_or_else(|| unsupported(place, name))
    }

    /// The intrinsics with these values of the parameters.
    pub fn intrinsics(
        &self,
        place: &str,
        [width, height]: [u64; 2],
        values: &[f64],
    ) -> Result<Intrinsics, Problem> {
        if values.len() != self.parameters.len() {
            return Err(Problem::new(
                place,
                format!(
                    "has {} PARAMS, but {} cameras have {}",
                    values.len(),
                    self.name,
                    self.parameters.len()
                ),
            ));
        }
        let most = 1_000_000;
        for (field, size) in [("WIDTH", width), ("HEIGHT", height)] {
            if size == 0 || size > most {
                return Err(Problem::new(
                    place,
                    format!("has {field} {size}; expected 1 to {most} pixels"),
                ));
            }
        }
        let mut intrinsics = Intrinsics {
            w: Some(width as f64),
            h: Some(height as f64),
            ..Intrinsics::default()
        };
        for (parameter, &value) in self.parameters.iter().zip(values) {
            if !value.is_finite() {
                return Err(Problem::new(
                    place,
                    format!("has {value} among its PARAMS; expected finite numbers"),
                ));
            }
            let value = Some(value);
            match parameter {
                Focal => (intrinsics.fl_x, intrinsics.fl_y) = (value, value),
                FocalX => intrinsics.fl_x = value,
                FocalY => intrinsics.fl_y = value,
                CentreX => intrinsics.cx = value,
                CentreY => intrinsics.cy = value,
                K1 => intrinsics.k1 = value,
                K2 => intrinsics.k2 = value,
                P1 => intrinsics.p1 = value,
                P2 => intrinsics.p2 = value,
            }
        }
        for focal in [intrinsics.fl_x, intrinsics.fl_y].into_iter().flatten() {
            if focal <= 0.0 {
                return Err(Problem::new(
                    place,
                    format!("has the focal length {focal}; expected a positive one, in pixels"),
                ));
            }
        }
        Ok(intrinsics)
    }
}

fn unsupported(place: &str, model: &str) -> Problem {
    let names: Vec<&str> = SUPPORTED.iter().map(|model| model.name).collect();
    let names = names.join(", ");
    Problem::new(
        place,
        format!(
            "has the MODEL {model}, which is not supported; expected one of {names}: undistort the images with `colmap image_undistorter`"
        ),
    )
}
