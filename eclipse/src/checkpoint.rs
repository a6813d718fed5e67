//! The solver's state on disk: what `--resume` continues from, bit for bit.
//!
//! Layout, little-endian: magic `ECLIPSE\0`, version u32, length of the payload u64, CRC-64 of the payload u64, payload.
//! The payload holds the capture's fingerprint, iteration, seconds, the settings as JSON, then named arrays.

mod codec;
mod store;

use std::{collections::BTreeMap, path::PathBuf};

use crate::{files::remedy, reconstruction::CurvePoint, settings::Settings, wording::amount};

pub use codec::{decode, encode};
pub use store::{fingerprint, is_in, is_of, load, passed_over, save};

/// Everything a solver needs to go on as if it had never stopped.
///
/// Random numbers are counters keyed by the seed, so a counter is all their state: keep it under a name in `arrays`.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Options of the run that wrote it.
    pub settings: Settings,
    /// [`fingerprint`] of the capture it belongs to.
    pub capture: u64,
    /// Iterations done.
    pub iteration: u64,
    /// Seconds of solving so far.
    pub seconds: f64,
    /// Parameters, optimiser moments, counters, by name.
    pub arrays: BTreeMap<String, Array>,
}

/// A named array of a [`Checkpoint`].
#[derive(Clone, Debug, PartialEq)]
pub enum Array {
    /// Single precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
    /// Counters and indices.
    U64(Vec<u64>),
}

impl Array {
    /// The loss curve as numbers, four a point.
    pub fn curve(points: &[CurvePoint]) -> Self {
        let numbers =
            |p: &CurvePoint| [p.iteration as f64, p.seconds, p.loss, p.samples_per_second];
        Self::F64(points.iter().flat_map(numbers).collect())
    }
}

impl Checkpoint {
    /// The single-precision array `name`, which must have `length` values.
    ///
    /// # Errors
    /// [`CheckpointError::Array`] when it is absent, of another type or of another length.
    pub fn f32s(&self, name: &str, length: usize) -> Result<&[f32], CheckpointError> {
        match self.arrays.get(name) {
            Some(Array::F32(values)) if values.len() == length => Ok(values),
            found => Err(mismatch(name, "f32", length, found)),
        }
    }

    /// The double-precision array `name`, which must have `length` values.
    ///
    /// # Errors
    /// As [`Checkpoint::f32s`].
    pub fn f64s(&self, name: &str, length: usize) -> Result<&[f64], CheckpointError> {
        match self.arrays.get(name) {
            Some(Array::F64(values)) if values.len() == length => Ok(values),
            found => Err(mismatch(name, "f64", length, found)),
        }
    }

    /// The loss curve, which must have `points` points (see [`Array::curve`]).
    ///
    /// # Errors
    /// As [`Checkpoint::f32s`].
    pub fn curve(&self, points: usize) -> Result<Vec<CurvePoint>, CheckpointError> {
        let values = self.f64s("curve", points.saturating_mul(4))?;
        let point = |p: &[f64]| CurvePoint {
            iteration: p[0] as u64,
            seconds: p[1],
            loss: p[2],
            samples_per_second: p[3],
        };
        Ok(values.chunks_exact(4).map(point).collect())
    }

    /// The integers `name`, which must be `length` many.
    ///
    /// # Errors
    /// As [`Checkpoint::f32s`].
    pub fn u64s(&self, name: &str, length: usize) -> Result<&[u64], CheckpointError> {
        match self.arrays.get(name) {
            Some(Array::U64(values)) if values.len() == length => Ok(values),
            found => Err(mismatch(name, "u64", length, found)),
        }
    }

    /// Checks that continuing makes sense: the same capture, and settings that differ in nothing that shapes the result.
    ///
    /// Time limit, iteration count and threads may change. So may memory: how the work is divided is kept from the beginning, and
    /// whether that still fits is looked at where it is known ([`CheckpointError::Memory`]). Files may be read by other words as long
    /// as the capture that they give is the same.
    ///
    /// # Errors
    /// [`CheckpointError::OtherCapture`] or [`CheckpointError::OtherSettings`], naming what differs.
    pub fn check(&self, settings: &Settings, capture: u64) -> Result<(), CheckpointError> {
        if self.capture != capture {
            return Err(CheckpointError::OtherCapture);
        }
        let comparable = |settings: &Settings| {
            let mut value = serde_json::to_value(settings).unwrap_or_default();
            for free in ["time_limit", "iterations", "threads", "memory", "reading"] {
                value[free] = serde_json::Value::Null;
            }
            value
        };
        let (then, now) = (comparable(&self.settings), comparable(settings));
        let differing = now
            .as_object()
            .into_iter()
            .flatten()
            .find(|(key, now)| then[key.as_str()] != **now);
        match differing {
            None => Ok(()),
            Some((key, now)) => Err(CheckpointError::OtherSettings {
                field: key.clone(),
                then: then[key.as_str()].to_string(),
                now: now.to_string(),
            }),
        }
    }
}

fn mismatch(name: &str, kind: &str, length: usize, found: Option<&Array>) -> CheckpointError {
    let found = match found {
        None => "nothing".to_owned(),
        Some(Array::F32(values)) => format!("{} f32", values.len()),
        Some(Array::F64(values)) => format!("{} f64", values.len()),
        Some(Array::U64(values)) => format!("{} u64", values.len()),
    };
    CheckpointError::Array {
        name: name.to_owned(),
        expected: format!("{length} {kind}"),
        found,
    }
}

/// What to do where one could not be written: the last one is whole.
fn hint(action: &str, error: &std::io::Error) -> String {
    match action {
        "write" => format!("; {}", remedy(error)),
        _ => String::new(),
    }
}

/// Why a checkpoint could not be written, read or used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system refused.
    #[error("cannot {action} the checkpoint {}: {source}{}", path.display(), hint(action, source))]
    Io {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Nothing to continue from.
    #[error("no checkpoint in {}: start without --resume, or name the --out of an earlier run", path.display())]
    Missing {
        /// The folder searched.
        path: PathBuf,
    },
    /// The bytes are not a checkpoint, or not a whole one.
    #[error("the checkpoint is damaged at byte {offset}: {reason}")]
    Damaged {
        /// Where reading stopped.
        offset: usize,
        /// What is wrong there.
        reason: String,
    },
    /// The checkpoint cannot be read, and there is none before it.
    #[error("{}: {latest}; start again without --resume", path.display())]
    Unreadable {
        /// The folder.
        path: PathBuf,
        /// What is wrong.
        latest: Box<CheckpointError>,
    },
    /// Neither the checkpoint nor the one before it can be read.
    #[error("{}: {latest}; and the one before it: {previous}; start again without --resume", path.display())]
    BothUnreadable {
        /// The folder.
        path: PathBuf,
        /// What is wrong with the latest.
        latest: Box<CheckpointError>,
        /// What is wrong with its predecessor.
        previous: Box<CheckpointError>,
    },
    /// A newer or older format.
    #[error(
        "the checkpoint has format version {found}, this program reads {expected}: continue with the program that wrote it"
    )]
    Version {
        /// The version in the file.
        found: u32,
        /// The version this program writes.
        expected: u32,
    },
    /// An array the solver needs is missing or has another shape.
    #[error(
        "the checkpoint's array `{name}` should hold {expected}, found {found}: start again without --resume"
    )]
    Array {
        /// Its name.
        name: String,
        /// What the solver asked for.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The run takes more memory than it now may.
    #[error(
        "the run takes about {needed} MiB of memory, as it was begun, and --memory allows {allowed}: give at least \
         --memory {needed}MiB, or start again without --resume, for a coarser run", needed = mebibytes(*needed),
        allowed = amount(*allowed)
    )]
    Memory {
        /// What it takes, in bytes.
        needed: u64,
        /// What it may take, in bytes.
        allowed: u64,
    },
    /// The checkpoint belongs to other photographs.
    #[error(
        "the checkpoint was written for another capture: start without --resume or choose another --out"
    )]
    OtherCapture,
    /// The options changed in a way that would change the result.
    #[error(
        "the checkpoint was written with `{field}` = {then}, now it is {now}: repeat the earlier options or start without --resume"
    )]
    OtherSettings {
        /// The option.
        field: String,
        /// Its earlier value.
        then: String,
        /// Its present value.
        now: String,
    },
}

/// Bytes in the unit of messages, rounded up: as much suffices.
fn mebibytes(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}
