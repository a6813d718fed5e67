//! Where a ray from a surface point looks the masks up: surfaces around the object, each shared by a group of frames.
//!
//! Frames of a group share their lookups, so that the tape works on many of them at once; that is exact when their cameras'
//! distances agree, and a group holds only frames whose distances nearly do.

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

/// The shells of all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Shells {
    /// Frames that share a shell.
    pub groups: Vec<Group>,
    /// For every frame its group and its place in it.
    pub place: Vec<[usize; 2]>,
}

/// Frames that share a shell.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Where their rays look masks up.
    pub shell: Shell,
    /// The frames, ascending.
    pub frames: Vec<usize>,
}

/// Distances within a group differ by less than about this ratio.
const SPREAD: f32 = 1.15;
/// No more groups than keep this many frames in each: fewer would leave much of the tape's lots of frames empty.
const LEAST_FRAMES: usize = 12;

/// Most groups.
pub const MOST_GROUPS: usize = 6;

impl Shells {
    /// Spheres at the cameras' distances.
    pub fn spheres<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Self {
        let distances: Vec<f32> = cameras.map(Camera::distance).collect();
        Self::around(&distances)
    }

    /// Spheres of these radii.
    pub fn around(radii: &[f32]) -> Self {
        Self::group(radii, Shell::Sphere)
    }

    /// Cylinders at these horizontal distances.
    pub fn cylinders(distances: &[f32]) -> Self {
        Self::group(distances, Shell::Cylinder)
    }

    /// Cylinders at the cameras' own horizontal distances: how the frames fall into groups.
    pub fn of_cameras<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Self {
        let distances: Vec<f32> = cameras
            .map(|camera| {
                camera
                    .centre()
                    .truncate()
                    .length()
                    .max(0.1 * camera.distance())
            })
            .collect();
        Self::cylinders(&distances)
    }

    /// Equal parts of the frames in the order of their distances, each at its mean distance.
    fn group(distances: &[f32], shell: fn(f32) -> Shell) -> Self {
        let mut order: Vec<usize> = (0..distances.len()).collect();
        order.sort_by(|&a, &b| distances[a].total_cmp(&distances[b]).then(a.cmp(&b)));
        let ratio = match (order.first(), order.last()) {
            (Some(&near), Some(&far)) => distances[far] / distances[near].max(1e-9),
            _ => 1.0,
        };
        let wanted = (ratio.ln() / SPREAD.ln()).ceil().max(1.0) as usize;
        let count = wanted.min(order.len() / LEAST_FRAMES).clamp(1, MOST_GROUPS);
        let mut place = vec![[0; 2]; order.len()];
        let groups = (0..count)
            .map(|g| {
                let range = g * order.len() / count..(g + 1) * order.len() / count;
                let mut frames = order[range].to_vec();
                frames.sort_unstable();
                for (k, &frame) in frames.iter().enumerate() {
                    place[frame] = [g, k];
                }
                let sum: f32 = frames.iter().map(|&t| distances[t]).sum();
                Group {
                    shell: shell(sum / frames.len().max(1) as f32),
                    frames,
                }
            })
            .collect();
        Self { groups, place }
    }

    /// How many frames.
    pub fn frames(&self) -> usize {
        self.place.len()
    }

    /// The frames in the order of their groups.
    pub fn order(&self) -> Vec<usize> {
        self.groups
            .iter()
            .flat_map(|group| group.frames.iter().copied())
            .collect()
    }

    /// Where each frame stands in [`order`](Self::order).
    pub fn slots(&self) -> Vec<usize> {
        let mut slots = vec![0; self.frames()];
        for (slot, frame) in self.order().into_iter().enumerate() {
            slots[frame] = slot;
        }
        slots
    }

    /// The shell of a frame.
    pub fn of(&self, frame: usize) -> Shell {
        self.groups[self.place[frame][0]].shell
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_is_in_one_group_of_its_own_distance() {
        let distances: Vec<f32> = (0..64)
            .map(|t| 2.9 + 2.1 * ((t * 37 % 64) as f32) / 63.0)
            .collect();
        let shells = Shells::cylinders(&distances);
        assert!(shells.groups.len() > 1);
        for (t, distance) in distances.iter().enumerate() {
            let [group, k] = shells.place[t];
            assert_eq!(shells.groups[group].frames[k], t);
            let Shell::Cylinder(radius) = shells.of(t) else {
                panic!()
            };
            assert!((radius / distance).ln().abs() < 0.15, "{radius} {distance}");
        }
        assert_eq!(Shells::cylinders(&[2.0; 64]).groups.len(), 1);
        assert_eq!(Shells::cylinders(&[]).frames(), 0);
    }
}
