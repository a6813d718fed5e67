//! The `fast` preset: second-order steps on patches, coarse grid first.

use std::time::Instant;

use autodiff::GraphError;
use render::{bvh::Bvh, lat_long::LatLong};

use super::{
    cutout::Stand,
    detail,
    least_squares::{self, Linearisation, StepOptions},
    model::{At, Shared, mask_grid},
    patches::{Observations, PatchOptions},
    shell::Shells,
    sky::SkyModel,
    surface::Surface,
};
use crate::{capture::Frame, reconstruction::Noise, settings::OccluderPrior};

/// No texel's log radiance changes by more in one step: beyond, the linearisation of the exponential means nothing.
const LARGEST_CHANGE: f32 = 3.0;

/// How often a step that does not lower the cost is shortened before another direction is sought.
const HALVINGS: usize = 2;
/// The damping of the first step, far from everything.
const FIRST_DAMPING: f32 = 4000.0;
/// The damping never falls below: there is always the prior.
const LEAST_DAMPING: f32 = 1e-3;

/// One stage of the schedule: a grid, and how finely the surface is divided.
#[derive(Clone, Copy, Debug)]
pub struct Stage {
    /// Rows of the grid of light.
    pub rows: usize,
    /// About how many patches.
    pub patches: usize,
    /// Members of a patch.
    pub members: usize,
    /// Most steps.
    pub steps: usize,
    /// Products a step.
    pub products: usize,
}

/// What the steps of a stage end with.
pub struct Solution {
    /// Parameters in units of their priors.
    pub z: Vec<f32>,
    /// Albedo, `[channel][patch]`.
    pub albedo: Vec<f32>,
    /// Twice the data term per residual.
    pub chi2: f64,
    /// The damping of the next step.
    pub damping: f32,
}

/// What is fitted, and what is assumed of occluders.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// The object.
    pub bvh: &'a Bvh,
    /// Photographs.
    pub frames: &'a [Frame],
    /// Their noise.
    pub noise: &'a Noise,
    /// Whether occluders are modelled, and what is assumed of them.
    pub occluders: Option<OccluderPrior>,
    /// Degree of the harmonics when nothing is assumed.
    pub harmonic_degree: usize,
    /// Seed of every random number.
    pub seed: u64,
    /// Worker threads.
    pub threads: usize,
}

/// What a stage works on.
pub struct Prepared {
    /// What every frame saw of the patches.
    pub observations: Observations,
    /// Which patch each site of the surface belongs to (see [`detail::patch_of_site`]).
    pub patch_of_site: Vec<u32>,
    /// The tape.
    pub shared: Shared,
}

/// Prepares a stage on patches of `surface`.
///
/// # Errors
/// When the tape does not compile, which would be a bug.
pub fn prepare(
    problem: &Problem<'_>,
    surface: &Surface,
    stage: &Stage,
    used: &(dyn Fn(usize, u32) -> bool + Sync),
) -> Result<Prepared, GraphError> {
    let options = PatchOptions {
        count: stage.patches,
        members: stage.members,
        model_error: 0.006,
    };
    let frames = problem.frames;
    let observations = Observations::gather(
        problem.bvh,
        frames,
        problem.noise,
        &options,
        problem.seed,
        used,
    );
    let grid = LatLong::new(stage.rows, 2 * stage.rows);
    let patch_of_site = detail::patch_of_site(surface, &observations);
    let rows = surface.rows_of(problem.bvh, grid, &observations.patches, &patch_of_site);
    let cameras = || frames.iter().map(|f| &f.camera);
    let (sky, shells) = match problem.occluders {
        None => (SkyModel::Clear, Shells::spheres(cameras())),
        Some(OccluderPrior::Operator) => {
            let stands = Stand::behind_all(cameras());
            let distances: Vec<f32> = stands.iter().map(|s| s.distance).collect();
            (SkyModel::cutout(stands)?, Shells::cylinders(&distances))
        }
        Some(OccluderPrior::None) => (
            SkyModel::harmonics(problem.harmonic_degree, mask_grid(grid), frames.len())?,
            Shells::spheres(cameras()),
        ),
    };
    let shared = Shared::new(grid, &rows, &observations, shells, sky, problem.threads)?;
    Ok(Prepared {
        observations,
        patch_of_site,
        shared,
    })
}

/// Carries a solution to a finer stage: coarse levels come first in the pyramid, occluders do not depend on the grid.
pub fn refine(from: &Shared, z: &[f32], to: &Shared) -> Vec<f32> {
    let mut fine = vec![0.0; to.parameters()];
    let ([coarse, a], [finer, b]) = (from.ranges(), to.ranges());
    let (coarse, finer) = (coarse.len() / 3, finer.len() / 3);
    let kept = coarse.min(finer);
    for c in 0..3 {
        fine[c * finer..c * finer + kept].copy_from_slice(&z[c * coarse..c * coarse + kept]);
    }
    fine[b].copy_from_slice(&z[a]);
    fine
}

/// Where a stage begins, or goes on.
#[derive(Clone, Debug)]
pub struct Start {
    /// Parameters in units of their priors.
    pub z: Vec<f32>,
    /// The damping of the next step.
    pub damping: f32,
    /// Steps of the stage already done.
    pub step: usize,
}

impl From<Vec<f32>> for Start {
    fn from(z: Vec<f32>) -> Self {
        Self {
            z,
            damping: FIRST_DAMPING,
            step: 0,
        }
    }
}

/// Where a stage stands after a step.
pub struct Step<'a> {
    /// Number of the step, from 0.
    pub step: usize,
    /// The linearisation.
    pub at: &'a At<'a>,
    /// Parameters.
    pub z: &'a [f32],
    /// Albedo, `[channel][patch]`.
    pub albedo: &'a [f32],
    /// What is minimised.
    pub cost: f64,
    /// The damping of the next step: with `z`, all that a continuation needs.
    pub damping: f32,
    /// Seconds since the stage began.
    pub seconds: f64,
}

/// Steps until the stage's limit or until `on_step`, told of each, returns false.
pub fn solve(
    shared: &Shared,
    stage: &Stage,
    start: Start,
    on_step: &mut dyn FnMut(&Step<'_>) -> bool,
) -> Result<Solution, autodiff::RunError> {
    let options = StepOptions {
        products: stage.products,
        tolerance: 1e-6,
        albedo_precision: shared.albedo_precision,
    };
    let Start {
        mut z,
        mut damping,
        step: first,
    } = start;
    let (mut at, mut albedo) = shared.linearise(&z)?;
    let mut cost = least_squares::cost(at.residual(), &z, &albedo, shared.albedo_precision);
    let began = Instant::now();
    for step in first..stage.steps {
        let proposal = least_squares::step(&mut at, &z, albedo.len(), damping, &options);
        let mut share = (LARGEST_CHANGE / shared.largest_change(&z, &proposal.delta)).min(1.0);
        let mut accepted = false;
        for _ in 0..=HALVINGS {
            let moved = |(a, b): (&f32, &f32)| a + share * b;
            let candidate: Vec<f32> = z.iter().zip(&proposal.delta).map(moved).collect();
            let (next, next_albedo) = shared.linearise(&candidate)?;
            let residual = next.residual();
            let next_cost =
                least_squares::cost(residual, &candidate, &next_albedo, shared.albedo_precision);
            if next_cost < cost {
                let gain = (cost - next_cost) / proposal.predicted(f64::from(share));
                damping = match gain {
                    _ if share < 0.2 => damping * 2.0,
                    g if g > 0.7 => (damping * 0.4).max(LEAST_DAMPING),
                    g if g < 0.3 => damping * 2.0,
                    _ => damping,
                };
                (z, at, albedo, cost) = (candidate, next, next_albedo, next_cost);
                accepted = true;
                break;
            }
            share *= 0.35;
        }
        if !accepted {
            damping *= 8.0;
        }
        let go_on = on_step(&Step {
            step,
            at: &at,
            z: &z,
            albedo: &albedo,
            cost,
            damping,
            seconds: began.elapsed().as_secs_f64(),
        });
        if !go_on {
            break;
        }
    }
    let chi2 = at
        .residual()
        .iter()
        .map(|&r| f64::from(r).powi(2))
        .sum::<f64>()
        / at.residual().len() as f64;
    Ok(Solution {
        z,
        albedo,
        chi2,
        damping,
    })
}
