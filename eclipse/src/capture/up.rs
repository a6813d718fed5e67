//! Which way is up in a capture, and its turn into the world of all that follows, whose z points up.

use std::{borrow::Cow, str::FromStr};

use glam::{DMat3, DQuat, DVec3, Mat3, Mat4, Vec3};
use render::{camera::Camera, mesh::Mesh};

use super::Capture;

/// The axis of a capture's own world that points up, or a direction between its axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)] // The names are those of the axes.
pub enum UpAxis {
    X,
    Y,
    #[default]
    Z,
    NegX,
    NegY,
    NegZ,
    /// A direction between them, of any length: [`UpAxis::along`] makes it.
    Along(Vec3),
}

impl UpAxis {
    /// All axes.
    pub const ALL: [Self; 6] = [
        Self::X,
        Self::Y,
        Self::Z,
        Self::NegX,
        Self::NegY,
        Self::NegZ,
    ];

    /// The direction `up`, which is an axis where it lies along one; `None` for none: of no length, or not finite.
    pub fn along(up: Vec3) -> Option<Self> {
        if !up.is_finite() || up == Vec3::ZERO {
            return None;
        }
        let nearest = Self::nearest(up);
        let off = nearest.turn() * up;
        match off.x == 0.0 && off.y == 0.0 {
            true => Some(nearest),
            false => Some(Self::Along(up)),
        }
    }

    /// As it is typed, digit by digit: what is read from it is the same.
    pub fn name(self) -> Cow<'static, str> {
        let axis = match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::NegX => "-x",
            Self::NegY => "-y",
            Self::NegZ => "-z",
            Self::Along(Vec3 { x, y, z }) => return format!("{x},{y},{z}").into(),
        };
        axis.into()
    }

    /// The rotation that brings this axis to z, by quarters of a turn about one other axis: no number is rounded. A direction is
    /// brought there the shortest way.
    pub fn turn(self) -> Mat3 {
        let [x, y, z] = match self {
            Self::X => [Vec3::Z, Vec3::Y, Vec3::NEG_X],
            Self::Y => [Vec3::X, Vec3::Z, Vec3::NEG_Y],
            Self::Z => [Vec3::X, Vec3::Y, Vec3::Z],
            Self::NegX => [Vec3::NEG_Z, Vec3::Y, Vec3::X],
            Self::NegY => [Vec3::X, Vec3::NEG_Z, Vec3::Y],
            Self::NegZ => [Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z],
            Self::Along(up) => {
                // In double precision, in which the square of no length overflows or vanishes.
                let up = up.as_dvec3().normalize_or(DVec3::Z);
                let turn = DMat3::from_quat(DQuat::from_rotation_arc(up, DVec3::Z));
                return turn.as_mat3();
            }
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

    /// The middle of the mesh's bounding box in the world whose z points up, in the capture's own world: the boxes of both have the same
    /// where an axis is up, but not where a direction between them is.
    pub(super) fn middle(self, mesh: &Mesh) -> Vec3 {
        let middle = |[low, high]: [Vec3; 2]| 0.5 * low + 0.5 * high;
        let Self::Along(_) = self else {
            return middle(mesh.bounds());
        };
        let turn = self.turn();
        let positions = mesh.positions.iter().map(|position| turn * *position);
        let turned = Mesh {
            positions: positions.collect(),
            ..Mesh::default()
        };
        turn.transpose() * middle(turned.bounds())
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
        named.or_else(|| direction(name)).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("expected one of {names}, or a direction such as 0.1,-0.9,0.3")
        })
    }
}

/// Three numbers and what is between them.
fn direction(text: &str) -> Option<UpAxis> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let vector = <[f32; 3]>::try_from(numbers.ok()?).ok()?;
    UpAxis::along(vector.into())
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
            assert_eq!(UpAxis::along(2.5 * axis), Some(up));
            let leaning = axis + Vec3::new(0.3, -0.4, 0.2);
            assert_eq!(UpAxis::nearest(leaning), up);
        }
        assert!("up".parse::<UpAxis>().unwrap_err().contains("-y"));
    }

    #[test]
    fn a_direction_turns_up_and_is_read_as_it_was_written() {
        let directions = [
            Vec3::new(0.1, -0.9, 0.3),
            Vec3::new(-1e-3, 1e-3, -2.0),
            Vec3::new(3e30, -1e30, 2e29),
            Vec3::new(1e-30, 0.0, 1e-30),
            Vec3::new(1.0, 1.0, -1.0) / 3.0,
        ];
        for direction in directions {
            let up = UpAxis::along(direction).unwrap();
            assert_eq!(up, UpAxis::Along(direction));
            assert_eq!(up.name().parse(), Ok(up), "{}", up.name());
            let turn = up.turn();
            let unit = direction.as_dvec3().normalize().as_vec3();
            assert!((turn * unit).abs_diff_eq(Vec3::Z, 1e-6), "{up:?}");
            assert!((turn * turn.transpose()).abs_diff_eq(Mat3::IDENTITY, 1e-6));
            assert!((turn.determinant() - 1.0).abs() < 1e-6);
        }
        assert_eq!(" 0, -2,0".parse(), Ok(UpAxis::NegY));
        for text in ["0,0,0", "1,2", "1,2,3,4", "1,,2", "nan,0,1", "inf,0,0", ""] {
            let message = text.parse::<UpAxis>().unwrap_err();
            assert!(message.contains("or a direction such as"), "{text}");
        }
    }

    #[test]
    fn the_middle_is_that_of_the_box_in_the_world_that_is_upright() {
        let corners = [Vec3::ZERO, Vec3::X, 2.0 * Vec3::Y, Vec3::new(0.5, 0.1, 3.0)];
        let mesh = |turn: Mat3| Mesh {
            positions: corners.map(|corner| turn * corner).to_vec(),
            ..Mesh::default()
        };
        let [low, high] = mesh(Mat3::IDENTITY).bounds();
        let upright = 0.5 * low + 0.5 * high;
        let oblique = UpAxis::Along(Vec3::new(0.3, -0.5, 0.6));
        for up in UpAxis::ALL.into_iter().chain([oblique]) {
            let found = up.turn() * up.middle(&mesh(up.turn().transpose()));
            assert!(found.abs_diff_eq(upright, 1e-6), "{up:?} {found}");
        }
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
