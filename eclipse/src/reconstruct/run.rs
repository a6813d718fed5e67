//! A whole reconstruction: noise, stages coarse to fine, materials and images, scores and remarks.

use std::time::Instant;

use render::{bvh::Bvh, image::Image, lat_long::LatLong};

mod error;
mod evidence;
mod frames;
mod kept;
mod outcome;
mod pace;
mod plan;
mod round;
mod schedule;
mod state;
mod uncertainty;

pub use error::ReconstructError;
use frames::Frames;
use kept::check_length;
pub use kept::{memory, memory_to_resume};
use pace::{BEFORE_NOTHING, Pace};
use plan::Plan;
pub use plan::check_memory;
use round::RoundStart;
use schedule::{LEGS, Place, ROUND_DAMPING, end_of_steps};

use super::{
    fast::{self, Prepared, Problem, Stage, Start},
    finish, hold_out,
    model::Shared,
    noise, paper,
    patches::Observations,
    shading::Masks,
    surface::Surface,
};
use crate::{
    capture::Capture,
    checkpoint::{CheckpointError, fingerprint},
    control::{Control, Progress},
    reconstruction::{CurvePoint, Ended, Noise, Photometric, Reconstruction},
    settings::{Preset, Settings},
};

/// A step that lowers the cost by less than this share of it is as good as none.
const CONVERGED: f64 = 3e-5;

/// Recovers light, materials and occluders from a capture.
///
/// The result is the same for any number of threads, and the same after a continuation, whatever memory that has; only a time
/// limit makes it depend on the machine's speed.
///
/// # Errors
/// [`ReconstructError`].
pub fn run(
    capture: &Capture,
    settings: &Settings,
    control: &Control<'_>,
) -> Result<Reconstruction, ReconstructError> {
    settings.check()?;
    settings.check_frames(capture.frames.len())?;
    check_light(capture)?;
    check_memory(capture, settings)?;
    if let Some(checkpoint) = control.resume {
        memory_to_resume(capture, settings, checkpoint)?;
    }
    let began = Instant::now();
    let noise = noise::estimate(&capture.frames);
    let bvh = Bvh::new(&capture.mesh)?;
    let frames = Frames::new(capture, settings);
    if settings.preset == Preset::Paper {
        let used = |frame: usize, _: u32| frames.fitted(frame);
        let mut found = paper::run(capture, &bvh, settings, noise, &used, control)?;
        let of_frames = frames.notes(&capture.frames, &found.occluders);
        found.notes.splice(..0, of_frames);
        return Ok(found);
    }
    let mut run = Run {
        capture,
        settings,
        control,
        noise,
        fingerprint: fingerprint(capture),
        plan: Plan::of(capture, settings, control.resume)?,
        began,
        before: 0.0,
        ready: 0.0,
        pace: Pace::default(),
        reached: 0,
        curve: Vec::new(),
        ended: Ended::Converged,
        failed: None,
        round: None,
    };
    let ([mut first, mut round], mut start) = match control.resume {
        Some(checkpoint) => run.resume(checkpoint)?,
        None => ([0; 2], None),
    };
    let begun_with = run.curve.len();
    let used = |frame: usize, _: u32| frames.fitted(frame);
    run.report("visibility of the surface", f64::NAN, 0.0);
    let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
    let surface = Surface::new(
        &bvh,
        &capture.frames,
        &run.noise,
        grid,
        run.plan.sites,
        settings.seed,
        &used,
    );
    let mut problem = Problem {
        bvh: &bvh,
        frames: &capture.frames,
        noise: &noise,
        occluders: settings.occluders.then_some(settings.occluder_prior),
        harmonic_degree: settings.harmonic_degree,
        seed: settings.seed,
        threads: settings.threads,
    };
    let mut last: Option<(Observations, Shared, Vec<f32>)> = None;
    while first < LEGS.len() {
        let (leg, stage) = (&LEGS[first], run.stage(first));
        let rounds = leg.held.len();
        let at = |round| Place {
            stage: first,
            round,
        };
        if last.is_some() && run.is_too_late_for(at(0), run.pace.until(&stage, BEFORE_NOTHING)) {
            run.ended = Ended::TimeLimit;
            break;
        }
        // Nobody waits for the end of what nothing has come of yet.
        if control.stopped() && run.curve.len() == begun_with {
            return Err(ReconstructError::Interrupted);
        }
        run.report("visibility of the surface", f64::NAN, 0.0);
        let stage_began = Instant::now();
        let Prepared {
            observations,
            patch_of_site,
            mut shared,
        } = fast::prepare(&problem, &surface, &stage, &used)?;
        run.pace.stage_took(stage_began.elapsed().as_secs_f64());
        if observations.views.is_empty() {
            return Err(ReconstructError::NothingToFit);
        }
        if (first, round) == (0, 0) {
            run.ready = run.seconds();
        }
        let mut resumed = start.is_some();
        let light = shared.ranges()[0].len();
        if problem.occluders.is_some() && start.as_ref().is_some_and(|from| from.z.len() == light) {
            // The run that is continued had found that nothing blocks the light.
            problem.occluders = None;
            shared = run.clear(&shared, &observations)?;
        }
        let mut from = match (start.take(), &last) {
            (Some(start), _) => start,
            (None, Some((_, coarse, z))) => Start {
                damping: ROUND_DAMPING,
                ..Start::from(fast::refine(coarse, z, &shared))
            },
            (None, None) => Start::from(vec![0.0; shared.parameters()]),
        };
        for z in [
            Some(&from.z),
            resumed.then(|| run.round.as_ref().map(|r| &r.z)).flatten(),
        ] {
            check_length(z, shared.parameters())?;
        }
        while round < rounds {
            // The very first steps are far from everything: patches alone will do.
            if (first, round) != (0, 0) {
                if !resumed && run.is_too_late_for(at(round), run.pace.round(&stage)) {
                    run.ended = Ended::TimeLimit;
                    break;
                }
                run.report("finer model", f64::NAN, 0.0);
                let round_began = Instant::now();
                let before = run.round.take();
                let lobe = before.as_ref().and_then(|begun| begun.lobe);
                let (z, known, before) = match &before {
                    Some(begun) if resumed => (&begun.z, lobe, None),
                    _ => (&from.z, None, lobe),
                };
                let (begun, data) = run.round(
                    &surface,
                    &shared,
                    (&observations, &patch_of_site),
                    z,
                    known,
                    before,
                )?;
                run.pace.round_took(round_began.elapsed().as_secs_f64());
                shared.fit_to(&observations, &data);
                run.round = Some(begun);
            }
            resumed = false;
            shared.sky.withhold(leg.held[round]);
            let (z, damping) = run.steps(leg.name, at(round), &stage, &shared, from)?;
            round += 1;
            from = Start {
                damping: damping.max(ROUND_DAMPING),
                ..Start::from(z)
            };
            if evidence::is_asked([first, round], run.ended)
                && let Some((clear, found)) = run.unoccluded(&shared, &stage, &observations)?
            {
                // Its round is done: a short run has no time to do it again, and goes on from nothing where it has to.
                problem.occluders = None;
                from = Start {
                    damping: found.damping.max(ROUND_DAMPING),
                    ..found
                };
                shared = clear;
            }
            if run.ended != Ended::Converged {
                break;
            }
        }
        last = Some((observations, shared, from.z));
        // The coarse stage's share of the time may be over while the run's is not.
        let end = end_of_steps(settings.time_limit.unwrap_or(f64::INFINITY));
        let goes_on =
            run.ended == Ended::TimeLimit && first + 1 < LEGS.len() && run.seconds() < end;
        if run.ended != Ended::Converged && !goes_on {
            break;
        }
        (first, round) = (first + 1, 0);
    }
    if run.ended == Ended::Interrupted && run.curve.len() == begun_with {
        return Err(ReconstructError::Interrupted);
    }
    let (observations, mut shared, z) = last.ok_or(ReconstructError::NothingToFit)?;
    let mut found = run.finish(&bvh, &surface, &frames, &shared, &z)?;
    run.doubt(&bvh, &frames, &observations, &mut shared, &z, &mut found)?;
    if settings.occluders && problem.occluders.is_none() {
        found.notes.push(
            "the photographs show no sign of an occluder: what occluders explain is no more than chance".to_owned(),
        );
    }
    Ok(found)
}

/// How well `renders` of all frames explain the photographs of `capture`.
pub fn photometric(capture: &Capture, settings: &Settings, renders: &[Image]) -> Photometric {
    let (chosen, frames) = (Frames::new(capture, settings), &capture.frames);
    let fitted = |t: usize, _: u32| chosen.fitted(t);
    let judged = |t: usize, p: u32| {
        chosen.held_out[t] && !hold_out::fitted_half(frames[t].image.width, p as usize)
    };
    Photometric {
        psnr: finish::psnr(frames, renders, &fitted),
        psnr_held_out: finish::psnr(frames, renders, &judged),
    }
}

/// Refuses captures whose light is known.
///
/// # Errors
/// [`ReconstructError::KnownLamps`].
pub fn check_light(capture: &Capture) -> Result<(), ReconstructError> {
    match capture.lamps {
        None => Ok(()),
        Some(_) => Err(ReconstructError::KnownLamps {
            path: capture.path.clone(),
        }),
    }
}

/// What every step of a run shares.
struct Run<'a> {
    capture: &'a Capture,
    settings: &'a Settings,
    control: &'a Control<'a>,
    noise: Noise,
    fingerprint: u64,
    /// How finely the surface is divided, the same in all parts of a run.
    plan: Plan,
    began: Instant,
    /// Seconds spent before a continuation.
    before: f64,
    /// Seconds spent when the first step could begin; zero in a continuation past it.
    ready: f64,
    pace: Pace,
    /// The last stage that has had a step.
    reached: usize,
    curve: Vec<CurvePoint>,
    ended: Ended,
    failed: Option<CheckpointError>,
    /// Where the present round began; none on patches alone.
    round: Option<RoundStart>,
}

impl Run<'_> {
    fn seconds(&self) -> f64 {
        self.before + self.began.elapsed().as_secs_f64()
    }

    fn iteration(&self) -> u64 {
        self.curve.last().map_or(0, |point| point.iteration)
    }

    fn report(&self, stage: &'static str, loss: f64, samples_per_second: f64) {
        (self.control.progress)(&Progress {
            stage,
            iteration: self.iteration(),
            iterations: self.settings.iterations,
            loss,
            samples_per_second,
            seconds: self.seconds(),
        });
    }

    /// Steps of one stage; leaves in `ended` why the run ends here, or `Converged` when the next stage may begin.
    fn steps(
        &mut self,
        name: &'static str,
        place: Place,
        stage: &Stage,
        shared: &Shared,
        start: Start,
    ) -> Result<(Vec<f32>, f32), ReconstructError> {
        self.ended = Ended::Converged;
        if start.step > 0 {
            self.reached = place.stage;
        }
        if let Some(ended) = self.due(place, self.pace.step(stage)) {
            self.ended = ended;
            return Ok((start.z, start.damping));
        }
        // A continuation goes on inside the round: the step before it is the last of the curve.
        let mut previous = match self.curve.last() {
            Some(point) if start.step > 0 => point.loss,
            _ => f64::INFINITY,
        };
        let mut step_began = Instant::now();
        let solution = fast::solve(shared, stage, start, &mut |step| {
            let took = step_began.elapsed().as_secs_f64();
            step_began = Instant::now();
            self.pace.step_took(stage, took);
            self.reached = place.stage;
            // A step is one product a direction of descent, forth and back, and a fresh pass over the data.
            let rate = shared.samples as f64 * (2.0 * stage.products as f64 + 4.0) / took;
            self.curve.push(CurvePoint {
                iteration: self.iteration() + 1,
                seconds: self.seconds(),
                loss: step.cost,
                samples_per_second: rate,
            });
            self.report(name, step.cost, rate);
            if let (Some(show), Ok(radiance)) = (self.control.light, step.at.radiance()) {
                let grid = shared.grid;
                show(&finish::environment(grid, &radiance, grid.rows));
            }
            let mut state = self.state(place, step);
            state.arrays.extend([self.plan.array()]);
            if let Err(error) = (self.control.checkpoint)(&state) {
                self.failed = Some(error);
                return false;
            }
            if let Some(ended) = self.due(place, took) {
                self.ended = ended;
                return false;
            }
            let gained = previous - step.cost;
            previous = step.cost;
            !(gained > 0.0 && gained < CONVERGED * step.cost)
        })?;
        match self.failed.take() {
            Some(error) => Err(error.into()),
            None => Ok((solution.z, solution.damping)),
        }
    }

    /// Occluders at `z`, if modelled.
    fn masks(&self, shared: &Shared, z: &[f32]) -> Result<Option<Masks>, autodiff::RunError> {
        let share = shared.masks(z)?;
        Ok((!share.is_empty()).then(|| {
            Masks::new(
                shared.mask_grid(),
                self.settings.grid_rows,
                shared.shells.clone(),
                share,
            )
        }))
    }
}
