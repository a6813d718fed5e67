//! What a refit gains that is told which effects are true: the yardstick of a diagnosis.

use super::{
    diagnose::{DiagnoseError, Outcome},
    effects,
    fit::Fit,
    frame_numbers::FrameNumbers,
    refit,
    sealed::{self, Judge, Noise},
};

/// Gains on sealed data over the first model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Yardstick {
    /// Of the diagnosis's last model.
    pub diagnosed: f64,
    /// Of the model with the true effects.
    pub told: f64,
    /// Standard error of the latter.
    pub error: f64,
}

/// Refits with the effects in `truth`, one after another as a diagnosis does that finds them; `None` where none of them is known or
/// there are none.
///
/// # Errors
/// A bug of the tape.
pub fn yardstick(
    outcome: &Outcome<'_>,
    truth: &[String],
) -> Result<Option<Yardstick>, DiagnoseError> {
    let known: Vec<_> = truth.iter().filter_map(|id| effects::by_id(id)).collect();
    if known.is_empty() {
        return Ok(None);
    }
    let study = &outcome.study;
    let mut told = outcome.before.duplicate(study)?;
    // Where the diagnosis found the same, its model is the told one.
    let same = outcome.after.active.len() == known.len()
        && known
            .iter()
            .all(|e| outcome.after.active.iter().any(|a| a.effect.id() == e.id()));
    if same {
        told = outcome.after.duplicate(study)?;
    } else {
        for effect in known {
            told = refit::told(study, &told, effect)?;
        }
    }
    // A sealed frame's own numbers are nobody's prediction: where either model has such, patches alone are looked at.
    let frames = outcome.after.is_shared() && told.is_shared();
    let none = FrameNumbers::none();
    let gain = |fit: &Fit| {
        let judge = Judge::new(study, &outcome.before, fit, Noise::Estimated);
        let [before, after] = [&outcome.before, fit].map(|fit| judge.errors(study, fit, &none));
        sealed::gain(study, &before, &after, frames)
    };
    let (diagnosed, told) = (gain(&outcome.after), gain(&told));
    Ok(Some(Yardstick {
        diagnosed: diagnosed.gain,
        told: told.gain,
        error: told.error,
    }))
}
