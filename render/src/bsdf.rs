//! Reflectance: Lambert, and Unreal's GGX of the paper's supplement (S1–S7).
//!
//! The printed diffuse term carries an (n·ωi)₊ besides the cosine of the rendering integral, which would count the
//! cosine twice (a white surface would reflect two thirds); it is dropped here. Everything else is as printed: Fresnel at
//! n·ωi and at h·ωi, α as it stands in D (glTF roughness is √α), κ the reflectance at normal incidence.

use std::f64::consts::PI;

use glam::Vec3;

use crate::math::{Float, Frame};
use crate::warp;

/// Which reflectance a surface has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// ρ/π.
    Lambertian,
    /// Diffuse under a GGX coat.
    Microfacet,
}

/// The parameters of the surface at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse albedo ρ, RGB, of [0, 1].
    pub albedo: [f32; 3],
    /// Roughness α, of (0, 1].
    pub alpha: f32,
    /// Specular reflectance at normal incidence κ, of [0, 1].
    pub kappa: f32,
}

/// The cosines that the reflectance depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cosines<T> {
    /// n·ωi.
    pub incident: T,
    /// n·ωo.
    pub outgoing: T,
    /// n·h.
    pub half: T,
    /// h·ωi.
    pub difference: T,
}

impl Cosines<f32> {
    /// Of unit vectors in the world; `None` unless both directions are above the surface.
    pub fn new(normal: Vec3, incident: Vec3, outgoing: Vec3) -> Option<Self> {
        let (i, o) = (normal.dot(incident), normal.dot(outgoing));
        let half = (incident + outgoing).try_normalize()?;
        (i > 0.0 && o > 0.0).then(|| Self {
            incident: i,
            outgoing: o,
            half: normal.dot(half),
            difference: half.dot(incident),
        })
    }
}

/// The factor of ρ/π and the specular reflectance (1/sr) of the GGX model: f = ρ/π · factor + specular.
#[inline(always)]
pub fn microfacet<T: Float>(cosines: Cosines<T>, alpha: T, kappa: T) -> (T, T) {
    let Cosines {
        incident,
        outgoing,
        half,
        difference,
    } = cosines;
    let fresnel = fresnel(difference, kappa);
    let factor = (T::ONE - self::fresnel(incident, kappa)) * (T::ONE - fresnel);
    // D, with sin² + α² cos² for the printed 1 + (α² − 1) cos².
    let a2 = alpha * alpha;
    let cos2 = half * half;
    let s = (T::ONE - cos2).max(T::ZERO) + a2 * cos2;
    let d = a2 / (T::from_f64(PI) * s * s);
    // G / (4 cos cos): the cosines of S5 cancel against the denominator.
    let k = (alpha + T::ONE) * (alpha + T::ONE) / T::from_f64(8.0);
    let lobe = |cos: T| k + (T::ONE - k) * cos;
    let specular = d * fresnel / (T::from_f64(4.0) * lobe(incident) * lobe(outgoing));
    (factor, specular)
}

/// Schlick's Fresnel factor (S2).
#[inline(always)]
pub fn fresnel<T: Float>(cos: T, kappa: T) -> T {
    let x = (T::ONE - cos).max(T::ZERO);
    let x2 = x * x;
    kappa + (T::ONE - kappa) * x2 * x2 * x
}

impl Model {
    /// The reflectance f (1/sr), RGB, for unit vectors in the world; zero unless both directions are above the surface.
    pub fn evaluate(
        self,
        material: &Material,
        normal: Vec3,
        incident: Vec3,
        outgoing: Vec3,
    ) -> [f32; 3] {
        let diffuse = material.albedo.map(|rho| rho * std::f32::consts::FRAC_1_PI);
        match self {
            Self::Lambertian if normal.dot(incident) > 0.0 => diffuse,
            Self::Lambertian => [0.0; 3],
            Self::Microfacet => match Cosines::new(normal, incident, outgoing) {
                Some(cosines) => {
                    let (factor, specular) = microfacet(cosines, material.alpha, material.kappa);
                    diffuse.map(|d| d * factor + specular)
                }
                None => [0.0; 3],
            },
        }
    }
}

/// A distribution of incident directions that follows the material: a cosine lobe, mixed for GGX with its visible normals.
#[derive(Clone, Copy, Debug)]
pub struct MaterialSampler {
    pub(crate) frame: Frame,
    /// In the frame.
    pub(crate) outgoing: Vec3,
    pub(crate) alpha: f32,
    pub(crate) cosine_share: f32,
}

/// One part of the mixture of [`MaterialSampler`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lobe {
    /// By the cosine.
    Cosine,
    /// Mirrored at a visible normal.
    VisibleNormal,
}

/// How many of `samples` are drawn from each lobe: the cosine's first.
///
/// Most light of a dielectric is diffuse; half keeps the weight of any sample below twice that of its own lobe. Numbers
/// fixed beforehand have less variance than lobes drawn by chance, and the mixture's density in the weight suits both.
pub fn lobe_samples(model: Model, samples: usize) -> [usize; 2] {
    match model {
        Model::Lambertian => [samples, 0],
        Model::Microfacet => [samples.div_ceil(2), samples / 2],
    }
}

impl MaterialSampler {
    /// The distribution at a surface of unit `normal` seen from the unit direction `outgoing`, with a share of the cosine
    /// lobe. A view from below the shading normal (interpolated normals allow it) sees the cosine lobe alone.
    #[inline(always)]
    pub fn new(cosine_share: f32, alpha: f32, normal: Vec3, outgoing: Vec3) -> Self {
        let frame = Frame::new(normal);
        let outgoing = frame.to_local(outgoing);
        Self {
            frame,
            outgoing,
            alpha,
            cosine_share: if outgoing.z > 0.0 { cosine_share } else { 1.0 },
        }
    }

    /// A direction of a lobe at `u` of [0, 1)²; it may fall below the surface, where f is zero.
    #[inline(always)]
    pub fn sample(&self, lobe: Lobe, u: [f32; 2]) -> Vec3 {
        let local = match lobe {
            Lobe::Cosine => warp::cosine(u),
            Lobe::VisibleNormal => {
                let half = warp::ggx_visible_normal(u, self.outgoing, self.alpha);
                warp::reflect(self.outgoing, half)
            }
        };
        self.frame.to_world(local)
    }

    /// The density (1/sr) of a unit direction in the mixture.
    pub fn density(&self, incident: Vec3) -> f32 {
        let local = self.frame.to_local(incident);
        let cosine = self.cosine_share * warp::cosine_density(local);
        if self.cosine_share == 1.0 {
            return cosine;
        }
        let specular = warp::ggx_visible_normal_density(local, self.outgoing, self.alpha);
        cosine + (1.0 - self.cosine_share) * specular
    }
}

/// The weight of a sample drawn from one of two strategies: power heuristic, exponent 2 (S11, S12).
///
/// `count` and `density` are of the strategy that drew it.
pub fn power_heuristic(count: f32, density: f32, other_count: f32, other_density: f32) -> f32 {
    let own = (count * density).powi(2);
    let other = (other_count * other_density).powi(2);
    if own > 0.0 { own / (own + other) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_match_the_printed_formula() {
        // S1–S7 without the extra cosine, written out once more in double precision and without cancellation.
        let (i, o, h, d, alpha, kappa) = (0.7_f64, 0.4_f64, 0.9_f64, 0.75_f64, 0.6_f64, 0.04_f64);
        let f = |c: f64| kappa + (1.0 - kappa) * (1.0 - c).powi(5);
        let dist = alpha * alpha / (PI * (1.0 + (alpha * alpha - 1.0) * h * h).powi(2));
        let k = (alpha + 1.0).powi(2) / 8.0;
        let g = |c: f64| c / (k + (1.0 - k) * c);
        let cosines = Cosines {
            incident: i,
            outgoing: o,
            half: h,
            difference: d,
        };
        let (factor, specular) = microfacet(cosines, alpha, kappa);
        assert!((factor - (1.0 - f(i)) * (1.0 - f(d))).abs() < 1e-12);
        assert!((specular - dist * f(d) * g(i) * g(o) / (4.0 * i * o)).abs() < 1e-12);
    }

    #[test]
    fn heuristic_weights_of_the_two_strategies_sum_to_one() {
        let w = power_heuristic(64.0, 0.3, 16.0, 2.0) + power_heuristic(16.0, 2.0, 64.0, 0.3);
        assert!((w - 1.0).abs() < 1e-6);
        assert_eq!(power_heuristic(1.0, 0.0, 1.0, 0.0), 0.0);
    }
}
