//! How a running solve talks to whoever started it: stop flag, progress, checkpoints.

use std::sync::atomic::{AtomicBool, Ordering};

use render::image::Image;

use crate::checkpoint::{Checkpoint, CheckpointError};

/// The caller's side of a running solve.
pub struct Control<'a> {
    /// Set by the caller (Ctrl-C) to end the solve at the next iteration with everything saved.
    pub stop: &'a AtomicBool,
    /// Told after every iteration; cheap to call.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
    /// Shown the environment as it stands after iterations, where somebody looks: linear radiance on a grid of the solver's.
    pub light: Option<&'a (dyn Fn(&Image) + Sync)>,
    /// Saves the solver's state; the solver decides when, the caller where.
    pub checkpoint: &'a (dyn Fn(&Checkpoint) -> Result<(), CheckpointError> + Sync),
    /// The state to continue from, already checked against the capture and the settings.
    pub resume: Option<&'a Checkpoint>,
}

impl Control<'static> {
    /// A caller that listens to nothing and saves nothing.
    pub fn detached() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self {
            stop: &NEVER,
            progress: &|_| (),
            light: None,
            checkpoint: &|_| Ok(()),
            resume: None,
        }
    }
}

impl Control<'_> {
    /// Whether the caller asked for the end.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Where a running solve stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// What is being done, such as `visibility` or `environment and masks`.
    pub stage: &'static str,
    /// Iterations done.
    pub iteration: u64,
    /// Iterations planned, if known.
    pub iterations: Option<u64>,
    /// The loss after this iteration, NaN before the first.
    pub loss: f64,
    /// Shaded samples per second since the last report.
    pub samples_per_second: f64,
    /// Seconds of solving, those before a resume included.
    pub seconds: f64,
}
