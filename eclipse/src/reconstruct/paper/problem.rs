//! What an iteration of the `paper` preset computes.

use glam::Vec3;
use render::{
    bsdf::Model,
    bvh::Bvh,
    environment::LightDistribution,
    estimator::{Estimator, EstimatorOptions, MaskBasis, RenderSample, Unknowns},
    image::Image,
    lat_long::LatLong,
    loss::LossForm,
    path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint},
    pyramid::Pyramid,
    visibility::{Visibility, VisibilityCache},
};

use super::{
    PaperError, PaperSolution,
    batch::{self, Pixel},
    brightness,
    cells::Cells,
    free_transmittance,
    materials::MaterialEvaluator,
    plan::{self, Plan},
    radiance, rates,
    start::Start,
    state::State,
    transmittance,
};
use crate::{
    capture::Capture,
    control::Control,
    reconstruct::hold_out,
    reconstruction::Ended,
    settings::{LightForm, MaskForm, Parametrisation, Settings},
};

/// Levels of the environment's pyramid (Eq. 7); it ends early where a level has one texel.
const LEVELS: usize = 6;
/// Iterations between looks at the roughness that material samples follow. Any would be right; the present one has the
/// least noise.
const ROUGHNESS_EVERY: u64 = 64;

/// What does not change during a run.
pub(super) struct Problem<'a> {
    capture: &'a Capture,
    bvh: &'a Bvh,
    settings: &'a Settings,
    /// Those that everything is fitted to, and those of held-out frames that only their occluders are.
    fitted: Vec<Pixel>,
    held_out: Vec<Pixel>,
    /// A place of the surface for each cell of the pixels, and what it sees.
    positions: Vec<Vec3>,
    visible: Option<VisibilityCache>,
    plan: Plan,
    radii: Vec<f32>,
    options: EstimatorOptions,
    masks: MaskBasis,
    estimator: Estimator,
    evaluator: MaterialEvaluator,
}

impl<'a> Problem<'a> {
    pub(super) fn new(
        capture: &'a Capture,
        bvh: &'a Bvh,
        settings: &'a Settings,
        plan: Plan,
        used: &(dyn Fn(usize, u32) -> bool + Sync),
    ) -> Result<Self, PaperError> {
        let mut fitted = batch::pixels(bvh, &capture.frames, used);
        if fitted.is_empty() {
            return Err(PaperError::NoPixels);
        }
        let halved = |t: usize, p: u32| {
            settings.holds_out(t)
                && hold_out::fitted_half(capture.frames[t].image.width, p as usize)
        };
        let mut held_out = match settings.occluders {
            true => batch::pixels(bvh, &capture.frames, &halved),
            false => Vec::new(),
        };
        let all = fitted.iter().chain(&held_out);
        let surface = batch::centres(bvh, &capture.frames, all);
        let radius = capture.mesh.bounding_radius();
        let cells = Cells::new(&surface, radius, plan.cells as usize);
        let pixels = fitted.iter_mut().chain(&mut held_out);
        for (pixel, cell) in pixels.zip(&cells.of_point) {
            pixel.cell = *cell;
        }
        let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
        let visible = (plan.side > 0)
            .then(|| VisibilityCache::build(bvh, grid, plan.side as usize, &cells.places));
        let options = EstimatorOptions {
            model: if settings.lambertian {
                Model::Lambertian
            } else {
                Model::Microfacet
            },
            pyramid: pyramid(grid, &settings.parametrisation),
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
        let masks = match settings.parametrisation.masks {
            MaskForm::Harmonics => MaskBasis::Harmonics,
            MaskForm::Texels => MaskBasis::Texels,
        };
        Ok(Self {
            capture,
            bvh,
            settings,
            plan,
            fitted,
            held_out,
            positions: cells.places.iter().map(|p| p.position).collect(),
            visible,
            radii: capture.frames.iter().map(|f| f.camera.distance()).collect(),
            estimator: Estimator::with_masks(options.clone(), masks)?,
            evaluator: MaterialEvaluator::new()?,
            options,
            masks,
        })
    }

    /// The state before the first iteration of this run.
    pub(super) fn start(
        &self,
        start: Option<&Start>,
        control: &Control<'_>,
    ) -> Result<State, PaperError> {
        let radius = self.capture.mesh.bounding_radius();
        let seed = self.settings.seed;
        let logit = self.settings.parametrisation.mask_logit as f32;
        let mut unknowns = self.options.start_in(self.masks, logit, seed, radius);
        if let (Some(start), None) = (start, control.resume) {
            start.apply(
                &mut unknowns,
                &self.options,
                self.masks,
                &self.evaluator,
                seed,
            )?;
        }
        let mut state = State::new(unknowns, self.plan, self.positions.len());
        if let Some(checkpoint) = control.resume {
            state.restore(checkpoint)?;
        }
        Ok(state)
    }

    /// One iteration; returns the number of samples shaded.
    pub(super) fn iterate(&self, state: &mut State, seconds: f64) -> Result<usize, PaperError> {
        let microfacet = self.options.model == Model::Microfacet;
        if microfacet && state.iteration.is_multiple_of(ROUGHNESS_EVERY) {
            let materials = self
                .evaluator
                .evaluate(&state.unknowns.network, &self.positions)?;
            state.roughness = materials.iter().map(|m| m.alpha).collect();
        }
        let light = radiance(&state.unknowns.environment, &self.options.pyramid);
        let lights = LightDistribution::new(self.options.mask_grid, &brightness(&light));
        // Held-out frames take part by their share.
        let all = (self.fitted.len() + self.held_out.len()) as u64;
        let held_out = state.plan.pixels * self.held_out.len() as u64 / all;
        let count = state.plan.pixels - held_out;
        let (loss, mut gradients, mut samples) =
            self.gradients(state, &lights, &self.fitted, count)?;
        if held_out > 0 {
            let (_, own, more) = self.gradients(state, &lights, &self.held_out, held_out)?;
            let occluders = gradients.occluders.iter_mut().zip(&own.occluders);
            occluders.for_each(|(all, own)| *all += own);
            samples += more;
        }
        if !loss.is_finite() {
            return Err(PaperError::Diverged {
                iteration: state.iteration + 1,
                loss,
            });
        }
        let progress = plan::progress(self.settings, state.iteration, seconds);
        let from_start = self.settings.from.is_some();
        let shares = rates::shares(progress, from_start, state.plan.pixels);
        state.step(&gradients, shares, loss);
        Ok(samples)
    }

    /// Loss a value, gradients and number of samples of `count` of `pixels`.
    fn gradients(
        &self,
        state: &State,
        lights: &LightDistribution,
        pixels: &[Pixel],
        count: u64,
    ) -> Result<(f64, Unknowns, usize), PaperError> {
        let pixels = batch::choose(pixels, count, self.settings.seed, state.iteration);
        let photographs = batch::photographs(&self.capture.frames, &pixels);
        let first = self.render(state, lights, &pixels, 0);
        let second = self.render(state, lights, &pixels, 1);
        let samples = [&first, &second].map(|render| RenderSample {
            positions: &render.0,
            batch: &render.1,
        });
        let (loss, gradients) = self
            .estimator
            .gradients(&state.unknowns, samples, &photographs)?;
        // The half-backward form has twice the value.
        let loss = 0.5 * loss / photographs.len() as f64;
        Ok((loss, gradients, first.1.samples() + second.1.samples()))
    }

    /// Positions and paths of one of the two independent renders of `pixels`.
    fn render(
        &self,
        state: &State,
        lights: &LightDistribution,
        pixels: &[Pixel],
        render: u32,
    ) -> (Vec<Vec3>, PathBatch) {
        let seed = self.settings.seed;
        let frames = &self.capture.frames;
        let mut points = batch::points(self.bvh, frames, pixels, seed, state.iteration, render);
        let positions: Vec<Vec3> = points.iter().map(|p| p.surface.position).collect();
        let follow = |point: &mut ShadingPoint| {
            point.alpha = state.roughness[point.cached as usize];
        };
        points.iter_mut().for_each(follow);
        let scene = PathScene {
            bvh: self.bvh,
            visibility: match &self.visible {
                Some(cache) => Visibility::Cached(cache),
                None => Visibility::Rays,
            },
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
        (positions, PathBatch::sample(&scene, &points, &settings))
    }

    /// The environment as it stands.
    pub(super) fn radiance(&self, state: &State) -> Image {
        radiance(&state.unknowns.environment, &self.options.pyramid)
    }

    pub(super) fn solution(self, state: State, seconds: f64, ended: Ended) -> PaperSolution {
        let EstimatorOptions {
            model,
            mask_grid,
            degree,
            ..
        } = &self.options;
        PaperSolution {
            environment: self.radiance(&state),
            masks: match self.masks {
                MaskBasis::Harmonics => {
                    transmittance(&state.unknowns.occluders, *mask_grid, *degree)
                }
                MaskBasis::Texels => free_transmittance(&state.unknowns.occluders, *mask_grid),
            },
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

/// What the light's logarithm is summed from.
fn pyramid(grid: LatLong, parametrisation: &Parametrisation) -> Pyramid {
    let pyramid = Pyramid::with_ratio(grid, LEVELS, parametrisation.level_ratio);
    match parametrisation.light {
        LightForm::Pyramid => pyramid,
        LightForm::Texels => pyramid.finest_alone(),
    }
}
