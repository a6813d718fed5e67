//! The surface in fine: sites about a pixel apart, what every frame saw of them, and the light that reaches them.
//!
//! Nothing here is differentiated. The solver's patches are coarser; what they leave out is found here (see
//! [`super::detail`]), as are the specular lobe and the materials at the end.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    lat_long::{Bilinear, LatLong},
    transport::{Quadrature, TransportRow},
};

use super::{
    patches::{Observations, Patch, PatchOptions},
    shading::{Sample, Scene, Shade, albedo},
    transport,
};
use crate::{capture::Frame, reconstruction::Noise};

/// Share of a value left to what the model cannot explain; it evens out the frames' say in the albedo.
const MODEL_ERROR: f32 = 0.03;
/// Most sites: each keeps a row of some ten kilobytes.
const MOST_SITES: usize = 10_000;
/// Rays from a site to a texel of the grid of light, along a side.
pub const SIDE: usize = 2;

/// Sites, what was seen of them, and their transport rows.
pub struct Surface {
    /// What every frame saw of the sites, which are its patches.
    pub seen: Observations,
    /// A place that stands for each site.
    pub places: Vec<SurfacePoint>,
    /// Where the views of each site start, and their number last.
    pub offsets: Vec<u32>,
    /// The grid of the rows.
    pub grid: LatLong,
    rows: Vec<TransportRow>,
}

impl Surface {
    /// About `count` sites (see [`sites_for`]) of the pixels that `used` allows (frame, pixel); rows are on `grid`.
    pub fn new(
        bvh: &Bvh,
        frames: &[Frame],
        noise: &Noise,
        grid: LatLong,
        count: usize,
        seed: u64,
        used: &(dyn Fn(usize, u32) -> bool + Sync),
    ) -> Self {
        let options = PatchOptions {
            count,
            members: 2,
            model_error: MODEL_ERROR,
        };
        let mut seen = Observations::gather(bvh, frames, noise, &options, seed, used);
        temper(&mut seen);
        let quadrature = Quadrature::new(grid, SIDE);
        let rows = seen
            .patches
            .par_iter()
            .map(|patch| quadrature.mean_row(bvh, &patch.members))
            .collect();
        Self {
            places: seen
                .patches
                .iter()
                .map(|patch| SurfacePoint {
                    position: patch.position,
                    normal: patch.normal,
                    geometric_normal: patch.normal,
                })
                .collect(),
            offsets: seen.offsets(),
            grid,
            rows,
            seen,
        }
    }

    /// Where the views of a site are.
    pub fn views(&self, site: usize) -> std::ops::Range<usize> {
        self.offsets[site] as usize..self.offsets[site + 1] as usize
    }

    /// The shades of some sites, each in the frames that are asked for.
    pub fn shades(
        &self,
        scene: &Scene<'_>,
        sites: &[usize],
        frames: &[Vec<u32>],
    ) -> Vec<Vec<Shade>> {
        sites
            .par_iter()
            .zip(frames)
            .map(|(&s, frames)| scene.shade(&self.places[s], &self.rows[s], frames))
            .collect()
    }

    /// Transport rows of patches on `grid`, no finer than the surface's own, each the mean over the sites that `patch_of_site`
    /// says are part of it; `[patch][texel]` as of [`transport::rows`], which serves patches without a site.
    ///
    /// What patches say of a change of light is then what the sites say, to the accuracy of hundreds of rays a texel: of a sun
    /// of one texel, the few rays of a patch's own would know little.
    pub fn rows_of(
        &self,
        bvh: &Bvh,
        grid: LatLong,
        patches: &[Patch],
        patch_of_site: &[u32],
    ) -> Vec<f32> {
        let pixels = |site: usize| -> f32 {
            let views = &self.seen.views[self.views(site)];
            views.iter().map(|view| view.pixels as f32).sum()
        };
        let mut members: Vec<Vec<(usize, f32)>> = vec![Vec::new(); patches.len()];
        for (site, &patch) in patch_of_site.iter().enumerate() {
            if patch != u32::MAX {
                members[patch as usize].push((site, pixels(site)));
            }
        }
        let tents: Vec<Bilinear> = (0..self.grid.len())
            .map(|t| {
                let (row, column) = (t / self.grid.columns, t % self.grid.columns);
                grid.bilinear(self.grid.texel_direction(row, column))
            })
            .collect();
        let quadrature = Quadrature::new(grid, SIDE);
        let row_of = |(patch, members): (&Patch, &Vec<(usize, f32)>)| {
            let total: f32 = members.iter().map(|(_, pixels)| pixels).sum();
            if total == 0.0 {
                return transport::rows(bvh, &quadrature, std::slice::from_ref(patch));
            }
            let mut dense = vec![0.0; grid.len()];
            for &(site, pixels) in members {
                let share = pixels / (total * std::f32::consts::PI);
                let row = &self.rows[site];
                for (&texel, &weight) in row.texel.iter().zip(&row.weight) {
                    tents[usize::from(texel)].scatter(share * weight, &mut dense);
                }
            }
            dense
        };
        patches
            .par_iter()
            .zip(&members)
            .flat_map_iter(row_of)
            .collect()
    }

    /// The frames that see each of some sites.
    pub fn frames(&self, sites: &[usize]) -> Vec<Vec<u32>> {
        sites
            .iter()
            .map(|&s| {
                self.seen.views[self.views(s)]
                    .iter()
                    .map(|v| v.frame)
                    .collect()
            })
            .collect()
    }

    /// The albedo of a site that explains what was seen of it, and how sure that is (see [`albedo`]).
    pub fn albedo(&self, site: usize, shades: &[Shade]) -> ([f32; 3], [f32; 3]) {
        let samples: Vec<Sample> = self.seen.views[self.views(site)]
            .iter()
            .map(|v| Sample {
                frame: v.frame,
                value: v.value,
                weight: v.weight,
            })
            .collect();
        albedo(&samples, shades)
    }
}

/// No photograph of a site is surer than the site's usual brightness allows: what a model leaves unexplained is a share of what should
/// be seen. Where the shape is only approximate some photographs show something else, and a dark one, taken to be sure to a share
/// of its own value, would outweigh all the others: the site would come out black.
fn temper(seen: &mut Observations) {
    let offsets = seen.offsets();
    for ends in offsets.windows(2) {
        let views = &mut seen.views[ends[0] as usize..ends[1] as usize];
        for c in 0..3 {
            let mut values: Vec<f32> = views.iter().map(|view| view.value[c]).collect();
            values.sort_unstable_by(f32::total_cmp);
            let usual = values.get(values.len() / 2).map_or(0.0, |v| v.max(0.0));
            let most = (MODEL_ERROR * usual).powi(-2);
            for view in views.iter_mut() {
                view.weight[c] = view.weight[c].min(most);
            }
        }
    }
}

/// Sites about a pixel apart: a view shows about a third of the surface.
pub fn sites_for(frames: &[Frame]) -> usize {
    let inside = |frame: &Frame| frame.mask.data.iter().filter(|&&m| m > 0.5).count();
    let all: usize = frames.iter().map(inside).sum();
    (3 * all / frames.len().max(1)).clamp(64, MOST_SITES)
}

/// Where the cameras are.
pub fn eyes(frames: &[Frame]) -> Vec<Vec3> {
    frames.iter().map(|frame| frame.camera.centre()).collect()
}

#[cfg(test)]
mod tests {
    use super::{super::patches::View, *};

    #[test]
    fn dark_photographs_do_not_outweigh_what_the_others_show() {
        let view = |patch: u32, frame: u32, value: f32| View {
            patch,
            frame,
            value: [value; 3],
            weight: [(1e-3f32.powi(2) + (MODEL_ERROR * value).powi(2)).recip(); 3],
            pixels: 1,
        };
        // The first site is bright, but for two photographs that show what is behind it; the second is dark.
        let first = (0..10).map(|t| view(0, t, if t < 2 { 0.0 } else { 0.6 }));
        let second = (0..10).map(|t| view(1, t, 0.02));
        let place = |z: f32| Patch {
            position: Vec3::Z * z,
            normal: Vec3::Z,
            members: Vec::new(),
        };
        let mut seen = Observations {
            patches: vec![place(0.0), place(1.0)],
            views: first.chain(second).collect(),
            patch_of_pixel: Vec::new(),
            spacing: 1.0,
        };
        let found = |seen: &Observations| {
            let samples = seen.views[..10].iter().map(|view| Sample {
                frame: view.frame,
                value: view.value,
                weight: view.weight,
            });
            let shades: Vec<Shade> = (0..10)
                .map(|frame| Shade {
                    frame,
                    diffuse: [1.0; 3],
                    ..Shade::default()
                })
                .collect();
            albedo(&samples.collect::<Vec<_>>(), &shades).0[0]
        };
        let before = seen.views.clone();
        assert!(found(&seen) < 0.1, "{}", found(&seen));
        temper(&mut seen);
        assert!((found(&seen) - 0.6).abs() < 0.06, "{}", found(&seen));
        let untouched = |range: std::ops::Range<usize>| {
            before[range.clone()]
                .iter()
                .zip(&seen.views[range])
                .all(|(a, b)| a.weight == b.weight)
        };
        assert!(untouched(2..20));
    }
}
