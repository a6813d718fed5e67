//! Frames kept out of the fit: only where their occluder stands is fitted, on half of their pixels, to be judged on the
//! other half.
//!
//! Light, materials and silhouette stay as the other frames have them; a frame's five parameters follow by damped
//! Gauss-Newton steps with differences for derivatives, which are as many evaluations as parameters.

use render::lat_long::Bilinear;

use super::{
    cutout::FRAME_PARAMETERS,
    finish::Found,
    model::Shared,
    patches::{Observations, PatchOptions},
    sky::SkyModel,
    transport,
};
use render::{image::Image, transport::Quadrature};

/// Side of the blocks of pixels that alternate between fit and judgement.
const BLOCK: usize = 8;
const STEPS: usize = 8;
/// Difference for derivatives, in standard deviations.
const DIFFERENCE: f32 = 0.05;

/// Whether a pixel of an image `width` wide is of the half that a held-out frame's occluder is fitted on.
pub fn fitted_half(width: usize, pixel: usize) -> bool {
    (pixel % width / BLOCK + pixel / width / BLOCK).is_multiple_of(2)
}

/// The parameters with those of the frames `held` fitted to half of their pixels; `materials` are images through each camera.
///
/// Only the operator's cutout has parameters few enough: others come back as they are.
///
/// # Errors
/// When the tape refuses what it is given, which would be a bug.
pub fn fit(
    found: &Found<'_>,
    shared: &Shared,
    z: &[f32],
    materials: &[Image],
    held: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Vec<f32>, autodiff::RunError> {
    let mut z = z.to_vec();
    if !matches!(shared.sky, SkyModel::Cutout(_)) {
        return Ok(z);
    }
    let data = Data::new(found, shared, materials, held);
    let count = found.frames.len();
    let first = z.len() - FRAME_PARAMETERS * count;
    let slot = |k: usize, t: usize| first + k * count + t;
    let mut damping = vec![1.0f64; count];
    let mut cost = data.costs(&data.residuals(&shared.masks(&z)?), &z[first..]);
    for _ in 0..STEPS {
        let residuals = data.residuals(&shared.masks(&z)?);
        let mut changes = Vec::with_capacity(FRAME_PARAMETERS);
        for k in 0..FRAME_PARAMETERS {
            let mut moved = z.clone();
            (0..count).for_each(|t| moved[slot(k, t)] += DIFFERENCE);
            changes.push(data.residuals(&shared.masks(&moved)?));
        }
        let mut candidate = z.clone();
        for t in (0..count).filter(|&t| held(t)) {
            let own: [f32; FRAME_PARAMETERS] = std::array::from_fn(|k| z[slot(k, t)]);
            let step = data.step(t, &residuals, &changes, own, damping[t]);
            (0..FRAME_PARAMETERS).for_each(|k| candidate[slot(k, t)] += step[k].clamp(-1.0, 1.0));
        }
        let next = data.costs(
            &data.residuals(&shared.masks(&candidate)?),
            &candidate[first..],
        );
        for t in (0..count).filter(|&t| held(t)) {
            if next[t] < cost[t] {
                (0..FRAME_PARAMETERS).for_each(|k| z[slot(k, t)] = candidate[slot(k, t)]);
                cost[t] = next[t];
                damping[t] *= 0.3;
            } else {
                damping[t] *= 10.0;
            }
        }
    }
    Ok(z)
}

/// A ray of a patch: its light and where each group of frames looks masks up.
struct Ray {
    light: [f32; 3],
    lookup: Vec<Bilinear>,
}

/// What the held-out frames saw of patches.
struct Data {
    seen: Observations,
    rays: Vec<Vec<Ray>>,
    /// Of every view.
    albedo: Vec<[f32; 3]>,
    /// Of every frame.
    group: Vec<usize>,
}

impl Data {
    fn new(
        found: &Found<'_>,
        shared: &Shared,
        materials: &[Image],
        held: &(dyn Fn(usize) -> bool + Sync),
    ) -> Self {
        let frames = found.frames;
        let used = |t: usize, p: u32| held(t) && fitted_half(frames[t].image.width, p as usize);
        let options = PatchOptions {
            count: 500,
            members: 4,
            model_error: 0.03,
        };
        let seen =
            Observations::gather(found.bvh, frames, found.noise, &options, found.seed, &used);
        let grid = found.grid;
        let radiance = found.radiance;
        let rows = transport::rows(found.bvh, &Quadrature::new(grid, 2), &seen.patches);
        let rays = seen
            .patches
            .iter()
            .zip(rows.chunks_exact(grid.len()))
            .map(|(patch, row)| {
                let seen = row.iter().enumerate().filter(|(_, weight)| **weight > 0.0);
                seen.map(|(texel, weight)| {
                    let direction =
                        grid.texel_direction(texel / grid.columns, texel % grid.columns);
                    Ray {
                        light: std::array::from_fn(|c| weight * radiance[3 * texel + c]),
                        lookup: (shared.shells.groups.iter())
                            .map(|group| {
                                group
                                    .shell
                                    .lookup(shared.mask_grid(), patch.position, direction)
                            })
                            .collect(),
                    }
                })
                .collect()
            })
            .collect();
        let mut sums = vec![[0.0f32; 4]; seen.patches.len() * frames.len()];
        for (t, of) in seen
            .patch_of_pixel
            .iter()
            .enumerate()
            .filter(|(t, _)| held(*t))
        {
            for (p, &patch) in of
                .iter()
                .enumerate()
                .filter(|(_, patch)| **patch != u32::MAX)
            {
                if used(t, p as u32) {
                    let sum = &mut sums[patch as usize * frames.len() + t];
                    (0..3).for_each(|c| sum[c] += materials[t].data[5 * p + c]);
                    sum[3] += 1.0;
                }
            }
        }
        let albedo = seen
            .views
            .iter()
            .map(|v| {
                let sum = sums[v.patch as usize * frames.len() + v.frame as usize];
                std::array::from_fn(|c| sum[c] / sum[3].max(1.0))
            })
            .collect();
        Self {
            seen,
            rays,
            albedo,
            group: shared.shells.place.iter().map(|place| place[0]).collect(),
        }
    }

    /// Weighted misfit of every view, for masks `[texel][frame]`.
    fn residuals(&self, masks: &[f32]) -> Vec<[f32; 3]> {
        let frames = self.group.len();
        let views = self.seen.views.iter().zip(&self.albedo);
        views
            .map(|(view, albedo)| {
                let mut light = [0.0f32; 3];
                for ray in &self.rays[view.patch as usize] {
                    let lookup = &ray.lookup[self.group[view.frame as usize]];
                    let share: f32 = (0..4)
                        .map(|q| {
                            let texel = lookup.index[q] as usize;
                            lookup.weight[q] * masks[texel * frames + view.frame as usize]
                        })
                        .sum();
                    (0..3).for_each(|c| light[c] += share * ray.light[c]);
                }
                std::array::from_fn(|c| {
                    (albedo[c] * light[c] - view.value[c]) * view.weight[c].sqrt()
                })
            })
            .collect()
    }

    /// Of every frame, its parameters `[parameter][frame]` tied to zero.
    fn costs(&self, residuals: &[[f32; 3]], parameters: &[f32]) -> Vec<f64> {
        let mut costs = vec![0.0; self.group.len()];
        for (view, r) in self.seen.views.iter().zip(residuals) {
            costs[view.frame as usize] += r.iter().map(|&r| f64::from(r).powi(2)).sum::<f64>();
        }
        for (i, &z) in parameters.iter().enumerate() {
            costs[i % self.group.len()] += f64::from(z).powi(2);
        }
        costs
    }

    fn step(
        &self,
        frame: usize,
        residuals: &[[f32; 3]],
        changed: &[Vec<[f32; 3]>],
        own: [f32; FRAME_PARAMETERS],
        damping: f64,
    ) -> [f32; FRAME_PARAMETERS] {
        const N: usize = FRAME_PARAMETERS;
        let mut system = [[0.0f64; N + 1]; N];
        for k in 0..N {
            system[k][k] = 1.0 + damping;
            system[k][N] = -f64::from(own[k]);
        }
        for (i, _) in self
            .seen
            .views
            .iter()
            .enumerate()
            .filter(|(_, v)| v.frame as usize == frame)
        {
            for c in 0..3 {
                let r = residuals[i][c];
                let slope: [f64; N] =
                    std::array::from_fn(|k| f64::from((changed[k][i][c] - r) / DIFFERENCE));
                for a in 0..N {
                    (0..N).for_each(|b| system[a][b] += slope[a] * slope[b]);
                    system[a][N] -= slope[a] * f64::from(r);
                }
            }
        }
        // Positive definite: elimination needs no pivots.
        for i in 0..N {
            for j in (0..N).filter(|&j| j != i) {
                let factor = system[j][i] / system[i][i];
                (i..=N).for_each(|k| system[j][k] -= factor * system[i][k]);
            }
        }
        std::array::from_fn(|i| (system[i][N] / system[i][i]) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_blocks_and_equally_large() {
        let fitted = (0..128 * 128).filter(|&p| fitted_half(128, p)).count();
        assert_eq!(fitted, 128 * 128 / 2);
        assert!(fitted_half(128, 7) && !fitted_half(128, 8) && !fitted_half(128, 8 * 128));
    }
}
