//! What a surface reflects of many directions at once: a value an array, so that every step becomes SIMD.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use render::bsdf::{Cosines, microfacet};

use super::transport::Lobe;

/// Light that reaches a view from several sources.
#[derive(Clone, Debug, Default)]
pub struct Arriving {
    /// Its sources.
    pub source: Vec<u32>,
    /// Their weights.
    pub weight: Vec<f32>,
    /// x, y and z of unit directions towards them.
    direction: [Vec<f32>; 3],
    cosines: Seen,
}

/// Cosines of those directions at a surface, seen from somewhere.
#[derive(Clone, Debug, Default)]
struct Seen {
    outgoing: f32,
    incident: Vec<f32>,
    half: Vec<f32>,
    difference: Vec<f32>,
    /// One where both directions are above the surface, else zero.
    above: Vec<f32>,
}

/// Reflectance (1/sr) of an albedo of one and of the lobe, by source.
#[derive(Clone, Debug, Default)]
pub struct Reflected {
    /// Of an albedo of one.
    pub diffuse: Vec<f32>,
    /// Of the lobe.
    pub specular: Vec<f32>,
}

impl Arriving {
    /// Puts other light in place of what was there.
    pub fn replace(&mut self, light: impl Iterator<Item = (usize, f32, Vec3)>) {
        self.source.clear();
        self.weight.clear();
        self.direction.iter_mut().for_each(Vec::clear);
        for (source, weight, direction) in light {
            self.source.push(source as u32);
            self.weight.push(weight);
            (0..3).for_each(|axis| self.direction[axis].push(direction[axis]));
        }
    }

    /// The unit direction towards the `k`th source.
    pub fn direction(&self, k: usize) -> Vec3 {
        let [x, y, z] = &self.direction;
        Vec3::new(x[k], y[k], z[k])
    }

    /// Looks at a surface of this normal from `outgoing`, both of unit length. Directions just below the surface graze it, as in
    /// [`reflect`](super::transport::reflect).
    pub fn see(&mut self, normal: Vec3, outgoing: Vec3) {
        let outgoing = crate::reconstruct::shading::just_seen(normal, outgoing);
        let count = self.source.len();
        let Self {
            direction, cosines, ..
        } = self;
        cosines.outgoing = normal.dot(outgoing);
        for values in [
            &mut cosines.incident,
            &mut cosines.half,
            &mut cosines.difference,
            &mut cosines.above,
        ] {
            values.resize(count, 0.0);
        }
        Arch::new().dispatch(Look {
            normal,
            outgoing,
            direction: [0, 1, 2].map(|axis| &direction[axis][..count]),
            cosines,
        });
    }

    /// What a surface reflects as it was last [`see`](Self::see)n.
    pub fn reflect(&self, lobe: Option<Lobe>, reflected: &mut Reflected) {
        let count = self.source.len();
        reflected.diffuse.resize(count, 0.0);
        reflected.specular.resize(count, 0.0);
        let Some(lobe) = lobe else {
            reflected.diffuse.fill(FRAC_1_PI);
            reflected.specular.fill(0.0);
            return;
        };
        Arch::new().dispatch(Reflect {
            cosines: &self.cosines,
            lobe,
            diffuse: &mut reflected.diffuse,
            specular: &mut reflected.specular,
        });
    }
}

struct Look<'a> {
    normal: Vec3,
    outgoing: Vec3,
    direction: [&'a [f32]; 3],
    cosines: &'a mut Seen,
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            normal,
            outgoing,
            direction: [x, y, z],
            cosines,
        } = self;
        let count = x.len();
        let (y, z) = (&y[..count], &z[..count]);
        let incident = &mut cosines.incident[..count];
        let half = &mut cosines.half[..count];
        let difference = &mut cosines.difference[..count];
        let above = &mut cosines.above[..count];
        let seen = cosines.outgoing > 0.0;
        for i in 0..count {
            let [mut dx, mut dy, mut dz] = [x[i], y[i], z[i]];
            let tilt = 0.02 - (normal.x * dx + normal.y * dy + normal.z * dz);
            let tilt = if tilt > 0.0 { tilt } else { 0.0 };
            (dx, dy, dz) = (
                dx + tilt * normal.x,
                dy + tilt * normal.y,
                dz + tilt * normal.z,
            );
            let length = 1.0 / (dx * dx + dy * dy + dz * dz).sqrt();
            (dx, dy, dz) = (dx * length, dy * length, dz * length);
            let (hx, hy, hz) = (dx + outgoing.x, dy + outgoing.y, dz + outgoing.z);
            let square = hx * hx + hy * hy + hz * hz;
            let scale = if square > 1e-20 {
                1.0 / square.sqrt()
            } else {
                0.0
            };
            let (hx, hy, hz) = (hx * scale, hy * scale, hz * scale);
            let cosine = normal.x * dx + normal.y * dy + normal.z * dz;
            incident[i] = cosine;
            half[i] = normal.x * hx + normal.y * hy + normal.z * hz;
            difference[i] = hx * dx + hy * dy + hz * dz;
            let both = (cosine > 0.0) & seen & (scale > 0.0);
            above[i] = if both { 1.0 } else { 0.0 };
        }
    }
}

struct Reflect<'a> {
    cosines: &'a Seen,
    lobe: Lobe,
    diffuse: &'a mut [f32],
    specular: &'a mut [f32],
}

impl WithSimd for Reflect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            cosines,
            lobe,
            diffuse,
            specular,
        } = self;
        let count = diffuse.len();
        let incident = &cosines.incident[..count];
        let half = &cosines.half[..count];
        let difference = &cosines.difference[..count];
        let above = &cosines.above[..count];
        let specular = &mut specular[..count];
        for i in 0..count {
            let at = Cosines {
                incident: incident[i],
                outgoing: cosines.outgoing,
                half: half[i],
                difference: difference[i],
            };
            let (factor, lobe) = microfacet(at, lobe.alpha, lobe.kappa);
            let shown = above[i] > 0.0;
            diffuse[i] = if shown { FRAC_1_PI * factor } else { 0.0 };
            specular[i] = if shown { lobe } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use render::sampler::SampleKey;

    use super::*;
    use crate::criticism::transport::reflect;

    #[test]
    fn all_at_once_are_one_by_one() {
        let mut stream = SampleKey::default().stream();
        let mut number = || 2.0 * stream.uniform() - 1.0;
        let mut unit = || Vec3::new(number(), number(), number()).normalize_or(Vec3::X);
        let (mut arriving, mut reflected) = (Arriving::default(), Reflected::default());
        let mut dark = 0;
        for round in 0..40 {
            let (normal, outgoing) = (unit(), unit());
            let light: Vec<(usize, f32, Vec3)> = (0..37 * round % 101)
                .map(|k| (k, 0.1 * k as f32, unit()))
                .collect();
            arriving.replace(light.iter().copied());
            arriving.see(normal, outgoing);
            let some = Lobe {
                alpha: 0.1 + 0.02 * round as f32,
                kappa: 0.04,
            };
            for lobe in [None, Some(some)] {
                arriving.reflect(lobe, &mut reflected);
                assert_eq!(reflected.diffuse.len(), light.len());
                for (k, (_, weight, incident)) in light.iter().enumerate() {
                    let (d, s) = reflect(lobe, normal, *incident, outgoing);
                    assert_eq!(
                        (arriving.source[k], arriving.weight[k]),
                        (k as u32, *weight)
                    );
                    let near = |a: f32, b: f32| (a - b).abs() <= 2e-5 * b.abs() + 1e-7;
                    assert!(
                        near(reflected.diffuse[k], d),
                        "{} for {d}",
                        reflected.diffuse[k]
                    );
                    assert!(
                        near(reflected.specular[k], s),
                        "{} for {s}",
                        reflected.specular[k]
                    );
                    dark += usize::from(d == 0.0);
                }
            }
        }
        assert!(dark < 40);
    }
}
