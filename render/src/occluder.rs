//! Unseen occluders: transmittance maps on a spherical shell around the scene (paper Eq. 4–6).

use glam::Vec3;

use crate::lat_long::{Bilinear, LatLong};

/// The unit direction from the origin of the place where a ray from `point` leaves the sphere of radius `radius` (Eq. 5).
///
/// `direction` has unit length and `point` is inside the sphere, so that there is exactly one such place.
#[inline]
pub fn shell_direction(point: Vec3, direction: Vec3, radius: f32) -> Vec3 {
    // Normalised anew: the caller's direction may be off by rounding.
    shell_place(point, direction, radius * radius - point.length_squared()).normalize()
}

/// The place itself, from `reach` = radius² − |point|²; a lookup needs no unit length.
#[inline(always)]
pub(crate) fn shell_place(point: Vec3, direction: Vec3, reach: f32) -> Vec3 {
    let along = point.dot(direction);
    let root = (along * along + reach.max(0.0)).sqrt();
    point + (root - along) * direction
}

/// Where a ray looks a mask up, at the radius of its shell.
#[inline(always)]
pub fn mask_lookup(grid: LatLong, point: Vec3, direction: Vec3, radius: f32) -> Bilinear {
    grid.bilinear(shell_direction(point, direction, radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shell_is_met_on_the_ray_and_ahead() {
        let point = Vec3::new(0.4, -0.7, 0.2);
        for direction in [Vec3::X, -Vec3::Z, Vec3::new(1.0, 2.0, -3.0).normalize()] {
            let radius = 3.5;
            let place = shell_direction(point, direction, radius) * radius;
            let t = (place - point).dot(direction);
            assert!(t > 0.0);
            assert!((point + t * direction - place).length() < 1e-5);
            assert!((place.length() - radius).abs() < 1e-5);
        }
    }

    #[test]
    fn from_the_centre_or_far_away_it_is_the_direction() {
        let direction = Vec3::new(1.0, 2.0, -3.0).normalize();
        assert!((shell_direction(Vec3::ZERO, direction, 2.0) - direction).length() < 1e-6);
        assert!((shell_direction(Vec3::X, direction, 1e4) - direction).length() < 2e-4);
    }
}
