//! The albedo's errors over several scenes: in one, errors are alike from pixel to pixel, and chance decides which are large.

use super::{
    Draw, albedo_spread, draw,
    spread::{CORRELATED, Spread, Values},
};
use crate::studies::{StudyError, bench::Bench, small::Setup, trial::Trial};

/// The same object under other lamps.
pub(super) struct Truths {
    /// How many scenes.
    pub scenes: usize,
    /// Rank correlation of the albedo's errors and deviations over all of them.
    pub place: f64,
}

impl Truths {
    /// As many scenes as draws, the first of which is of the first scene, whose albedo has this `spread`; nothing where its errors are where
    /// deviations are large in that scene alone.
    pub(super) fn new(
        bench: &Bench<'_>,
        trial: &Trial,
        draws: &[Draw],
        spread: &Spread,
    ) -> Result<Option<Self>, StudyError> {
        if spread.place() > CORRELATED {
            return Ok(None);
        }
        let tried = bench.each(1..draws.len() as u64, |scene| {
            let setup = Setup {
                scene,
                ..Setup::of(bench.scale)
            };
            let (_, draw) = draw(bench, setup, &format!("lamps {scene}"))?;
            Ok(draw.albedo)
        });
        let others = match tried {
            // What was found until then stands.
            Err(StudyError::Stopped) => {
                bench.note_cut();
                return Ok(None);
            }
            tried => tried?,
        };
        let all: Vec<&Values> = draws[..1]
            .iter()
            .map(|d| &d.albedo)
            .chain(&others)
            .collect();
        Ok((all.len() > 1).then(|| Self {
            scenes: all.len(),
            place: albedo_spread(trial, &all).place(),
        }))
    }
}
