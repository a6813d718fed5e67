//! Eq. 5 against the textbook intersection of a ray and a sphere.

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use render::occluder::shell_direction;

/// The far root of |x + tω|² = r², solved in double precision.
fn intersect(x: DVec3, direction: DVec3, radius: f64) -> DVec3 {
    let b = 2.0 * x.dot(direction);
    let c = x.length_squared() - radius * radius;
    let a = direction.length_squared();
    let t = (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a);
    (x + t * direction) / radius
}

proptest! {
    #[test]
    fn shell_directions_are_ray_sphere_intersections(
        (u, v) in (0.0..1.0_f32, 0.0..1.0_f32),
        (pu, pv, depth) in (0.0..1.0_f32, 0.0..1.0_f32, 0.0..0.95_f32),
        radius in 0.1..100.0_f32,
    ) {
        let direction = render::lat_long::LatLong::direction(u, v);
        let point = depth * radius * render::lat_long::LatLong::direction(pu, pv);
        let found = shell_direction(point, direction, radius);
        let expected = intersect(point.as_dvec3(), direction.as_dvec3(), f64::from(radius));
        prop_assert!((found.as_dvec3() - expected).length() < 2e-5, "{found} {expected}");
        prop_assert!((found.length() - 1.0).abs() < 1e-5);
        prop_assert!(found.is_finite() && found != Vec3::ZERO);
    }
}
