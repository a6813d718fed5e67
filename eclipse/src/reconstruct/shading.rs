//! How light, occluders and reflectance shade the sites in each frame, and the albedo that explains the photographs then.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use render::{
    bsdf::{Cosines, microfacet},
    bvh::SurfacePoint,
    image::Image,
    lat_long::LatLong,
    transport::TransportRow,
};

use super::{
    shell::{Group, Shells},
    tent::soften,
};

/// Unseen occluders, as plain numbers.
#[derive(Clone, Debug)]
pub struct Masks {
    grid: LatLong,
    shells: Shells,
    /// Transmittance, group by group of frames `[texel][frame of the group]`.
    transmittance: Vec<Vec<f32>>,
    /// The same as the light of each texel meets it.
    passed: Vec<Vec<f32>>,
}

impl Masks {
    /// Of transmittances `[texel][frame]` on `grid`, painted on these surfaces, before light on a grid of `light_rows`.
    pub fn new(grid: LatLong, light_rows: usize, shells: Shells, transmittance: Vec<f32>) -> Self {
        let by_group = |share: &[f32]| -> Vec<Vec<f32>> {
            let columns = |group: &Group| {
                let of_texel = share.chunks_exact(shells.frames());
                of_texel
                    .flat_map(|all| group.frames.iter().map(|&t| all[t]))
                    .collect()
            };
            shells.groups.iter().map(columns).collect()
        };
        let sharp = by_group(&transmittance);
        let mut passed = transmittance;
        soften(grid, light_rows, shells.frames(), &mut passed);
        Self {
            grid,
            transmittance: sharp,
            passed: by_group(&passed),
            shells,
        }
    }

    /// The share of a texel's light from the unit `direction` that reaches `point`, for all frames, group by group.
    fn passed(&self, point: Vec3, direction: Vec3, share: &mut [f32]) {
        self.lookup(&self.passed, point, direction, share);
    }

    fn lookup(&self, of: &[Vec<f32>], point: Vec3, direction: Vec3, share: &mut [f32]) {
        let mut rest = share;
        for (group, masks) in self.shells.groups.iter().zip(of) {
            let around = group.shell.lookup(self.grid, point, direction);
            let count = group.frames.len();
            let (own, others) = rest.split_at_mut(count);
            let [a, b, c, d] = around.index.map(|i| &masks[i as usize * count..][..count]);
            let w = around.weight;
            for k in 0..count {
                own[k] = w[0] * a[k] + w[1] * b[k] + w[2] * c[k] + w[3] * d[k];
            }
            rest = others;
        }
    }

    /// What is seen of them from the origin: a map of `rows` × 2·`rows` a frame.
    pub fn images(&self, rows: usize) -> Vec<Image> {
        let to = LatLong::new(rows, 2 * rows);
        let frames = self.shells.frames();
        let mut images = vec![Image::filled(to.columns, to.rows, 1, 1.0); frames];
        let mut share = vec![1.0; frames];
        let order = self.shells.order();
        for texel in 0..to.len() {
            let direction = to.texel_direction(texel / to.columns, texel % to.columns);
            self.lookup(&self.transmittance, Vec3::ZERO, direction, &mut share);
            for (&frame, &share) in order.iter().zip(&share) {
                images[frame].data[texel] = share;
            }
        }
        images
    }
}

/// Parameters of the specular lobe, the same all over the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// Its width α.
    pub alpha: f32,
    /// Reflectance at normal incidence κ.
    pub kappa: f32,
}

/// What lights the object.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// The grid of light.
    pub grid: LatLong,
    /// Radiance, `[texel][channel]`.
    pub radiance: &'a [f32],
    /// Occluders, if modelled.
    pub occluders: Option<&'a Masks>,
    /// Specular reflection; `None` for Lambertian surfaces.
    pub lobe: Option<Lobe>,
    /// Camera centres.
    pub eyes: &'a [Vec3],
}

/// Radiance of a site towards a camera: `albedo · diffuse + specular`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shade {
    /// The frame.
    pub frame: u32,
    /// Radiance of an albedo of one.
    pub diffuse: [f32; 3],
    /// What is added whatever the albedo.
    pub specular: [f32; 3],
    /// One over the number of texels that the light comes from, as if all gave the same: Σl²/(Σl)².
    pub concentration: f32,
}

impl Scene<'_> {
    /// The shade of a place, whose transport row on the grid of light is given, in the frames that are asked for.
    pub fn shade(&self, place: &SurfacePoint, row: &TransportRow, frames: &[u32]) -> Vec<Shade> {
        let all = self.eyes.len();
        // Where each frame is found among shares that are ordered by group.
        let slot: Vec<usize> = match self.occluders {
            Some(masks) => masks.shells.slots(),
            None => (0..all).collect(),
        };
        let outgoing = Outgoing::new(place, frames, self.eyes);
        let mut passed = vec![0.0; frames.len()];
        let mut lit = Lit::new(frames.len());
        let mut received: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; all]);
        let mut share = vec![1.0; all];
        let (mut sum, mut squares) = (vec![0.0f32; all], vec![0.0f32; all]);
        for (&texel, &weight) in row.texel.iter().zip(&row.weight) {
            let texel = usize::from(texel);
            let columns = self.grid.columns;
            let direction = self.grid.texel_direction(texel / columns, texel % columns);
            if let Some(occluders) = self.occluders {
                occluders.passed(place.position, direction, &mut share);
            }
            let light: [f32; 3] = std::array::from_fn(|c| weight * self.radiance[3 * texel + c]);
            let brightness: f32 = light.iter().sum();
            for ((sum, squares), share) in sum.iter_mut().zip(&mut squares).zip(&share) {
                let passed = brightness * share;
                *sum += passed;
                *squares += passed * passed;
            }
            let Some(lobe) = self.lobe else {
                for (received, light) in received.iter_mut().zip(light) {
                    received
                        .iter_mut()
                        .zip(&share)
                        .for_each(|(sum, share)| *sum += light * share);
                }
                continue;
            };
            for (passed, &frame) in passed.iter_mut().zip(frames) {
                *passed = share[slot[frame as usize]];
            }
            lit.add(
                lobe,
                // A tent reaches above the horizon from a centre below it.
                place.normal.dot(direction).max(0.0),
                direction,
                &outgoing,
                &passed,
                light,
            );
        }
        let of_frame = frames.iter().enumerate();
        of_frame
            .map(|(k, &frame)| {
                let slot = slot[frame as usize];
                Shade {
                    frame,
                    diffuse: match self.lobe {
                        None => std::array::from_fn(|c| FRAC_1_PI * received[c][slot]),
                        Some(_) => std::array::from_fn(|c| lit.diffuse[c][k]),
                    },
                    specular: std::array::from_fn(|c| lit.specular[c][k]),
                    concentration: squares[slot] / (sum[slot] * sum[slot]).max(1e-30),
                }
            })
            .collect()
    }
}

/// Directions to the cameras, component by component, and their cosines with the normal.
struct Outgoing {
    direction: [Vec<f32>; 3],
    cosine: Vec<f32>,
}

impl Outgoing {
    fn new(place: &SurfacePoint, frames: &[u32], eyes: &[Vec3]) -> Self {
        let all: Vec<Vec3> = frames
            .iter()
            .map(|&t| {
                let outgoing = (eyes[t as usize] - place.position).normalize();
                just_seen(place.normal, outgoing)
            })
            .collect();
        Self {
            direction: std::array::from_fn(|i| all.iter().map(|o| o[i]).collect()),
            cosine: all.iter().map(|o| place.normal.dot(*o)).collect(),
        }
    }
}

/// The unit direction `outgoing`, where it lies behind the surface raised to graze it: interpolated normals can tilt away from
/// the camera at the silhouette.
pub fn just_seen(normal: Vec3, outgoing: Vec3) -> Vec3 {
    let tilt = (0.02 - normal.dot(outgoing)).max(0.0);
    (outgoing + tilt * normal).normalize()
}

/// Light reflected towards cameras, `[channel][frame]`: of an albedo of one, and by the lobe.
struct Lit {
    diffuse: [Vec<f32>; 3],
    specular: [Vec<f32>; 3],
}

impl Lit {
    fn new(frames: usize) -> Self {
        let zero = || std::array::from_fn(|_| vec![0.0; frames]);
        Self {
            diffuse: zero(),
            specular: zero(),
        }
    }

    /// Adds what comes from the unit `direction`, of which `passed` reaches the surface in each frame.
    ///
    /// Frames lie side by side and nothing branches, so that the loop runs on whole vectors.
    fn add(
        &mut self,
        lobe: Lobe,
        incident: f32,
        direction: Vec3,
        outgoing: &Outgoing,
        passed: &[f32],
        light: [f32; 3],
    ) {
        let count = passed.len();
        let [x, y, z] = outgoing.direction.each_ref().map(|v| &v[..count]);
        let cosine = &outgoing.cosine[..count];
        let [d0, d1, d2] = self.diffuse.each_mut().map(|v| &mut v[..count]);
        let [s0, s1, s2] = self.specular.each_mut().map(|v| &mut v[..count]);
        for k in 0..count {
            // The half vector (i + o)/|i + o|, where |i + o|² = 2 + 2 i·o.
            let both = x[k] * direction.x + y[k] * direction.y + z[k] * direction.z;
            let scale = 1.0 / (2.0 + 2.0 * both).max(1e-12).sqrt();
            let cosines = Cosines {
                incident,
                outgoing: cosine[k],
                half: (incident + cosine[k]) * scale,
                difference: (1.0 + both) * scale,
            };
            let (factor, specular) = microfacet(cosines, lobe.alpha, lobe.kappa);
            let (factor, specular) = (FRAC_1_PI * factor * passed[k], specular * passed[k]);
            d0[k] += light[0] * factor;
            d1[k] += light[1] * factor;
            d2[k] += light[2] * factor;
            s0[k] += light[0] * specular;
            s1[k] += light[1] * specular;
            s2[k] += light[2] * specular;
        }
    }
}

/// What a photograph says about a site: its frame, value and one over the value's variance.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// The frame.
    pub frame: u32,
    /// Linear RGB.
    pub value: [f32; 3],
    /// Weights.
    pub weight: [f32; 3],
}

/// The albedo of a site that explains its samples best, and Σ w·B², how sure that is, by channel.
///
/// Robust: samples far from the rest (a shadow's edge out of place) count less, by Huber's weights. The albedo is weakly
/// tied to ½ ± ¼ and does not fall below zero.
pub fn albedo(samples: &[Sample], shades: &[Shade]) -> ([f32; 3], [f32; 3]) {
    const TIE: f64 = 16.0;
    let shade_of = |frame: u32| {
        shades
            .binary_search_by_key(&frame, |s| s.frame)
            .map(|i| shades[i])
            .unwrap_or_default()
    };
    let mut best = [0.5; 3];
    let mut sure = [0.0; 3];
    for c in 0..3 {
        let rows: Vec<(f64, f64, f64)> = samples
            .iter()
            .map(|s| {
                let shade = shade_of(s.frame);
                let value = f64::from(s.value[c] - shade.specular[c]);
                (value, f64::from(shade.diffuse[c]), f64::from(s.weight[c]))
            })
            .collect();
        let mut trust = vec![1.0; rows.len()];
        for _ in 0..4 {
            let (mut top, mut bottom) = (0.5 * TIE, TIE);
            for ((value, light, weight), trust) in rows.iter().zip(&trust) {
                top += trust * weight * light * value;
                bottom += trust * weight * light * light;
            }
            let a = (top / bottom).max(0.0);
            best[c] = a as f32;
            sure[c] = (bottom - TIE) as f32;
            let off: Vec<f64> = rows
                .iter()
                .map(|(value, light, weight)| (value - a * light).abs() * weight.sqrt())
                .collect();
            let mut sorted = off.clone();
            sorted.sort_unstable_by(f64::total_cmp);
            let typical = sorted.get(sorted.len() / 2).map_or(1.0, |m| m.max(1.0));
            trust
                .iter_mut()
                .zip(&off)
                .for_each(|(trust, off)| *trust = (2.0 * typical / off.max(1e-12)).min(1.0));
        }
    }
    (best, sure)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planted_albedo_is_found_despite_a_shadow_out_of_place() {
        let truth = [0.2f32, 0.5, 0.8];
        let shades: Vec<Shade> = (0..12)
            .map(|t| Shade {
                frame: 2 * t,
                diffuse: [0.5 + 0.05 * t as f32; 3],
                specular: [0.03; 3],
                concentration: 0.01,
            })
            .collect();
        let samples: Vec<Sample> = shades
            .iter()
            .map(|s| Sample {
                frame: s.frame,
                value: std::array::from_fn(|c| {
                    let lit = truth[c] * s.diffuse[c] + s.specular[c];
                    if s.frame == 6 { 0.3 * lit } else { lit }
                }),
                weight: [1e5; 3],
            })
            .collect();
        let (found, sure) = albedo(&samples, &shades);
        for c in 0..3 {
            assert!((found[c] - truth[c]).abs() < 0.01, "{found:?}");
            assert!(sure[c] > 1e5);
        }
        assert_eq!(albedo(&[], &shades), ([0.5; 3], [0.0; 3]));
    }
}
