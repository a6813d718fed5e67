//! Reconstruction together with effects of the camera: exposure that drifts, a vignette, a response curve, …
//!
//! The camera is fitted together with light, texture and, where somebody may stand in the light, an occluder, on the data and
//! with the effects of [`criticism`](crate::criticism). Photographs are then taken back to what they would be without the
//! effects and reconstructed; renders are given the effects, so that they can be compared with the photographs.

use std::{collections::BTreeMap, time::Instant};

use serde_json::{Map, Value, json};

use crate::{
    capture::Capture,
    checkpoint::{self, Array, Checkpoint, CheckpointError},
    control::{Control, Progress},
    criticism::{
        Options, Simulation,
        effects::{self, Effect, camera_map::CameraMap},
        fit::{Fit, FitError},
        study::{Study, StudyError},
    },
    reconstruct::{self, ReconstructError},
    reconstruction::{Ended, Reconstruction},
    settings::{Preset, Settings},
};

/// The effect of somebody who stands in the light: always fitted beside the camera's where occluders are modelled at all, or
/// their shadow would be taken for an exposure that drifts.
pub const OCCLUDER: &str = "moving_occluder";
/// Share of the time limit for the simulation that the camera is fitted beside, and the most seconds it takes.
const SIMULATION: (f64, f64) = (0.2, 60.0);
/// Share of the time limit after which the fit of the camera ends as well, but for the steps that it has at least.
const CAMERA: (f64, usize) = (0.4, 2);
/// What the simulation takes in iterations at most.
const ITERATIONS: u64 = 12;
/// Steps of the fit before effects take part, and with them.
const STEPS: [usize; 2] = [6, 10];
/// An effect with more numbers than this is summed up in the remarks.
const FEW: usize = 4;

/// A whole reconstruction with the effects that `settings.with` names; without any, as [`reconstruct::run()`].
///
/// # Errors
/// [`JointError`].
pub fn run(
    capture: &Capture,
    settings: &Settings,
    control: &Control<'_>,
) -> Result<Reconstruction, JointError> {
    if settings.with.is_empty() {
        return Ok(reconstruct::run(capture, settings, control)?);
    }
    let began = Instant::now();
    let effects = of_the_camera(&settings.with)?;
    let cameras = match control.resume {
        Some(checkpoint) => effects
            .iter()
            .map(|effect| Camera::read(*effect, checkpoint))
            .collect::<Result<_, _>>()?,
        None => match fit(capture, settings, &effects, control, began)? {
            Fitted::Cameras(cameras) => cameras,
            Fitted::Interrupted(found) => return Ok(*found),
        },
    };
    let maps = cameras
        .iter()
        .map(|camera| camera.map(capture))
        .collect::<Result<Vec<CameraMap>, _>>()?;

    let mut ideal = capture.clone();
    for (frame, photograph) in ideal.frames.iter_mut().enumerate() {
        for map in maps.iter().rev() {
            (map.undo)(frame, &mut photograph.image);
        }
    }
    let inner = Settings {
        time_limit: settings
            .time_limit
            .map(|limit| (limit - began.elapsed().as_secs_f64()).max(1.0)),
        ..settings.clone()
    };
    // What is saved belongs to the photographs as they were taken, and brings the camera along.
    let fingerprint = checkpoint::fingerprint(capture);
    let save = |checkpoint: &Checkpoint| {
        let mut checkpoint = checkpoint.clone();
        checkpoint.capture = fingerprint;
        checkpoint.settings = settings.clone();
        checkpoint
            .arrays
            .extend(cameras.iter().flat_map(Camera::arrays));
        (control.checkpoint)(&checkpoint)
    };
    let control = Control {
        checkpoint: &save,
        ..*control
    };
    let mut found = reconstruct::run(&ideal, &inner, &control)?;
    for (frame, render) in found.renders.iter_mut().enumerate() {
        maps.iter().for_each(|map| (map.apply)(frame, render));
        // Off the object there is no render, whatever the camera adds.
        let mask = &capture.frames[frame].mask.data;
        for (pixel, &mask) in render.data.chunks_exact_mut(3).zip(mask) {
            if mask == 0.0 {
                pixel.fill(0.0);
            }
        }
    }
    found.metrics.photometric = reconstruct::photometric(capture, settings, &found.renders);
    let numbers: Map<String, Value> = cameras.iter().map(Camera::json).collect();
    found.metrics.extra.insert("camera".into(), numbers.into());
    found.notes.extend(cameras.iter().map(Camera::note));
    found.settings = settings.clone();
    Ok(found)
}

/// The effects of these names, in the order light meets them.
///
/// # Errors
/// [`JointError::Unknown`] for a name that no effect has, or one that cannot be taken out of photographs.
pub fn of_the_camera(names: &[String]) -> Result<Vec<&'static dyn Effect>, JointError> {
    let mut found = names
        .iter()
        .map(|name| {
            effects::by_id(name)
                .filter(|effect| effect.is_of_the_camera())
                .ok_or_else(|| JointError::Unknown {
                    name: name.clone(),
                    known: effects::all()
                        .iter()
                        .filter(|effect| effect.is_of_the_camera())
                        .map(|effect| effect.id())
                        .collect::<Vec<_>>()
                        .join(", "),
                })
        })
        .collect::<Result<Vec<_>, _>>()?;
    found.sort_by_key(|effect| effect.stage());
    found.dedup_by_key(|effect| effect.id());
    Ok(found)
}

/// An effect with its numbers.
struct Camera {
    effect: &'static dyn Effect,
    /// As [`Effect::camera_numbers`].
    numbers: Vec<f64>,
    /// Names of the first of them.
    names: Vec<String>,
}

impl Camera {
    fn map(&self, capture: &Capture) -> Result<CameraMap, JointError> {
        self.effect
            .camera_map(capture, &self.numbers)
            .ok_or_else(|| JointError::Numbers {
                id: self.effect.id(),
            })
    }

    fn key(effect: &dyn Effect) -> String {
        format!("camera {}", effect.id())
    }

    fn arrays(&self) -> [(String, Array); 2] {
        let names = self.names.join("\n");
        let bytes = names.bytes().map(u64::from).collect();
        let key = Self::key(self.effect);
        [
            (format!("{key} names"), Array::U64(bytes)),
            (key, Array::F64(self.numbers.clone())),
        ]
    }

    fn read(effect: &'static dyn Effect, checkpoint: &Checkpoint) -> Result<Self, CheckpointError> {
        let key = Self::key(effect);
        let length = match checkpoint.arrays.get(&key) {
            Some(Array::F64(values)) => values.len(),
            _ => 0,
        };
        Ok(Self {
            effect,
            numbers: checkpoint.f64s(&key, length)?.to_vec(),
            names: Self::names(checkpoint.arrays.get(&format!("{key} names"))),
        })
    }

    /// None where a checkpoint has none that can be read.
    fn names(array: Option<&Array>) -> Vec<String> {
        let Some(Array::U64(bytes)) = array else {
            return Vec::new();
        };
        let bytes = bytes.iter().map(|&b| u8::try_from(b).unwrap_or(b'?'));
        String::from_utf8_lossy(&bytes.collect::<Vec<u8>>())
            .lines()
            .map(str::to_owned)
            .collect()
    }

    fn json(&self) -> (String, Value) {
        let numbers = match self.names.is_empty() {
            true => json!(self.numbers),
            false => {
                let named = self.names.iter().cloned().zip(&self.numbers);
                json!(named.collect::<BTreeMap<_, _>>())
            }
        };
        (self.effect.id().to_owned(), numbers)
    }

    fn note(&self) -> String {
        let count = self.numbers.len();
        let detail = if count <= FEW {
            let numbers: Vec<String> = self.numbers.iter().map(|v| format!("{v:.4}")).collect();
            numbers.join(", ")
        } else {
            let square: f64 = self.numbers.iter().map(|v| v * v).sum();
            format!("{count} numbers, RMS {:.4}", (square / count as f64).sqrt())
        };
        format!(
            "fitted with {} ({}): {detail}",
            self.effect.id(),
            self.effect.describe()
        )
    }
}

enum Fitted {
    Cameras(Vec<Camera>),
    /// What there was when the caller asked for the end.
    Interrupted(Box<Reconstruction>),
}

/// Fits the effects beside light, texture and an occluder.
fn fit(
    capture: &Capture,
    settings: &Settings,
    effects: &[&'static dyn Effect],
    control: &Control<'_>,
    began: Instant,
) -> Result<Fitted, JointError> {
    let told = |stage: &'static str| {
        (control.progress)(&Progress {
            stage,
            iterations: settings.iterations,
            loss: f64::NAN,
            ..Progress::default()
        });
    };
    let simulated = Settings {
        preset: Preset::Fast,
        occluders: false,
        time_limit: settings
            .time_limit
            .map(|limit| (SIMULATION.0 * limit).min(SIMULATION.1)),
        iterations: settings.iterations.map(|n| n.min(ITERATIONS)),
        with: Vec::new(),
        from: None,
        ..settings.clone()
    };
    let unsaved = Control {
        checkpoint: &|_| Ok(()),
        resume: None,
        ..*control
    };
    let found = reconstruct::run(capture, &simulated, &unsaved)?;
    if found.ended == Ended::Interrupted {
        return Ok(interrupted(found, settings));
    }
    told("camera");
    let (share, least) = CAMERA;
    let goes_on = |step: usize| {
        let over = |limit: f64| began.elapsed().as_secs_f64() > share * limit;
        !control.stopped() && (step < least || !settings.time_limit.is_some_and(over))
    };
    let options = Options::default();
    let study = Study::new(
        capture,
        &Simulation::of(&found),
        options.sites,
        options.rows,
        settings.seed,
    )?;
    let mut fit = Fit::start(&study)?;
    fit.refine_while(&study, STEPS[0], &goes_on)?;
    let occluder = effects::by_id(OCCLUDER).filter(|_| settings.occluders);
    for effect in occluder.into_iter().chain(effects.iter().copied()) {
        fit.add(effect, Vec::new());
    }
    fit.refine_while(&study, STEPS[1], &goes_on)?;
    if control.stopped() {
        return Ok(interrupted(found, settings));
    }
    let of_effect = |effect: &&'static dyn Effect| -> Option<Camera> {
        let active = fit.active.iter().find(|a| a.effect.id() == effect.id())?;
        let link = fit.link(effect.id())?;
        Some(Camera {
            effect: *effect,
            numbers: effect.camera_numbers(&link.terms, &active.beta),
            names: link.terms.iter().map(|term| term.name.clone()).collect(),
        })
    };
    Ok(Fitted::Cameras(
        effects.iter().filter_map(of_effect).collect(),
    ))
}

/// What there is without the camera.
fn interrupted(mut found: Reconstruction, settings: &Settings) -> Fitted {
    found.ended = Ended::Interrupted;
    found.settings = settings.clone();
    found
        .notes
        .push("interrupted before the camera was fitted".to_owned());
    Fitted::Interrupted(Box::new(found))
}

/// Why a joint reconstruction could not be made.
#[derive(Debug, thiserror::Error)]
pub enum JointError {
    /// Not the name of an effect that can be fitted so.
    #[error(
        "--with {name:?}: not an effect that a reconstruction can be fitted with; expected some of {known}"
    )]
    Unknown {
        /// The name.
        name: String,
        /// All that there are.
        known: String,
    },
    /// Numbers that no camera has.
    #[error(
        "what was fitted for {id} cannot be taken out of the photographs: leave it out of --with, or look at what diagnose says"
    )]
    Numbers {
        /// The effect.
        id: &'static str,
    },
    /// The reconstruction itself failed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The capture does not show enough.
    #[error(transparent)]
    Study(#[from] StudyError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The checkpoint is of another run.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

impl JointError {
    /// Whether the caller asked for the end before there was anything to keep.
    pub fn is_an_interrupt(&self) -> bool {
        matches!(self, Self::Reconstruct(ReconstructError::Interrupted))
    }

    /// Whether the capture, or the result to start from, is to blame and not the run.
    pub fn is_of_the_input(&self) -> bool {
        match self {
            Self::Reconstruct(error) => error.is_of_the_input(),
            Self::Study(_) => true,
            Self::Unknown { .. } | Self::Numbers { .. } | Self::Fit(_) | Self::Checkpoint(_) => {
                false
            }
        }
    }
}
