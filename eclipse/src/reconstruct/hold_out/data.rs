//! What held-out frames saw of patches, and how their masks shade these.

use rayon::prelude::*;
use render::{image::Image, lat_long::Bilinear, transport::Quadrature};

use super::{
    super::{
        finish::Found,
        model::Shared,
        patches::{Observations, PatchOptions, View},
        surface::SIDE,
        transport,
    },
    fitted_half,
};

/// What the held-out frames saw of patches.
pub(super) struct Data {
    seen: Observations,
    rays: Vec<Vec<Ray>>,
    /// Of every view.
    albedo: Vec<[f32; 3]>,
    /// Of every frame.
    group: Vec<usize>,
    /// Texels of a mask.
    texels: usize,
}

/// A ray of a patch: its light and where each group of frames looks masks up.
struct Ray {
    light: [f32; 3],
    lookup: Vec<Bilinear>,
}

impl Data {
    pub(super) fn new(
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
        let rows = transport::rows(found.bvh, &Quadrature::new(grid, SIDE), &seen.patches);
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
            texels: shared.mask_grid().len(),
        }
    }

    /// Weighted misfit of every view, for masks `[texel][frame]`: `[view][channel]`.
    pub(super) fn residuals(&self, masks: &[f32]) -> Vec<f32> {
        let mut residuals = self.received(masks);
        for (view, residual) in self.seen.views.iter().zip(residuals.chunks_exact_mut(3)) {
            for c in 0..3 {
                residual[c] -= view.value[c] * view.weight[c].sqrt();
            }
        }
        residuals
    }

    /// What every view receives through masks `[texel][frame]`, weighted; linear in them.
    pub(super) fn received(&self, masks: &[f32]) -> Vec<f32> {
        let frames = self.group.len();
        let views = self.seen.views.par_iter().zip(&self.albedo);
        let of_view = |(view, albedo): (&View, &[f32; 3])| -> [f32; 3] {
            let frame = view.frame as usize;
            let mut light = [0.0f32; 3];
            for ray in &self.rays[view.patch as usize] {
                let lookup = &ray.lookup[self.group[frame]];
                let share: f32 = (0..4)
                    .map(|q| lookup.weight[q] * masks[lookup.index[q] as usize * frames + frame])
                    .sum();
                (0..3).for_each(|c| light[c] += share * ray.light[c]);
            }
            std::array::from_fn(|c| albedo[c] * light[c] * view.weight[c].sqrt())
        };
        views.flat_map_iter(of_view).collect()
    }

    /// The transpose of [`received`](Self::received).
    pub(super) fn received_transpose(&self, values: &[f32]) -> Vec<f32> {
        let frames = self.group.len();
        let texels = self.texels;
        let of_frame = |frame: usize| {
            let mut own = vec![0.0f32; texels];
            let views = self.seen.views.iter().zip(&self.albedo).enumerate();
            for (i, (view, albedo)) in views.filter(|(_, (view, _))| view.frame as usize == frame) {
                let back: [f32; 3] =
                    std::array::from_fn(|c| values[3 * i + c] * albedo[c] * view.weight[c].sqrt());
                for ray in &self.rays[view.patch as usize] {
                    let lookup = &ray.lookup[self.group[frame]];
                    let share: f32 = (0..3).map(|c| back[c] * ray.light[c]).sum();
                    (0..4).for_each(|q| own[lookup.index[q] as usize] += lookup.weight[q] * share);
                }
            }
            own
        };
        let columns: Vec<Vec<f32>> = (0..frames).into_par_iter().map(of_frame).collect();
        (0..texels * frames)
            .map(|i| columns[i % frames][i / frames])
            .collect()
    }
}
