//! The `paper` preset: Monte Carlo with multiple importance sampling, the two-sample loss of Eq. 9, Adam at the paper's
//! rates, everything starting from nothing (Verbin et al., "Eclipse", CVPR 2024, Sec. 4).
//!
//! What differs from the printed text, and why, is settled by the renderer: the cosine is counted once, masks start at logit
//! 5 because the gradient at 100 is zero in single precision, and samples tile the square for any number of rays. Batches are
//! as small as the time asks for ([`plan`]), with the occluders' rate lowered to match ([`state`]), and rates fall at the end.

pub mod batch;
pub mod export;
pub mod finish;
pub mod materials;
pub mod plan;
pub mod start;
pub mod state;

use std::time::Instant;

use autodiff::{GraphError, RunError};
use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    environment::LightDistribution,
    estimator::{Estimator, EstimatorOptions, RenderSample},
    harmonics::Harmonics,
    image::Image,
    lat_long::LatLong,
    loss::LossForm,
    materials::MaterialNetwork,
    path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint},
    pyramid::Pyramid,
    visibility::Visibility,
};

use self::{batch::Pixel, materials::MaterialEvaluator, plan::Plan, start::Start, state::State};
use crate::{
    capture::Capture,
    checkpoint::{self, Checkpoint, CheckpointError},
    control::{Control, Progress},
    reconstruction::{CurvePoint, Ended, Noise, Reconstruction},
    settings::Settings,
};

/// Levels of the environment's pyramid (Eq. 7); it ends early where a level has one texel.
const LEVELS: usize = 6;
/// The masks' transmittance at the start as a logit: σ(5) = 0.993.
const START_LOGIT: f32 = 5.0;
/// Seconds between checkpoints.
const CHECKPOINT_SECONDS: f64 = 30.0;
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

/// A whole reconstruction from nothing, without remarks, from the pixels that are `used` (frame, row-major pixel).
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
    let solution = solve(capture, bvh, settings, used, None, control)?;
    (control.progress)(&Progress {
        stage: "materials and renders",
        iteration: solution.iterations,
        iterations: plan::iterations(settings),
        loss: f64::NAN,
        samples_per_second: 0.0,
        seconds: solution.seconds,
    });
    finish::finish(solution, capture, bvh, settings, noise, used)
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
    let problem = Problem::new(capture, bvh, settings, used)?;
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
    let mut saved = f64::NEG_INFINITY;
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
        if now - saved >= CHECKPOINT_SECONDS {
            save(&state)?;
            saved = now;
        }
    };
    save(&state)?;
    Ok(problem.solution(state, seconds(), ended))
}

/// What does not change during a run.
struct Problem<'a> {
    capture: &'a Capture,
    bvh: &'a Bvh,
    settings: &'a Settings,
    pixels: Vec<Pixel>,
    radii: Vec<f32>,
    options: EstimatorOptions,
    estimator: Estimator,
    evaluator: MaterialEvaluator,
}

impl<'a> Problem<'a> {
    fn new(
        capture: &'a Capture,
        bvh: &'a Bvh,
        settings: &'a Settings,
        used: &(dyn Fn(usize, u32) -> bool + Sync),
    ) -> Result<Self, PaperError> {
        let pixels = batch::pixels(bvh, &capture.frames, used);
        if pixels.is_empty() {
            return Err(PaperError::NoPixels);
        }
        let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
        let options = EstimatorOptions {
            model: if settings.lambertian {
                Model::Lambertian
            } else {
                Model::Microfacet
            },
            pyramid: Pyramid::new(grid, LEVELS),
            mask_grid: grid,
            degree: settings.harmonic_degree,
            frames: if settings.occluders {
                capture.frames.len()
            } else {
                0
            },
            lookup: Lookup::Stochastic,
            form: LossForm::HalfBackward,
        };
        Ok(Self {
            capture,
            bvh,
            settings,
            pixels,
            radii: capture.frames.iter().map(|f| f.camera.distance()).collect(),
            estimator: Estimator::new(options.clone())?,
            evaluator: MaterialEvaluator::new()?,
            options,
        })
    }

    /// The state before the first iteration of this run.
    fn start(&self, start: Option<&Start>, control: &Control<'_>) -> Result<State, PaperError> {
        let radius = self.capture.mesh.bounding_radius();
        let seed = self.settings.seed;
        let mut unknowns = self.options.start(START_LOGIT, seed, radius);
        if let (Some(start), None) = (start, control.resume) {
            let EstimatorOptions {
                pyramid, degree, ..
            } = &self.options;
            start.apply(&mut unknowns, pyramid, *degree, &self.evaluator, seed)?;
        }
        let mut state = State::new(unknowns, Plan::new(self.settings));
        if let Some(checkpoint) = control.resume {
            state.restore(checkpoint)?;
        }
        Ok(state)
    }

    /// One iteration; returns the number of samples shaded.
    fn iterate(&self, state: &mut State, seconds: f64) -> Result<usize, PaperError> {
        let pixels = batch::choose(
            &self.pixels,
            state.plan.pixels,
            self.settings.seed,
            state.iteration,
        );
        let photographs = batch::photographs(&self.capture.frames, &pixels);
        let light = radiance(&state.unknowns.environment, &self.options.pyramid);
        let lights = LightDistribution::new(self.options.mask_grid, &brightness(&light));
        let first = self.render(state, &lights, &pixels, 0)?;
        let second = self.render(state, &lights, &pixels, 1)?;
        let samples = [&first, &second].map(|render| RenderSample {
            positions: &render.0,
            batch: &render.1,
        });
        let (loss, gradients) = self
            .estimator
            .gradients(&state.unknowns, samples, &photographs)?;
        // The half-backward form has twice the value.
        let loss = 0.5 * loss / photographs.len() as f64;
        if !loss.is_finite() {
            return Err(PaperError::Diverged {
                iteration: state.iteration + 1,
                loss,
            });
        }
        let progress = plan::progress(self.settings, state.iteration, seconds);
        state.step(&gradients, plan::rate(progress), loss);
        Ok(first.1.samples() + second.1.samples())
    }

    /// Positions and paths of one of the two independent renders of `pixels`.
    fn render(
        &self,
        state: &State,
        lights: &LightDistribution,
        pixels: &[Pixel],
        render: u32,
    ) -> Result<(Vec<Vec3>, PathBatch), PaperError> {
        let seed = self.settings.seed;
        let frames = &self.capture.frames;
        let mut points = batch::points(self.bvh, frames, pixels, seed, state.iteration, render);
        let positions: Vec<Vec3> = points.iter().map(|p| p.surface.position).collect();
        if self.options.model == Model::Microfacet {
            let materials = self
                .evaluator
                .evaluate(&state.unknowns.network, &positions)?;
            let follow = |(point, material): (&mut ShadingPoint, &Material)| {
                point.alpha = material.alpha;
            };
            points.iter_mut().zip(&materials).for_each(follow);
        }
        let scene = PathScene {
            bvh: self.bvh,
            visibility: Visibility::Rays,
            model: self.options.model,
            lights,
            environment_grid: self.options.mask_grid,
            mask_grid: self.options.mask_grid,
            radii: &self.radii,
        };
        let rays = state.plan.rays as usize;
        let settings = PathSettings {
            light_samples: rays / 2,
            material_samples: rays - rays / 2,
            seed,
            iteration: state.iteration as u32,
            lookup: self.options.lookup,
            render,
        };
        Ok((positions, PathBatch::sample(&scene, &points, &settings)))
    }

    fn solution(self, state: State, seconds: f64, ended: Ended) -> PaperSolution {
        let EstimatorOptions {
            model,
            pyramid,
            mask_grid,
            degree,
            ..
        } = &self.options;
        PaperSolution {
            environment: radiance(&state.unknowns.environment, pyramid),
            masks: transmittance(&state.unknowns.occluders, *mask_grid, *degree),
            network: state.unknowns.network,
            model: *model,
            radii: self.radii,
            curve: state.curve,
            iterations: state.iteration,
            seconds,
            ended,
            evaluator: self.evaluator,
        }
    }
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
    let mask = |t: usize| Image {
        width: grid.columns,
        height: grid.rows,
        channels: 1,
        data: values[t..]
            .iter()
            .step_by(frames)
            .map(|x| 1.0 / (1.0 + (-x).exp()))
            .collect(),
    };
    (0..frames).map(mask).collect()
}
