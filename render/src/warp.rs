//! Maps from the unit square to directions, in the local frame (z = normal), with their densities.
//!
//! Densities are per solid angle (1/sr) of the direction returned, zero where it cannot be drawn.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::math::fast_sin_cos;

/// A direction of the upper hemisphere with density cos θ / π (Malley's method).
#[inline(always)]
pub fn cosine(u: [f32; 2]) -> Vec3 {
    let (sin, cos) = fast_sin_cos(u[1]);
    let r = u[0].sqrt();
    Vec3::new(r * cos, r * sin, (1.0 - u[0]).max(0.0).sqrt())
}

/// Density of [`cosine`].
#[inline(always)]
pub fn cosine_density(direction: Vec3) -> f32 {
    direction.z.max(0.0) * FRAC_1_PI
}

/// The Trowbridge–Reitz (GGX) distribution of normals (S3), `alpha` as printed (glTF roughness is its square root).
#[inline(always)]
pub fn ggx(cos_half: f32, alpha: f32) -> f32 {
    // 1 + (α² − 1)cos² loses its digits at small α near the pole: sin² + α²cos² is the same without cancellation.
    let a2 = alpha * alpha;
    let cos2 = cos_half * cos_half;
    let s = (1.0 - cos2).max(0.0) + a2 * cos2;
    a2 / (PI * s * s)
}

/// A half vector with density D(cos) · cos per solid angle of half vectors: the paper's S9.
pub fn ggx_half_vector(u: [f32; 2], alpha: f32) -> Vec3 {
    let (sin, cos) = fast_sin_cos(u[1]);
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

/// A half vector among those visible from `outgoing`, which must be above the surface.
///
/// Heitz, "Sampling the GGX Distribution of Visible Normals", JCGT 7(4), 2018, by the spherical caps of Dupuy & Benyoub,
/// "Sampling Visible GGX Normals with Spherical Caps", HPG 2023: the reflections of a hemisphere's visible normals are
/// uniform on a cap.
#[inline(always)]
pub fn ggx_visible_normal(u: [f32; 2], outgoing: Vec3, alpha: f32) -> Vec3 {
    let view = unit(Vec3::new(
        alpha * outgoing.x,
        alpha * outgoing.y,
        outgoing.z,
    ));
    let (sin, cos) = fast_sin_cos(u[1]);
    let z = (1.0 - u[0]) * (1.0 + view.z) - view.z;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let half = Vec3::new(r * cos, r * sin, z) + view;
    unit(Vec3::new(alpha * half.x, alpha * half.y, half.z.max(1e-7)))
}

/// Density of the direction `incident` got by reflecting `outgoing` at a half vector of [`ggx_visible_normal`].
#[inline(always)]
pub fn ggx_visible_normal_density(incident: Vec3, outgoing: Vec3, alpha: f32) -> f32 {
    let half = unit(incident + outgoing);
    let above = half.dot(outgoing) > 0.0 && half.z > 0.0 && outgoing.z > 0.0;
    let density = ggx_visible_density(half.z, outgoing.z, alpha);
    if above { density } else { 0.0 }
}

/// The same from the cosines of half vector and `outgoing`, both above the surface: G₁(o) D(h) / (4 cos o), with Smith's G₁.
#[inline(always)]
pub fn ggx_visible_density(half: f32, outgoing: f32, alpha: f32) -> f32 {
    // G₁ = 2 cos / (cos + √(α² + (1 − α²) cos²)), the cosine cancelled against the denominator.
    let a2 = alpha * alpha;
    let root = (a2 + (1.0 - a2) * outgoing * outgoing).sqrt();
    ggx(half, alpha) / (2.0 * (outgoing + root))
}

/// The mirror image of `outgoing` about `half`.
#[inline(always)]
pub fn reflect(outgoing: Vec3, half: Vec3) -> Vec3 {
    2.0 * outgoing.dot(half) * half - outgoing
}

/// A vector scaled to unit length, or zero where it has none; without a branch.
#[inline(always)]
pub(crate) fn unit(v: Vec3) -> Vec3 {
    v * (1.0 / v.length_squared().max(f32::MIN_POSITIVE).sqrt())
}
