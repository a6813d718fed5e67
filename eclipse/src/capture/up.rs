//! Which way is up in a capture, and its turn into the world of all that follows, whose z points up.

use std::str::FromStr;

use glam::{Mat3, Mat4, Vec3};
use render::camera::Camera;

use super::Capture;

/// The axis of a capture's own world that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)] // The names are those of the axes.
pub enum UpAxis {
    X,
    Y,
    #[default]
    Z,
    NegX,
    NegY,
    NegZ,
}

impl UpAxis {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::X,
        Self::Y,
        Self::Z,
        Self::NegX,
        Self::NegY,
        Self::NegZ,
    ];

    /// As it is typed.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::NegX => "-x",
            Self::NegY => "-y",
            Self::NegZ => "-z",
        }
    }

    /// The rotation that brings this axis to z, by quarters of a turn about one other axis: no number is rounded.
    pub fn turn(self) -> Mat3 {
        let [x, y, z] = match self {
            Self::X => [Vec3::Z, Vec3::Y, Vec3::NEG_X],
            Self::Y => [Vec3::X, Vec3::Z, Vec3::NEG_Y],
            Self::Z => [Vec3::X, Vec3::Y, Vec3::Z],
            Self::NegX => [Vec3::NEG_Z, Vec3::Y, Vec3::X],
            Self::NegY => [Vec3::X, Vec3::NEG_Z, Vec3::Y],
            Self::NegZ => [Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z],
        };
        Mat3::from_cols(x, y, z)
    }

    /// The axis nearest to `direction`.
    pub fn nearest(direction: Vec3) -> Self {
        let along = |axis: Self| axis.turn().transpose() * Vec3::Z;
        let nearer = |a: &Self, b: &Self| {
            let [a, b] = [*a, *b].map(|axis| along(axis).dot(direction));
            a.total_cmp(&b)
        };
        Self::ALL.into_iter().max_by(nearer).unwrap_or_default()
    }

    /// A camera of the capture's own world in the world whose z points up.
    pub fn turned(self, camera: Camera) -> Camera {
        // Not even the sign of a zero is touched where nothing is to be done.
        if self == Self::Z {
            return camera;
        }
        Camera {
            world_from_camera: Mat4::from_mat3(self.turn()) * camera.world_from_camera,
            ..camera
        }
    }
}

impl FromStr for UpAxis {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let named = Self::ALL.into_iter().find(|axis| axis.name() == name);
        named.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("expected one of {names}")
        })
    }
}

impl Capture {
    /// Brings `up` to z: cameras, mesh, lamps and the place of the origin.
    pub(super) fn turn(&mut self, up: UpAxis) {
        if up == UpAxis::Z {
            return;
        }
        let turn = up.turn();
        let mesh = &mut self.mesh;
        for vector in mesh.positions.iter_mut().chain(&mut mesh.normals) {
            *vector = turn * *vector;
        }
        for frame in &mut self.frames {
            frame.camera = up.turned(frame.camera.clone());
        }
        for lamp in self.lamps.iter_mut().flat_map(|known| &mut known.lamps) {
            lamp.direction = turn * lamp.direction;
        }
        self.centre = turn * self.centre;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_turns_up_and_nothing_is_mirrored() {
        let axes = [
            Vec3::X,
            Vec3::Y,
            Vec3::Z,
            Vec3::NEG_X,
            Vec3::NEG_Y,
            Vec3::NEG_Z,
        ];
        for (up, axis) in UpAxis::ALL.into_iter().zip(axes) {
            assert_eq!(up.turn() * axis, Vec3::Z, "{up:?}");
            assert_eq!(up.turn().determinant(), 1.0, "{up:?}");
            assert_eq!(up.name().parse(), Ok(up));
            let leaning = axis + Vec3::new(0.3, -0.4, 0.2);
            assert_eq!(UpAxis::nearest(leaning), up);
        }
        assert!("up".parse::<UpAxis>().unwrap_err().contains("-y"));
    }

    #[test]
    fn a_camera_keeps_what_it_sees() {
        let eye = Vec3::new(3.0, -2.0, 1.5);
        let camera = Camera::look_at(64, 48, 0.5, eye, Vec3::ZERO);
        let point = Vec3::new(0.2, -0.3, 0.1);
        for up in UpAxis::ALL {
            let turned = up.turned(camera.clone());
            assert_eq!(turned.centre(), up.turn() * eye, "{up:?}");
            let [x, y] = camera.project(point).unwrap();
            let [u, v] = turned.project(up.turn() * point).unwrap();
            assert!((x - u).abs() < 1e-4 && (y - v).abs() < 1e-4, "{up:?}");
        }
    }
}
