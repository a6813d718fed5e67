//! What photographs can tell of the light at best: the error of the best linear estimate, all else being known.
//!
//! For a view of a patch the photographs give y = a Σ_d W_d M_d L_d + noise, which is linear in the light L on a grid. Light is
//! taken to be 1 on average with independent texels of the variance 1, so that the error of the best linear estimate is
//! diag (1 + G)⁻¹ with G the sum of the views' outer products over their noise. An albedo that is not known is eliminated as
//! the solver eliminates it.

use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use render::{
    bvh::Bvh,
    lat_long::{Bilinear, LatLong},
    transport::Quadrature,
};
use serde::Serialize;

use crate::{
    capture::Capture,
    reconstruct::{
        ReconstructError,
        cutout::Stand,
        model::mask_grid,
        noise,
        patches::{Observations, PatchOptions, View},
        shell::Shells,
        sky::SkyModel,
        surface::SIDE,
        transport,
    },
    reconstruction::Noise,
    wording::told_of_light,
};

/// Precision of what is known of an albedo beforehand: ½ ± ¼, as the solver's.
const ALBEDO_PRECISION: f64 = 16.0;
/// Matrices are summed in so many parts, however many threads there are: results do not depend on it.
const PARTS: usize = 8;

/// Share of a value that is left to what even the right model would not explain: what the solver leaves to it.
pub const MODEL_ERROR: f64 = 0.004;
/// More pixels than this take longer than anybody waits for an inspection.
const MOST_PIXELS: u64 = 4_000_000;
/// What each of them takes meanwhile, in bytes: where it looks, twice over, and its patch.
const BYTES_PER_PIXEL: u64 = 160;
/// How finely an inspection looks.
const GLANCE: Grain = Grain {
    rows: 8,
    patches: 120,
};

/// What photographs can tell of the light at best, the albedo being unknown.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LimitInspection {
    /// Size of a texel in degrees.
    pub texel: f64,
    /// The error that is left of the light's variation with somebody behind each camera, were it known where.
    pub with_somebody: f64,
    /// The same with nobody in the light.
    pub with_nobody: f64,
}

impl LimitInspection {
    /// In words, with what follows.
    pub fn sentence(&self) -> String {
        told_of_light(self.texel, self.with_somebody, self.with_nobody)
    }
}

/// Why there is no limit at a glance.
#[derive(Debug, thiserror::Error)]
pub enum GlanceError {
    /// It would take too long, or more memory than there is.
    #[error(
        "{pixels} pixels of the object would take too long, or too much memory; eclipse study limit computes it"
    )]
    TooMuch {
        /// Pixels of the object in all photographs.
        pixels: u64,
    },
    /// Nothing to be computed with.
    #[error(transparent)]
    Capture(#[from] ReconstructError),
    /// Not what was asked for.
    #[error("it was not computed for an unknown albedo")]
    Missing,
}

/// At a glance, within `memory` bytes.
///
/// # Errors
/// [`GlanceError`]: nothing to see, or so much that it takes long.
pub fn at_a_glance(capture: &Capture, memory: u64) -> Result<LimitInspection, GlanceError> {
    let inside = |mask: &[f32]| mask.iter().filter(|&&m| m > 0.5).count() as u64;
    let frames = capture.frames.iter();
    let pixels: u64 = frames.map(|frame| inside(&frame.mask.data)).sum();
    if pixels > MOST_PIXELS || pixels * BYTES_PER_PIXEL > memory {
        return Err(GlanceError::TooMuch { pixels });
    }
    let limits = limits(capture, GLANCE, MODEL_ERROR, 0)?;
    let [with_somebody, with_nobody] = of_unknown_albedo(&limits).ok_or(GlanceError::Missing)?;
    Ok(LimitInspection {
        texel: 180.0 / GLANCE.rows as f64,
        with_somebody,
        with_nobody,
    })
}

/// The errors that are left where the albedo is not known, with somebody at a known place in the light and with nobody.
pub fn of_unknown_albedo(limits: &[Limit]) -> Option<[f64; 2]> {
    let error = |operator| {
        let wanted = Known {
            operator,
            albedo: false,
        };
        let limit = limits.iter().find(|limit| limit.known == wanted);
        limit.map(|limit| limit.error)
    };
    Some([error(true)?, error(false)?])
}

/// How finely it is computed.
#[derive(Clone, Copy, Debug)]
pub struct Grain {
    /// Rows of the grid of light.
    pub rows: usize,
    /// About how many patches of surface.
    pub patches: usize,
}

/// What is known beside the photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Known {
    /// Somebody stands behind each camera, and it is known where; else nobody does.
    pub operator: bool,
    /// The albedo.
    pub albedo: bool,
}

/// The error that is left at best.
pub struct Limit {
    /// What was known.
    pub known: Known,
    /// The grid.
    pub grid: LatLong,
    /// Standard deviation of each texel that is left, of 1.
    pub left: Vec<f32>,
    /// Root mean square of the same over all directions.
    pub error: f64,
    /// For blocks of texels of so many degrees: the share of the variance of their means that the photographs reveal.
    pub revealed: Vec<(f64, f64)>,
}

/// The limits of a capture for everything that may be [`Known`], `model_error` being the share of a value that even the right
/// model would not explain.
///
/// # Errors
/// A mesh that cannot be traced, nothing to be seen, or views that are no numbers.
pub fn limits(
    capture: &Capture,
    grain: Grain,
    model_error: f64,
    seed: u64,
) -> Result<Vec<Limit>, ReconstructError> {
    let scene = Scene::new(capture, grain, model_error, seed)?;
    let mut limits = Vec::new();
    for operator in [false, true] {
        let masks = if operator { Some(scene.masks()?) } else { None };
        let [known, unknown] = scene.grams(masks.as_deref());
        for (gram, albedo) in [(known, true), (unknown, false)] {
            let known = Known { operator, albedo };
            let limit = Limit::new(known, scene.grid, gram);
            limits.push(limit.ok_or(ReconstructError::NothingTold)?);
        }
    }
    Ok(limits)
}

/// A capture as rows of light.
struct Scene<'a> {
    capture: &'a Capture,
    grid: LatLong,
    observations: Observations,
    offsets: Vec<u32>,
    /// `[patch][texel]`.
    rows: Vec<f32>,
    noise: Noise,
    model_error: f64,
    stands: Vec<Stand>,
    shells: Shells,
}

impl<'a> Scene<'a> {
    fn new(
        capture: &'a Capture,
        grain: Grain,
        model_error: f64,
        seed: u64,
    ) -> Result<Self, ReconstructError> {
        let bvh = Bvh::new(&capture.mesh)?;
        let grid = LatLong::new(grain.rows, 2 * grain.rows);
        let noise = noise::estimate(&capture.frames);
        let options = PatchOptions {
            count: grain.patches,
            members: 8,
            model_error: 0.0,
        };
        let frames = &capture.frames;
        let observations = Observations::gather(&bvh, frames, &noise, &options, seed, &|_, _| true);
        if observations.views.is_empty() {
            return Err(ReconstructError::NothingToFit);
        }
        let quadrature = Quadrature::new(grid, SIDE);
        let stands = Stand::behind_all(frames.iter().map(|f| &f.camera));
        let distances: Vec<f32> = stands.iter().map(|s| s.distance).collect();
        Ok(Self {
            rows: transport::rows(&bvh, &quadrature, &observations.patches),
            offsets: observations.offsets(),
            shells: Shells::cylinders(&distances),
            capture,
            grid,
            observations,
            noise,
            model_error,
            stands,
        })
    }

    /// What somebody behind each camera lets pass: `[texel][frame]` on [`mask_grid`].
    fn masks(&self) -> Result<Vec<f32>, ReconstructError> {
        let sky = SkyModel::cutout(self.stands.clone())?;
        let nothing_known = vec![0.0; sky.parameters()];
        let at = sky.at(mask_grid(self.grid), &nothing_known)?;
        Ok(at.map_or(Vec::new(), |at| at.passed))
    }

    /// G with the albedo known and with it unknown.
    fn grams(&self, masks: Option<&[f32]>) -> [DMatrix<f64>; 2] {
        let n = self.grid.len();
        let count = self.observations.patches.len();
        let parts: Vec<[DMatrix<f64>; 2]> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut sums = [DMatrix::zeros(n, n), DMatrix::zeros(n, n)];
                for patch in part * count / PARTS..(part + 1) * count / PARTS {
                    self.add(patch, masks, &mut sums);
                }
                sums
            })
            .collect();
        let mut parts = parts.into_iter();
        let mut all = parts.next().expect("at least one part");
        for [known, unknown] in parts {
            all[0] += known;
            all[1] += unknown;
        }
        all
    }

    /// Adds what all views of a patch say.
    fn add(&self, patch: usize, masks: Option<&[f32]>, sums: &mut [DMatrix<f64>; 2]) {
        let n = self.grid.len();
        let row = &self.rows[patch * n..(patch + 1) * n];
        let seen: Vec<usize> = (0..n).filter(|&d| row[d] > 0.0).collect();
        let views = self.offsets[patch] as usize..self.offsets[patch + 1] as usize;
        let views = &self.observations.views[views];
        if seen.is_empty() || views.is_empty() {
            return;
        }
        let received = self.received(patch, row, &seen, views, masks);
        // The albedo that explains the mean of the views under light of 1.
        let mean = |of: &dyn Fn(usize) -> f64| (0..views.len()).map(of).sum::<f64>();
        let under = mean(&|v| received.row(v).iter().map(|x| f64::from(*x)).sum());
        let albedo = (mean(&|v| value(&views[v])) / under.max(1e-12)).max(0.0);
        let precision: Vec<f64> = views.iter().map(|view| self.precision(view)).collect();
        let mut weighted = received;
        for (v, precision) in precision.iter().enumerate() {
            weighted.row_mut(v).scale_mut(precision.sqrt() as f32);
        }
        // By the albedo: its derivative is the light that arrives. By the light: the albedo times that of each texel.
        let slope = DVector::from_iterator(
            views.len(),
            weighted.row_iter().map(|row| row.iter().sum::<f32>()),
        );
        let transposed = weighted.transpose();
        let gram = &transposed * &weighted;
        let shared = &transposed * &slope;
        let by_albedo = f64::from(slope.norm_squared()) + ALBEDO_PRECISION;
        let square = albedo * albedo;
        for (j, &dj) in seen.iter().enumerate() {
            for (i, &di) in seen.iter().enumerate() {
                let both = square * f64::from(gram[(i, j)]);
                let taken = square * f64::from(shared[i]) * f64::from(shared[j]) / by_albedo;
                sums[0][(di, dj)] += both;
                sums[1][(di, dj)] += both - taken;
            }
        }
    }

    /// Light of 1 from each texel as an albedo of 1 would show it: `[view][texel seen]`.
    fn received(
        &self,
        patch: usize,
        row: &[f32],
        seen: &[usize],
        views: &[View],
        masks: Option<&[f32]>,
    ) -> DMatrix<f32> {
        let Some(masks) = masks else {
            return DMatrix::from_fn(views.len(), seen.len(), |_, j| row[seen[j]]);
        };
        let frames = self.capture.frames.len();
        let point = self.observations.patches[patch].position;
        let grid = mask_grid(self.grid);
        let direction = |d: usize| -> Vec3 {
            self.grid
                .texel_direction(d / self.grid.columns, d % self.grid.columns)
        };
        let groups = self.shells.groups.iter();
        let lookups: Vec<Vec<Bilinear>> = groups
            .map(|group| {
                let at = |&d: &usize| group.shell.lookup(grid, point, direction(d));
                seen.iter().map(at).collect()
            })
            .collect();
        DMatrix::from_fn(views.len(), seen.len(), |v, j| {
            let frame = views[v].frame as usize;
            let lookup = &lookups[self.shells.place[frame][0]][j];
            let passed: f32 = (0..4)
                .map(|k| lookup.weight[k] * masks[lookup.index[k] as usize * frames + frame])
                .sum();
            row[seen[j]] * passed
        })
    }

    /// One over the variance of a view's mean.
    fn precision(&self, view: &View) -> f64 {
        let value = value(view);
        let noise = self.noise.sigma(value).powi(2) / f64::from(view.pixels);
        1.0 / (noise + (self.model_error * value).powi(2) + 1e-12)
    }
}

/// The mean of a view's channels.
fn value(view: &View) -> f64 {
    view.value.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
}

impl Limit {
    /// `None` where the views say nothing that can be computed with: 1 + G is positive definite for all that are finite.
    fn new(known: Known, grid: LatLong, mut gram: DMatrix<f64>) -> Option<Self> {
        let n = grid.len();
        for i in 0..n {
            gram[(i, i)] += 1.0;
        }
        let is_finite = |matrix: &DMatrix<f64>| matrix.iter().all(|value| value.is_finite());
        if !is_finite(&gram) {
            return None;
        }
        let left = gram.cholesky()?.inverse();
        if !is_finite(&left) {
            return None;
        }
        let blocks = [1, 2, 4, 8].into_iter().filter(|k| grid.rows / k >= 2);
        let revealed: Vec<(f64, f64)> = blocks
            .map(|k| {
                let degrees = 180.0 * k as f64 / grid.rows as f64;
                (degrees, 1.0 - left_in_blocks(&left, grid, k))
            })
            .collect();
        Some(Self {
            known,
            grid,
            left: (0..n).map(|i| left[(i, i)].sqrt() as f32).collect(),
            error: left_in_blocks(&left, grid, 1).sqrt(),
            revealed,
        })
    }
}

/// The share that is left of the variance of means over blocks of `side` × `side` texels, by solid angle.
fn left_in_blocks(left: &DMatrix<f64>, grid: LatLong, side: usize) -> f64 {
    let (mut after, mut before) = (0.0, 0.0);
    for top in (0..grid.rows).step_by(side) {
        for first in (0..grid.columns).step_by(side) {
            let texels: Vec<(usize, f64)> = (top..(top + side).min(grid.rows))
                .flat_map(|row| {
                    let weight = f64::from(grid.solid_angle(row));
                    let columns = first..(first + side).min(grid.columns);
                    columns.map(move |column| (row * grid.columns + column, weight))
                })
                .collect();
            let sum: f64 = texels.iter().map(|t| t.1).sum();
            for (i, a) in &texels {
                before += a * a / sum;
                after += texels
                    .iter()
                    .map(|(j, b)| a * b * left[(*i, *j)])
                    .sum::<f64>()
                    / sum;
            }
        }
    }
    after / before
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_that_are_no_numbers_have_no_limit() {
        let grid = LatLong::new(2, 4);
        let known = Known {
            operator: false,
            albedo: true,
        };
        let limit = |value: f64| {
            let gram = DMatrix::from_diagonal_element(grid.len(), grid.len(), value);
            Limit::new(known, grid, gram)
        };
        let half = limit(1.0).map(|limit| limit.error * limit.error);
        assert!(half.is_some_and(|half| (half - 0.5).abs() < 1e-12));
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -2.0] {
            assert!(limit(value).is_none(), "{value}");
        }
    }
}
