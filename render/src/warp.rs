//! Maps from the unit square to directions, in the local frame (z = normal), with their densities.
//!
//! Densities are per solid angle (1/sr) of the direction returned, zero where it cannot be drawn.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::Vec3;

/// A direction of the upper hemisphere with density cos θ / π (Malley's method).
pub fn cosine(u: [f32; 2]) -> Vec3 {
    let (sin, cos) = (TAU * u[1]).sin_cos();
    let r = u[0].sqrt();
    Vec3::new(r * cos, r * sin, (1.0 - u[0]).max(0.0).sqrt())
}

/// Density of [`cosine`].
pub fn cosine_density(direction: Vec3) -> f32 {
    direction.z.max(0.0) * FRAC_1_PI
}

/// The Trowbridge–Reitz (GGX) distribution of normals (S3), `alpha` as printed (glTF roughness is its square root).
pub fn ggx(cos_half: f32, alpha: f32) -> f32 {
    // 1 + (α² − 1)cos² loses its digits at small α near the pole: sin² + α²cos² is the same without cancellation.
    let a2 = alpha * alpha;
    let cos2 = cos_half * cos_half;
    let s = (1.0 - cos2).max(0.0) + a2 * cos2;
    a2 / (PI * s * s)
}

/// A half vector with density D(cos) · cos per solid angle of half vectors: the paper's S9.
pub fn ggx_half_vector(u: [f32; 2], alpha: f32) -> Vec3 {
    let (sin, cos) = (TAU * u[1]).sin_cos();
    let cos2 = (1.0 - u[0]) / (1.0 + (alpha * alpha - 1.0) * u[0]);
    let r = (1.0 - cos2).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, cos2.max(0.0).sqrt())
}

/// Density of the direction `incident` got by reflecting `outgoing` at a half vector of [`ggx_half_vector`].
pub fn ggx_half_vector_density(incident: Vec3, outgoing: Vec3, alpha: f32) -> f32 {
    let half = (incident + outgoing).normalize_or_zero();
    let cos = half.dot(outgoing);
    if cos <= 0.0 || half.z <= 0.0 {
        return 0.0;
    }
    ggx(half.z, alpha) * half.z / (4.0 * cos)
}

/// A half vector among those visible from `outgoing` (Heitz, "Sampling the GGX Distribution of Visible Normals",
/// JCGT 7(4), 2018). `outgoing` must be above the surface.
pub fn ggx_visible_normal(u: [f32; 2], outgoing: Vec3, alpha: f32) -> Vec3 {
    let view = Vec3::new(alpha * outgoing.x, alpha * outgoing.y, outgoing.z).normalize();
    let length2 = view.x * view.x + view.y * view.y;
    let t1 = if length2 > 0.0 {
        Vec3::new(-view.y, view.x, 0.0) / length2.sqrt()
    } else {
        Vec3::X
    };
    let t2 = view.cross(t1);
    let r = u[0].sqrt();
    let (sin, cos) = (TAU * u[1]).sin_cos();
    let p1 = r * cos;
    let s = 0.5 * (1.0 + view.z);
    let p2 = (1.0 - s) * (1.0 - p1 * p1).max(0.0).sqrt() + s * r * sin;
    let p3 = (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt();
    let stretched = p1 * t1 + p2 * t2 + p3 * view;
    Vec3::new(
        alpha * stretched.x,
        alpha * stretched.y,
        stretched.z.max(1e-7),
    )
    .normalize()
}

/// Density of the direction `incident` got by reflecting `outgoing` at a half vector of [`ggx_visible_normal`]:
/// G₁(o) D(h) / (4 cos o), with Smith's G₁.
pub fn ggx_visible_normal_density(incident: Vec3, outgoing: Vec3, alpha: f32) -> f32 {
    let half = (incident + outgoing).normalize_or_zero();
    if half.dot(outgoing) <= 0.0 || half.z <= 0.0 || outgoing.z <= 0.0 {
        return 0.0;
    }
    // G₁ = 2 cos / (cos + √(α² + (1 − α²) cos²)), the cosine cancelled against the denominator.
    let a2 = alpha * alpha;
    let root = (a2 + (1.0 - a2) * outgoing.z * outgoing.z).sqrt();
    ggx(half.z, alpha) / (2.0 * (outgoing.z + root))
}

/// The mirror image of `outgoing` about `half`.
pub fn reflect(outgoing: Vec3, half: Vec3) -> Vec3 {
    2.0 * outgoing.dot(half) * half - outgoing
}
