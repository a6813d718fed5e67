//! A person who holds the camera, as seen from the object: capsules for head, trunk, arms and legs.

use glam::Vec3;
use render::{image::Image, lat_long::LatLong};

/// Body height over camera distance: 1.8 m seen from 2.5 m.
const HEIGHT: f32 = 0.72;
/// The camera is held in front of the face, at this share of the height.
const EYES: f32 = 0.92;
/// Rays a texel are the square of this.
const SIDE: usize = 4;

/// Transmittance of the person behind a camera at `eye`, `size` times as tall as usual, seen from the origin on `grid`.
pub(super) fn mask(eye: Vec3, grid: LatLong, size: f32) -> Image {
    let body = body(eye, size);
    let mut mask = Image::filled(grid.columns, grid.rows, 1, 1.0);
    for (index, value) in mask.data.iter_mut().enumerate() {
        let (row, column) = (index / grid.columns, index % grid.columns);
        let blocked = (0..SIDE * SIDE).filter(|part| {
            let place = [part % SIDE, part / SIDE].map(|k| (k as f32 + 0.5) / SIDE as f32);
            let direction = grid.direction_within(row, column, place);
            body.iter().any(|capsule| capsule.blocks(direction))
        });
        *value = 1.0 - blocked.count() as f32 / (SIDE * SIDE) as f32;
    }
    mask
}

/// All points within `radius` of the segment from `from` to `to`.
struct Capsule {
    from: Vec3,
    to: Vec3,
    radius: f32,
}

impl Capsule {
    /// Whether a ray from the origin meets it.
    fn blocks(&self, direction: Vec3) -> bool {
        // Across the ray, the segment's distance is a parabola in t: its minimum, within the segment, decides.
        let axis = self.to - self.from;
        let along = axis.dot(direction);
        let denominator = axis.length_squared() - along * along;
        let start = self.from.dot(direction);
        let t = if denominator > 1e-12 {
            ((start * along - self.from.dot(axis)) / denominator).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let point = self.from + t * axis;
        let ahead = point.dot(direction);
        ahead > 0.0 && (point - ahead * direction).length() <= self.radius
    }
}

/// Somebody upright who looks at the origin along the camera, with both hands at it.
fn body(eye: Vec3, size: f32) -> Vec<Capsule> {
    let height = size * HEIGHT * eye.length();
    let outward = eye.with_z(0.0).try_normalize().unwrap_or(Vec3::X);
    let across = Vec3::Z.cross(outward);
    let feet = eye + 0.12 * height * outward - EYES * height * Vec3::Z;
    let at = |sideways: f32, up: f32| feet + height * (sideways * across + up * Vec3::Z);
    let capsule = |from, to, radius: f32| Capsule {
        from,
        to,
        radius: radius * height,
    };
    let mut body = vec![
        capsule(at(0.0, 0.90), at(0.0, 0.94), 0.06),
        capsule(at(0.0, 0.52), at(0.0, 0.76), 0.10),
    ];
    for side in [-1.0, 1.0] {
        body.push(capsule(at(side * 0.06, 0.03), at(side * 0.05, 0.5), 0.05));
        body.push(capsule(at(side * 0.13, 0.78), at(side * 0.19, 0.6), 0.035));
        body.push(capsule(
            at(side * 0.19, 0.6),
            eye - 0.05 * height * Vec3::Z,
            0.03,
        ));
    }
    body
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_person_stands_upright_behind_the_camera() {
        let grid = LatLong::new(50, 100);
        let eye = Vec3::new(0.0, 4.0, 1.0);
        let mask = mask(eye, grid, 1.0);
        let towards = |direction: Vec3| mask.data[grid.nearest(direction.normalize())];
        // The head is narrower than two texels.
        assert!(towards(eye + Vec3::new(0.0, 0.5, 0.0)) < 0.5);
        assert_eq!(towards(eye - Vec3::new(0.0, 0.0, 0.9)), 0.0);
        for clear in [
            -eye,
            eye + Vec3::Z,
            eye - 3.0 * Vec3::Z,
            eye + Vec3::X,
            eye - Vec3::X,
        ] {
            assert_eq!(towards(clear), 1.0, "{clear}");
        }
        // Upright: far higher than wide.
        let blocked: Vec<usize> = (0..mask.data.len())
            .filter(|&i| mask.data[i] < 0.5)
            .collect();
        let extent = |of: fn(usize) -> usize| {
            let values = blocked.iter().map(|&i| of(i));
            values.clone().max().unwrap() - values.min().unwrap() + 1
        };
        assert!(extent(|i| i / 100) > extent(|i| i % 100));
    }

    #[test]
    fn capsules_block_what_meets_them_and_nothing_behind_the_origin() {
        let capsule = Capsule {
            from: Vec3::new(2.0, 0.0, -1.0),
            to: Vec3::new(2.0, 0.0, 1.0),
            radius: 0.1,
        };
        assert!(capsule.blocks(Vec3::X));
        assert!(!capsule.blocks(-Vec3::X));
        assert!(capsule.blocks(Vec3::new(2.0, 0.09, 0.5).normalize()));
        assert!(!capsule.blocks(Vec3::new(2.0, 0.12, 0.5).normalize()));
        assert!(capsule.blocks(Vec3::new(2.0, 0.0, 1.05).normalize()));
        assert!(!capsule.blocks(Vec3::new(2.0, 0.0, 1.3).normalize()));
    }
}
