//! A whole reconstruction: noise, stages coarse to fine, materials and images, scores and remarks.

use std::{collections::BTreeMap, time::Instant};

use render::{bvh::Bvh, mesh::MeshError};

use super::{
    fast::{self, Problem, Stage, Start},
    finish::{self, Found},
    hold_out,
    model::Shared,
    noise,
    paper::{self, PaperError},
    shading::Masks,
};
use crate::{
    capture::Capture,
    checkpoint::{Array, Checkpoint, CheckpointError, fingerprint},
    control::{Control, Progress},
    reconstruction::{CurvePoint, Ended, Metrics, Noise, Photometric, Reconstruction},
    settings::{Preset, Settings},
};

/// Coarse light on few patches finds its way in seconds; the fine stage then has the rest of the time.
const STAGES: [(&str, Stage); 2] = [
    (
        "coarse light and occluders",
        Stage {
            rows: 25,
            patches: 800,
            members: 8,
            steps: 12,
            products: 25,
        },
    ),
    (
        "fine light and occluders",
        Stage {
            rows: 50,
            patches: 2000,
            members: 4,
            steps: 30,
            products: 25,
        },
    ),
];
/// Share of the time limit after which the coarse stage ends.
const COARSE_SHARE: f64 = 0.3;
/// Share of the time limit kept for materials and images.
const FINISH_SHARE: f64 = 0.15;
/// A step that lowers the cost by less than this share of it is as good as none.
const CONVERGED: f64 = 3e-5;

/// Recovers light, materials and occluders from a capture.
///
/// The result is the same for any number of threads, and the same after a continuation; only a time limit makes it depend
/// on the machine's speed.
///
/// # Errors
/// [`ReconstructError`].
pub fn run(
    capture: &Capture,
    settings: &Settings,
    control: &Control<'_>,
) -> Result<Reconstruction, ReconstructError> {
    let began = Instant::now();
    let noise = noise::estimate(&capture.frames);
    let bvh = Bvh::new(&capture.mesh)?;
    let frames = Frames::new(capture, settings);
    if settings.preset == Preset::Paper {
        let used = |frame: usize, _: u32| frames.fitted(frame);
        let mut found = paper::run(capture, &bvh, settings, noise, &used, control)?;
        found.notes = frames.notes(&capture.frames, &found.occluders);
        return Ok(found);
    }
    let mut run = Run {
        capture,
        settings,
        control,
        noise,
        fingerprint: fingerprint(capture),
        began,
        before: 0.0,
        curve: Vec::new(),
        ended: Ended::Converged,
        failed: None,
    };
    let (mut first, mut start) = match control.resume {
        Some(checkpoint) => run.resume(checkpoint)?,
        None => (0, None),
    };
    let used = |frame: usize, _: u32| frames.fitted(frame);
    let mut last: Option<(Shared, Vec<f32>)> = None;
    while first < STAGES.len() {
        let (name, mut stage) = STAGES[first];
        stage.rows = stage.rows.min(settings.grid_rows);
        run.report("visibility of the surface", f64::NAN, 0.0);
        let problem = Problem {
            bvh: &bvh,
            frames: &capture.frames,
            noise: &run.noise,
            occluders: settings.occluders.then_some(settings.occluder_prior),
            harmonic_degree: settings.harmonic_degree,
            seed: settings.seed,
            threads: settings.threads,
        };
        let (observations, shared) = fast::prepare(&problem, &stage, &used)?;
        if observations.views.is_empty() {
            return Err(ReconstructError::NothingToFit);
        }
        let from = match (start.take(), &last) {
            (Some(start), _) => start,
            (None, Some((coarse, z))) => Start::from(fast::refine(coarse, z, &shared)),
            (None, None) => Start::from(vec![0.0; shared.parameters()]),
        };
        if from.z.len() != shared.parameters() {
            return Err(ReconstructError::Checkpoint(CheckpointError::Array {
                name: "z".into(),
                expected: format!("{} f32", shared.parameters()),
                found: format!("{} f32", from.z.len()),
            }));
        }
        let z = run.steps(name, first, &stage, &shared, from)?;
        last = Some((shared, z));
        if run.ended != Ended::Converged {
            break;
        }
        first += 1;
    }
    let (shared, z) = last.ok_or(ReconstructError::NothingToFit)?;
    run.finish(&bvh, &frames, &shared, &z)
}

/// Why a reconstruction could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReconstructError {
    /// The mesh cannot be traced.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// No pixel is fit to be used.
    #[error(
        "no pixel of any photograph can be fitted; expected pixels wholly inside the masks, lit, on surface that faces the \
         camera: check the masks and the exposure, or lower --hold-out's share"
    )]
    NothingToFit,
    /// The tape did not compile.
    #[error("the solver failed: {0}; please report this with the capture")]
    Graph(#[from] autodiff::GraphError),
    /// The tape refused its input.
    #[error("the solver failed: {0}; please report this with the capture")]
    Tape(#[from] autodiff::RunError),
    /// The paper's algorithm failed.
    #[error(transparent)]
    Paper(#[from] PaperError),
    /// The state could not be saved or used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

/// What every step of a run shares.
struct Run<'a> {
    capture: &'a Capture,
    settings: &'a Settings,
    control: &'a Control<'a>,
    noise: Noise,
    fingerprint: u64,
    began: Instant,
    /// Seconds spent before a continuation.
    before: f64,
    curve: Vec<CurvePoint>,
    ended: Ended,
    failed: Option<CheckpointError>,
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
        number: usize,
        stage: &Stage,
        shared: &Shared,
        start: Start,
    ) -> Result<Vec<f32>, ReconstructError> {
        let final_stage = number + 1 == STAGES.len();
        self.ended = Ended::Converged;
        if let Some(ended) = self.due(final_stage, 0.0) {
            self.ended = ended;
            return Ok(start.z);
        }
        let mut previous = f64::INFINITY;
        let mut step_began = Instant::now();
        let solution = fast::solve(shared, stage, start, &mut |step| {
            let took = step_began.elapsed().as_secs_f64();
            step_began = Instant::now();
            // A step is one product a direction of descent, forth and back, and a fresh pass over the data.
            let rate = shared.samples as f64 * (2.0 * stage.products as f64 + 4.0) / took;
            self.curve.push(CurvePoint {
                iteration: self.iteration() + 1,
                seconds: self.seconds(),
                loss: step.cost,
                samples_per_second: rate,
            });
            self.report(name, step.cost, rate);
            if let Err(error) = (self.control.checkpoint)(&self.state(number, step)) {
                self.failed = Some(error);
                return false;
            }
            if let Some(ended) = self.due(final_stage, took) {
                self.ended = ended;
                return false;
            }
            let gained = previous - step.cost;
            previous = step.cost;
            !(gained > 0.0 && gained < CONVERGED * step.cost)
        })?;
        // The coarse stage's own share of the time is over, not the run's.
        if !final_stage && self.ended == Ended::TimeLimit && !self.out_of_time(true, 0.0) {
            self.ended = Ended::Converged;
        }
        match self.failed.take() {
            Some(error) => Err(error.into()),
            None => Ok(solution.z),
        }
    }

    /// Why no further step may be taken, when the last took `step` seconds.
    fn due(&self, final_stage: bool, step: f64) -> Option<Ended> {
        if self.control.stopped() {
            return Some(Ended::Interrupted);
        }
        if self
            .settings
            .iterations
            .is_some_and(|n| self.iteration() >= n)
        {
            return Some(Ended::Iterations);
        }
        self.out_of_time(final_stage, step)
            .then_some(Ended::TimeLimit)
    }

    fn out_of_time(&self, final_stage: bool, step: f64) -> bool {
        let share = if final_stage {
            1.0 - FINISH_SHARE
        } else {
            COARSE_SHARE
        };
        self.settings
            .time_limit
            .is_some_and(|limit| self.seconds() + step > share * limit)
    }

    fn state(&self, stage: usize, step: &fast::Step<'_>) -> Checkpoint {
        let curve = self.curve.iter();
        let curve =
            curve.flat_map(|p| [p.iteration as f64, p.seconds, p.loss, p.samples_per_second]);
        Checkpoint {
            settings: self.settings.clone(),
            capture: self.fingerprint,
            iteration: self.iteration(),
            seconds: self.seconds(),
            arrays: BTreeMap::from([
                ("z".to_owned(), Array::F32(step.z.to_vec())),
                ("damping".to_owned(), Array::F32(vec![step.damping])),
                (
                    "stage".to_owned(),
                    Array::U64(vec![stage as u64, step.step as u64 + 1]),
                ),
                ("curve".to_owned(), Array::F64(curve.collect())),
            ]),
        }
    }

    /// The stage to go on with and where in it.
    fn resume(
        &mut self,
        checkpoint: &Checkpoint,
    ) -> Result<(usize, Option<Start>), CheckpointError> {
        let length = |name: &str| match checkpoint.arrays.get(name) {
            Some(Array::F32(values)) => values.len(),
            Some(Array::F64(values)) => values.len() / 4 * 4,
            _ => 0,
        };
        let z = checkpoint.f32s("z", length("z"))?.to_vec();
        let damping = checkpoint.f32s("damping", 1)?[0];
        let place = checkpoint.u64s("stage", 2)?;
        let curve = checkpoint.f64s("curve", length("curve"))?;
        self.curve = curve
            .chunks_exact(4)
            .map(|p| CurvePoint {
                iteration: p[0] as u64,
                seconds: p[1],
                loss: p[2],
                samples_per_second: p[3],
            })
            .collect();
        self.before = checkpoint.seconds;
        let stage = (place[0] as usize).min(STAGES.len() - 1);
        let step = place[1] as usize;
        Ok((stage, Some(Start { z, damping, step })))
    }

    /// Materials, images, scores and remarks.
    fn finish(
        &self,
        bvh: &Bvh,
        chosen: &Frames,
        shared: &Shared,
        z: &[f32],
    ) -> Result<Reconstruction, ReconstructError> {
        self.report("materials and renders", f64::NAN, 0.0);
        let radiance = shared.linearise(z)?.0.radiance()?;
        let frames = &self.capture.frames;
        let masks_at = |z: &[f32]| -> Result<Option<Masks>, autodiff::RunError> {
            let share = shared.masks(z)?;
            Ok((!share.is_empty()).then_some(Masks {
                grid: shared.grid,
                shell: shared.shell,
                frames: frames.len(),
                share,
            }))
        };
        let found = Found {
            bvh,
            frames,
            noise: &self.noise,
            grid: shared.grid,
            radiance: &radiance,
            occluders: None,
            lobe: None,
            seed: self.settings.seed,
        };
        let fitted = |t: usize, _: u32| chosen.fitted(t);
        let mut occluders = masks_at(z)?;
        let mut finished = finish::finish(&found.under(occluders.as_ref()), &fitted);
        if self.settings.hold_out.is_some() {
            self.report("occluders of held-out frames", f64::NAN, 0.0);
            let held = |t: usize| chosen.held_out[t];
            let z = hold_out::fit(&found, shared, z, &finished.materials, &held)?;
            let moved = masks_at(&z)?;
            finished = finish::finish(&found.under(moved.as_ref()), &fitted);
            occluders = moved;
        }
        let judged = |t: usize, p: u32| {
            chosen.held_out[t] && !hold_out::fitted_half(frames[t].image.width, p as usize)
        };
        let rows = self.settings.grid_rows;
        let masks = occluders.map_or(Vec::new(), |masks| masks.images(rows));
        let photometric = Photometric {
            psnr: finish::psnr(frames, &finished.renders, &fitted),
            psnr_held_out: finish::psnr(frames, &finished.renders, &judged),
        };
        let extra = BTreeMap::from([
            ("iterations".to_owned(), self.iteration().into()),
            ("seconds".to_owned(), self.seconds().into()),
        ]);
        let mut notes = chosen.notes(frames, &masks);
        if !self.settings.lambertian {
            notes.push(
                "the fast preset fits diffuse materials only: alpha and kappa are not recovered, as with --lambertian"
                    .to_owned(),
            );
        }
        Ok(Reconstruction {
            environment: finish::environment(shared.grid, &radiance, rows),
            notes,
            occluders: masks,
            materials: finished.materials,
            vertex_materials: finished.vertex_materials,
            network: None,
            renders: finished.renders,
            curve: self.curve.clone(),
            metrics: Metrics { photometric, extra },
            noise: Some(self.noise),
            settings: self.settings.clone(),
            ended: self.ended,
        })
    }
}

/// Which frames light and materials are fitted to.
struct Frames {
    black: Vec<bool>,
    held_out: Vec<bool>,
}

impl Frames {
    fn new(capture: &Capture, settings: &Settings) -> Self {
        let black = |frame: &crate::capture::Frame| frame.image.data.iter().all(|&v| v <= 0.0);
        let every = |t: usize| settings.hold_out.is_some_and(|k| t % k == k - 1);
        Self {
            black: capture.frames.iter().map(black).collect(),
            held_out: (0..capture.frames.len()).map(every).collect(),
        }
    }

    fn fitted(&self, frame: usize) -> bool {
        !self.black[frame] && !self.held_out[frame]
    }

    fn notes(
        &self,
        frames: &[crate::capture::Frame],
        masks: &[render::image::Image],
    ) -> Vec<String> {
        let black = self.black.iter().zip(frames).filter(|(black, _)| **black);
        let mut notes: Vec<String> = black
            .map(|(_, frame)| format!("frame {}: all black, left out of the fit", frame.name))
            .collect();
        for (mask, frame) in masks.iter().zip(frames) {
            if mask.data.iter().all(|&share| share > 0.5) {
                notes.push(format!(
                    "frame {}: its mask ended empty, nothing blocks half of the light anywhere",
                    frame.name
                ));
            }
        }
        notes
    }
}
