//! Where a ray from a surface point looks the masks up: one surface around the object for all frames.
//!
//! Frames share their lookups, so that the tape works on all of them at once; that is exact when the cameras' distances agree.

use glam::Vec3;
use render::{
    camera::Camera,
    lat_long::{Bilinear, LatLong},
    occluder::shell_direction,
};

/// The surface that occluders are painted on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shell {
    /// A sphere about the origin through the cameras (Eq. 5).
    Sphere(f32),
    /// An upright cylinder about the origin's vertical through the cameras: a standing person is about as far at the feet as
    /// at the head, seen from above.
    Cylinder(f32),
}

/// Beyond this many radii the cylinder's end is as good as infinitely far.
const FAR: f32 = 3.0;

impl Shell {
    /// The sphere at the cameras' mean distance.
    pub fn sphere<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Self {
        Self::Sphere(mean(cameras.map(|camera| camera.distance())))
    }

    /// The cylinder at the cameras' mean horizontal distance.
    pub fn cylinder<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Self {
        Self::Cylinder(mean(
            cameras.map(|camera| camera.centre().truncate().length()),
        ))
    }

    /// The direction from the origin of the place where a ray from `point` leaves the shell.
    pub fn direction(&self, point: Vec3, direction: Vec3) -> Vec3 {
        match *self {
            Self::Sphere(radius) => shell_direction(point, direction, radius),
            Self::Cylinder(radius) => {
                let a = direction.truncate().length_squared().max(1e-9);
                let b = point.truncate().dot(direction.truncate());
                let c = point.truncate().length_squared() - radius * radius;
                let t = (-b + (b * b - a * c).max(0.0).sqrt()) / a;
                (point + direction * t.min(FAR * radius)).normalize()
            }
        }
    }

    /// The mask's texels that a ray looks up.
    pub fn lookup(&self, grid: LatLong, point: Vec3, direction: Vec3) -> Bilinear {
        grid.bilinear(self.direction(point, direction))
    }
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), v| (sum + v, count + 1));
    sum / count.max(1) as f32
}
