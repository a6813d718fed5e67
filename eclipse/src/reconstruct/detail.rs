//! What patches leave out: the data of the solver, corrected by a finer model at the current estimate.
//!
//! A patch stands for many pixels: texture, curvature, shadow edges and specular reflection within it are not in its model.
//! All of them are in the model of the surface's sites. So the solver is given, for every view of a patch, what its own model
//! says times one plus the mean relative misfit of the patch's sites under the fine model (a deferred correction, as for
//! discretised equations: Stetter, Numer. Math. 29, 1978). Where the misfit of the sites vanishes the solver stands still,
//! whatever its own model leaves out; its derivative only has to point the right way. Sites count by how little their
//! own texture disturbs them, so that a view of a patch is far surer than the mean of its pixels.

use rayon::prelude::*;

use super::{
    patches::Observations,
    shading::{Scene, Shade},
    surface::Surface,
};
use crate::reconstruction::Noise;

/// What a site's texture is taken to disturb before it is known, relative; and what it disturbs at least.
const TEXTURE: [f64; 2] = [0.03, 0.004];

/// How much of a texel's light the grid may misplace, as a standard deviation: an edge of a shadow runs through about one of
/// ten texels, and lies anywhere in it (a tenth of 1/12). Where a lamp of a few texels gives most of the light, that is much.
const EDGES: f64 = 0.1;

/// Values and one over their variances, of all views of patches.
pub struct Data {
    /// Linear RGB.
    pub value: Vec<[f32; 3]>,
    /// One over the variance of each.
    pub weight: Vec<[f32; 3]>,
    /// By its square all weights are less than the variances that were expected say, 1 or more: see `Trust`.
    pub excess: f64,
}

/// Which patch each site belongs to: that which most of its pixels look at.
pub fn patch_of_site(surface: &Surface, patches: &Observations) -> Vec<u32> {
    let mut votes: Vec<Vec<u32>> = vec![Vec::new(); surface.places.len()];
    for (sites, patches) in surface
        .seen
        .patch_of_pixel
        .iter()
        .zip(&patches.patch_of_pixel)
    {
        for (&site, &patch) in sites.iter().zip(patches) {
            if site != u32::MAX && patch != u32::MAX {
                votes[site as usize].push(patch);
            }
        }
    }
    votes
        .into_par_iter()
        .map(|mut votes| {
            votes.sort_unstable();
            let runs = votes.chunk_by(|a, b| a == b);
            runs.max_by_key(|run| run.len())
                .map_or(u32::MAX, |run| run[0])
        })
        .collect()
}

/// The data of `patches`, of which their own model says `predicted` for each view; `model_error` is the share of a value left
/// to what even the fine model cannot explain.
pub fn correct(
    surface: &Surface,
    scene: &Scene<'_>,
    noise: &Noise,
    patches: &Observations,
    patch_of_site: &[u32],
    predicted: &[[f32; 3]],
    model_error: f64,
) -> Data {
    let sites: Vec<usize> = (0..surface.places.len()).collect();
    let shades = surface.shades(scene, &sites, &surface.frames(&sites));
    let misfits = Misfits::new(surface, &shades, noise);
    let place = Place::new(surface, patches, patch_of_site);
    let unknown = vec![TEXTURE[0].powi(2); sites.len()];
    let [first, _] = place.means(&misfits, &unknown, patches.views.len());
    let texture = place.texture(&misfits, &first);
    let [mean, precision] = place.means(&misfits, &texture, patches.views.len());
    let edges = place.concentration(&shades, patches.views.len());
    let variance =
        |i: usize, c: usize| 1.0 / precision[i][c] + model_error.powi(2) + EDGES.powi(2) * edges[i];
    let trust = Trust::new(&mean, &variance);
    let views = patches.views.iter().zip(predicted).enumerate();
    let (value, weight) = views
        .map(|(i, (view, predicted))| {
            let mut value = view.value;
            let mut weight = [0.0; 3];
            for c in 0..3 {
                let variance = variance(i, c);
                if variance.is_finite() && predicted[c] > 0.0 {
                    let model = f64::from(predicted[c]);
                    value[c] = (model * (1.0 + mean[i][c])).max(0.0) as f32;
                    let unit = f64::from(value[c]).max(0.3 * model).powi(2);
                    weight[c] = (trust.of(mean[i][c], variance) / (variance * unit)) as f32;
                }
            }
            (value, weight)
        })
        .unzip();
    Data {
        value,
        weight,
        excess: trust.excess(),
    }
}

/// Huber's weights: misfits far beyond the usual (the edge of a shadow out of place) count by their size, not its square. Where
/// even the usual misfit is far beyond what its variance says, the model leaves something out, and all weights are divided by
/// that excess squared (the ratio of Birge, Phys. Rev. 40, 1932): light, shadows and albedo would else be bent to explain it.
struct Trust {
    /// The usual misfit, in standard deviations.
    scale: f64,
}

impl Trust {
    /// Where the influence of a misfit stops growing, in units of the usual; and how many standard deviations are usual still.
    const BEND: f64 = 1.5;

    fn new(misfit: &[[f64; 3]], variance: &dyn Fn(usize, usize) -> f64) -> Self {
        let all = (0..misfit.len()).flat_map(|i| (0..3).map(move |c| (i, c)));
        let mut squares: Vec<f64> = all
            .map(|(i, c)| misfit[i][c].powi(2) / variance(i, c))
            .filter(|square| square.is_finite() && *square > 0.0)
            .collect();
        squares.sort_unstable_by(f64::total_cmp);
        let median = squares.get(squares.len() / 2).copied().unwrap_or(0.0);
        Self {
            scale: (median / 0.455).sqrt().max(1.0),
        }
    }

    /// How far the usual misfit is beyond what is usual still.
    fn excess(&self) -> f64 {
        (self.scale / Self::BEND).max(1.0)
    }

    fn of(&self, misfit: f64, variance: f64) -> f64 {
        let far = misfit.abs() / (Self::BEND * self.scale * variance.sqrt());
        1.0 / (far.max(1.0) * self.excess().powi(2))
    }
}

/// How far every view of a site is from the fine model, relative to it.
struct Misfits {
    relative: Vec<[f64; 3]>,
    /// The variance that noise alone gives them; infinite where the model is black.
    noise: Vec<[f64; 3]>,
}

impl Misfits {
    fn new(surface: &Surface, shades: &[Vec<Shade>], noise: &Noise) -> Self {
        let of_site = |s: usize| -> Vec<([f64; 3], [f64; 3])> {
            let (albedo, _) = surface.albedo(s, &shades[s]);
            let views = &surface.seen.views[surface.views(s)];
            views
                .iter()
                .zip(&shades[s])
                .map(|(view, shade)| {
                    let mut relative = [0.0; 3];
                    let mut variance = [f64::INFINITY; 3];
                    for c in 0..3 {
                        let value = f64::from(view.value[c]);
                        let model = f64::from(albedo[c] * shade.diffuse[c] + shade.specular[c]);
                        if model > 1e-9 {
                            relative[c] = value / model - 1.0;
                            variance[c] = noise.sigma(value).powi(2)
                                / (f64::from(view.pixels) * model * model);
                        }
                    }
                    (relative, variance)
                })
                .collect()
        };
        let all: Vec<_> = (0..surface.places.len())
            .into_par_iter()
            .flat_map_iter(of_site)
            .collect();
        let (relative, noise) = all.into_iter().unzip();
        Self { relative, noise }
    }
}

/// Which view of a patch every view of a site is part of.
struct Place<'a> {
    surface: &'a Surface,
    view: Vec<Option<u32>>,
}

impl<'a> Place<'a> {
    fn new(surface: &'a Surface, patches: &Observations, patch_of_site: &[u32]) -> Self {
        let views = surface.seen.views.iter();
        let view = views
            .map(|view| {
                let key = (patch_of_site[view.patch as usize], view.frame);
                let found = patches
                    .views
                    .binary_search_by_key(&key, |v| (v.patch, v.frame));
                found.ok().map(|i| i as u32)
            })
            .collect();
        Self { surface, view }
    }

    /// Weighted means of the sites' misfits over every view of a patch, and their precision.
    fn means(&self, misfits: &Misfits, texture: &[f64], count: usize) -> [Vec<[f64; 3]>; 2] {
        let mut sum = vec![[0.0; 3]; count];
        let mut precision = vec![[0.0; 3]; count];
        let views = self.surface.seen.views.iter().zip(&self.view).enumerate();
        for (i, (view, place)) in views {
            let Some(place) = place.map(|p| p as usize) else {
                continue;
            };
            for c in 0..3 {
                let weight = 1.0 / (texture[view.patch as usize] + misfits.noise[i][c]);
                sum[place][c] += weight * misfits.relative[i][c];
                precision[place][c] += weight;
            }
        }
        for (sum, precision) in sum.iter_mut().zip(&precision) {
            for c in 0..3 {
                sum[c] /= precision[c].max(1e-300);
            }
        }
        [sum, precision]
    }

    /// The mean concentration of the light over every view of a patch.
    fn concentration(&self, shades: &[Vec<Shade>], count: usize) -> Vec<f64> {
        let mut sums = vec![(0.0, 0u32); count];
        for (shade, place) in shades.iter().flatten().zip(&self.view) {
            if let Some(place) = place {
                let sum = &mut sums[*place as usize];
                sum.0 += f64::from(shade.concentration);
                sum.1 += 1;
            }
        }
        sums.iter()
            .map(|(sum, n)| sum / f64::from((*n).max(1)))
            .collect()
    }

    /// The variance of each site's misfits about those of its patch, beyond noise: what its texture disturbs.
    fn texture(&self, misfits: &Misfits, mean: &[[f64; 3]]) -> Vec<f64> {
        let of_site = |s: usize| {
            let mut squares: Vec<f64> = self
                .surface
                .views(s)
                .filter_map(|i| Some((i, self.view[i]? as usize)))
                .flat_map(|(i, place)| {
                    (0..3).map(move |c| {
                        let off = misfits.relative[i][c] - mean[place][c];
                        (off * off, misfits.noise[i][c])
                    })
                })
                .filter(|(_, noise)| noise.is_finite())
                .map(|(square, noise)| square - 0.455 * noise)
                .collect();
            if squares.len() < 6 {
                return TEXTURE[0].powi(2);
            }
            squares.sort_unstable_by(f64::total_cmp);
            // The median of a squared normal is 0.455 of its variance.
            (squares[squares.len() / 2] / 0.455).clamp(TEXTURE[1].powi(2), 1.0)
        };
        (0..self.surface.places.len())
            .into_par_iter()
            .map(of_site)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Misfits that are normal but for their size, in standard deviations of `size`.
    fn misfits(size: f64) -> Vec<[f64; 3]> {
        let quantile = |i: usize| {
            // Logistic, whose quantiles are a formula; its median of squares is set to that of a normal distribution.
            let u = (i as f64 + 0.5) / 900.0;
            0.455f64.sqrt() / 3.0f64.ln() * (u / (1.0 - u)).ln()
        };
        (0..300)
            .map(|i| [0, 1, 2].map(|c| size * quantile(3 * i + c)))
            .collect()
    }

    #[test]
    fn all_weights_fall_where_even_usual_misfits_are_far_beyond_their_variance() {
        let variance = 0.01f64;
        let of = |size: f64| {
            let misfits = misfits(size * variance.sqrt());
            Trust::new(&misfits, &|_, _| variance).of(0.0, variance)
        };
        for usual in [0.3, 1.0, 1.4] {
            assert_eq!(of(usual), 1.0, "{usual}");
        }
        for beyond in [2.0, 6.0] {
            let expected = (Trust::BEND / beyond).powi(2);
            assert!((of(beyond) - expected).abs() < 0.02 * expected, "{beyond}");
        }
    }

    #[test]
    fn misfits_beyond_the_bend_count_by_their_size() {
        let variance = 0.01f64;
        let trust = Trust::new(&misfits(variance.sqrt()), &|_, _| variance);
        let influence = |misfit: f64| misfit * trust.of(misfit, variance);
        assert!((influence(0.1) - 0.1).abs() < 1e-12);
        assert!((influence(0.3) - influence(3.0)).abs() < 1e-9);
    }
}
