//! The `paper` preset: Monte Carlo with multiple importance sampling, the two-sample loss of Eq. 9, Adam at the paper's
//! rates, everything starting from nothing (Verbin et al., "Eclipse", CVPR 2024, Sec. 4).
//!
//! What differs from the printed text, and why, is settled by the renderer: the cosine is counted once, masks start at logit
//! 5 because the gradient at 100 is zero in single precision, and samples tile the square for any number of rays. Batches are
//! as small as the time asks for ([`plan`]), with rates lowered to match, and they fall at the end ([`rates`]).

pub mod batch;
pub mod cells;
pub mod export;
pub mod finish;
pub mod materials;
pub mod plan;
mod problem;
pub mod rates;
pub mod start;
pub mod state;

use std::{path::PathBuf, time::Instant};

use autodiff::{GraphError, RunError};
use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    harmonics::Harmonics,
    image::Image,
    lat_long::LatLong,
    materials::MaterialNetwork,
    pyramid::Pyramid,
};

use self::{
    materials::MaterialEvaluator, plan::Plan, problem::Problem, start::Start, state::State,
};
use crate::{
    capture::Capture,
    checkpoint::{self, Checkpoint, CheckpointError},
    control::{Control, Progress},
    reconstruction::{CurvePoint, Ended, Noise, Reconstruction},
    settings::Settings,
};

/// Seconds between checkpoints.
const CHECKPOINT_SECONDS: f64 = 30.0;
/// Seconds between looks at the light, for whoever watches.
const LIGHT_SECONDS: f64 = 1.0;
/// Iterations between points of the loss curve.
const CURVE_EVERY: u64 = 20;

/// What the optimiser ends with.
pub struct PaperSolution {
    /// Linear radiance on the grid.
    pub environment: Image,
    /// Transmittance of each frame's occluder on the grid, one channel; none when not modelled.
    pub masks: Vec<Image>,
    /// The material network.
    pub network: MaterialNetwork,
    /// Which reflectance it parameterises.
    pub model: Model,
    /// Shell radius of each frame: where its mask is looked up (Eq. 5).
    pub radii: Vec<f32>,
    /// Loss (deviation squared per value, smoothed) over time.
    pub curve: Vec<CurvePoint>,
    /// Iterations done.
    pub iterations: u64,
    /// Seconds of solving, those before a resume included.
    pub seconds: f64,
    /// Why it ended.
    pub ended: Ended,
    evaluator: MaterialEvaluator,
}

impl PaperSolution {
    /// The materials at surface positions. With Lambertian reflectance α and κ were not fitted.
    ///
    /// # Errors
    /// When memory does not suffice.
    pub fn materials(&self, positions: &[Vec3]) -> Result<Vec<Material>, RunError> {
        self.evaluator.evaluate(&self.network, positions)
    }
}

/// Why the preset failed.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// Nothing to fit.
    #[error(
        "no pixel of the capture shows the object alone and from above: check that masks and mesh overlap, or use larger images"
    )]
    NoPixels,
    /// The loss left the range of numbers.
    #[error(
        "the loss of iteration {iteration} is {loss}: the optimiser diverged; use the fast preset, or check the photographs for \
         extreme values"
    )]
    Diverged {
        /// Iteration.
        iteration: u64,
        /// What was found.
        loss: f64,
    },
    /// The result to start from could not be read or does not belong to the capture.
    #[error("cannot start from {}: {reason}", path.display())]
    Start {
        /// Its folder.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The tape refused its formulas.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The tape could not run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The state could not be saved or continued.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

/// A whole reconstruction, without remarks, from nothing or from the result that the settings name, from the pixels that are `used` (frame, row-major pixel).
///
/// # Errors
/// As [`solve`].
pub fn run(
    capture: &Capture,
    bvh: &Bvh,
    settings: &Settings,
    noise: Noise,
    used: &(dyn Fn(usize, u32) -> bool + Sync),
    control: &Control<'_>,
) -> Result<Reconstruction, PaperError> {
    let start = match (&settings.from, control.resume) {
        (Some(folder), None) => Some(Start::read(folder, capture, bvh)?),
        _ => None,
    };
    let solution = solve(capture, bvh, settings, used, start.as_ref(), control)?;
    (control.progress)(&Progress {
        stage: "materials and renders",
        iteration: solution.iterations,
        iterations: plan::iterations(settings),
        loss: f64::NAN,
        samples_per_second: 0.0,
        seconds: solution.seconds,
    });
    finish::finish(solution, capture, bvh, settings, noise)
}

/// The bytes of memory that a run plans to take at its peak.
pub fn memory(capture: &Capture, settings: &Settings) -> u64 {
    Plan::new(settings, capture)
        .memory(settings, capture)
        .total()
}

/// Runs the optimiser on the pixels that are `used` (frame, row-major pixel), from nothing or from `start`.
///
/// With a number of iterations and no time limit the result depends on capture and settings alone, whatever the threads and
/// however often it was interrupted and resumed.
///
/// # Errors
/// When no pixel can be fitted, the optimiser diverges, memory does not suffice, or a checkpoint cannot be used.
pub fn solve(
    capture: &Capture,
    bvh: &Bvh,
    settings: &Settings,
    used: &(dyn Fn(usize, u32) -> bool + Sync),
    start: Option<&Start>,
    control: &Control<'_>,
) -> Result<PaperSolution, PaperError> {
    let plan = match control.resume {
        Some(checkpoint) => state::plan(checkpoint)?,
        None => Plan::new(settings, capture),
    };
    solve_planned(capture, bvh, settings, plan, used, start, control)
}

/// The same with iterations of a size of one's own.
///
/// # Errors
/// As [`solve`].
pub fn solve_planned(
    capture: &Capture,
    bvh: &Bvh,
    settings: &Settings,
    plan: Plan,
    used: &(dyn Fn(usize, u32) -> bool + Sync),
    start: Option<&Start>,
    control: &Control<'_>,
) -> Result<PaperSolution, PaperError> {
    let problem = Problem::new(capture, bvh, settings, plan, used)?;
    let mut state = problem.start(start, control)?;
    let before = control.resume.map_or(0.0, |checkpoint| checkpoint.seconds);
    let began = Instant::now();
    let seconds = || before + began.elapsed().as_secs_f64();
    let fingerprint = checkpoint::fingerprint(capture);
    let save = |state: &State| {
        (control.checkpoint)(&Checkpoint {
            settings: settings.clone(),
            capture: fingerprint,
            iteration: state.iteration,
            seconds: seconds(),
            arrays: state.arrays(),
        })
    };
    let most = plan::iterations(settings);
    let (mut saved, mut shown) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
    let ended = loop {
        if control.stopped() {
            break Ended::Interrupted;
        }
        if most.is_some_and(|most| state.iteration >= most) {
            break Ended::Iterations;
        }
        let at = seconds();
        if plan::seconds(settings).is_some_and(|limit| at >= limit) {
            break Ended::TimeLimit;
        }
        let samples = problem.iterate(&mut state, at)?;
        let now = seconds();
        let rate = samples as f64 / (now - at).max(1e-9);
        if state.iteration == 1 || state.iteration.is_multiple_of(CURVE_EVERY) {
            state.curve.push(CurvePoint {
                iteration: state.iteration,
                seconds: now,
                loss: state.loss,
                samples_per_second: rate,
            });
        }
        (control.progress)(&Progress {
            stage: "light, materials and occluders",
            iteration: state.iteration,
            iterations: most,
            loss: state.loss,
            samples_per_second: rate,
            seconds: now,
        });
        if let Some(show) = control.light
            && now - shown >= LIGHT_SECONDS
        {
            show(&problem.radiance(&state));
            shown = now;
        }
        if now - saved >= CHECKPOINT_SECONDS {
            save(&state)?;
            saved = now;
        }
    };
    save(&state)?;
    Ok(problem.solution(state, seconds(), ended))
}

/// The environment of pyramid values `[channel][value]` (Eq. 7).
pub fn radiance(levels: &[f32], pyramid: &Pyramid) -> Image {
    let grid = pyramid.finest();
    let mut image = Image::filled(grid.columns, grid.rows, 3, 0.0);
    let mut finest = vec![0.0; grid.len()];
    for (c, channel) in levels.chunks_exact(pyramid.len()).enumerate() {
        pyramid.apply(channel, &mut finest, 1);
        let texels = image.data.iter_mut().skip(c).step_by(3);
        // Beyond e⁸⁰ sums over texels leave the range of single precision.
        texels
            .zip(&finest)
            .for_each(|(out, v)| *out = v.min(80.0).exp());
    }
    image
}

/// What light samples follow: the sum of the channels of each texel.
fn brightness(environment: &Image) -> Vec<f32> {
    environment
        .data
        .chunks_exact(3)
        .map(|p| p.iter().sum())
        .collect()
}

/// The masks of harmonic coefficients `[coefficient][frame]` (Eq. 6), an image a frame.
pub fn transmittance(coefficients: &[f32], grid: LatLong, degree: usize) -> Vec<Image> {
    let frames = coefficients.len() / (degree + 1).pow(2);
    if frames == 0 {
        return Vec::new();
    }
    let mut values = vec![0.0; grid.len() * frames];
    Harmonics::<f32>::new(degree, grid).synthesize(coefficients, &mut values, frames);
    free_transmittance(&values, grid)
}

/// The masks of logits `[texel][frame]`, an image a frame.
pub fn free_transmittance(logits: &[f32], grid: LatLong) -> Vec<Image> {
    let frames = logits.len() / grid.len();
    let mask = |t: usize| Image {
        width: grid.columns,
        height: grid.rows,
        channels: 1,
        data: logits[t..]
            .iter()
            .step_by(frames)
            .map(|x| 1.0 / (1.0 + (-x).exp()))
            .collect(),
    };
    (0..frames).map(mask).collect()
}
