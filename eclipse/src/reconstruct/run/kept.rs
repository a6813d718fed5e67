//! The division of the work that a run began with: kept in its checkpoint, since what it finds depends on it.

use super::{super::paper, LEGS, Plan};
use crate::{
    capture::Capture,
    checkpoint::{Array, Checkpoint, CheckpointError},
    settings::{Preset, Settings},
};

/// Its name in a checkpoint.
const NAME: &str = "plan";
/// No number of a plan of the paper preset is larger: what is read from a file must not overflow sums.
const MOST: u64 = 1 << 20;

/// The bytes of memory that [`run`](super::run()) plans to take at its peak.
pub fn memory(capture: &Capture, settings: &Settings) -> u64 {
    match settings.preset {
        Preset::Fast => Plan::finest(capture, settings).bytes(capture, settings),
        Preset::Paper => paper::memory(capture, settings),
    }
}

/// The bytes of memory that going on from `checkpoint` takes at its peak: those of the plan that the run began with, whatever
/// may be used now.
///
/// # Errors
/// [`CheckpointError::Memory`] where that is more than `settings` allow, [`CheckpointError::Array`] for a plan that none of ours can be.
pub fn memory_to_resume(
    capture: &Capture,
    settings: &Settings,
    checkpoint: &Checkpoint,
) -> Result<u64, CheckpointError> {
    let needed = match settings.preset {
        Preset::Fast => Plan::kept(capture, checkpoint)?.bytes(capture, settings),
        Preset::Paper => {
            let plan = paper::state::plan(checkpoint)?;
            let numbers = [plan.pixels, plan.rays, plan.cells, plan.side];
            if numbers.iter().any(|&number| number > MOST) {
                return Err(CheckpointError::Array {
                    name: "counters".to_owned(),
                    expected: format!("sizes of at most {MOST}"),
                    found: format!("{numbers:?}"),
                });
            }
            plan.memory(settings, capture).total()
        }
    };
    if needed > settings.memory {
        return Err(CheckpointError::Memory {
            needed,
            allowed: settings.memory,
        });
    }
    Ok(needed)
}

impl Plan {
    /// The plan of the run that goes on from `checkpoint`, or of a new one.
    pub(super) fn of(
        capture: &Capture,
        settings: &Settings,
        checkpoint: Option<&Checkpoint>,
    ) -> Result<Self, CheckpointError> {
        match checkpoint {
            Some(checkpoint) => Self::kept(capture, checkpoint),
            None => Ok(Self::finest(capture, settings)),
        }
    }

    /// As a checkpoint keeps it.
    pub(super) fn array(self) -> (String, Array) {
        let numbers = [self.sites, self.patches].map(|number| number as u64);
        (NAME.to_owned(), Array::U64(numbers.to_vec()))
    }

    fn finest(capture: &Capture, settings: &Settings) -> Self {
        Self::new(capture, settings, &LEGS[LEGS.len() - 1].stage)
    }

    fn kept(capture: &Capture, checkpoint: &Checkpoint) -> Result<Self, CheckpointError> {
        // Earlier versions did not keep it: it follows from the memory that they had.
        if !checkpoint.arrays.contains_key(NAME) {
            return Ok(Self::finest(capture, &checkpoint.settings));
        }
        let numbers = checkpoint.u64s(NAME, 2)?;
        // A number beyond the machine's is beyond its memory too, which is refused.
        let number = |index: usize| usize::try_from(numbers[index]).unwrap_or(usize::MAX);
        Ok(Self {
            sites: number(0),
            patches: number(1),
        })
    }
}

/// Refuses unknowns of another length than the run's.
pub(super) fn check_length(z: Option<&Vec<f32>>, expected: usize) -> Result<(), CheckpointError> {
    match z {
        Some(z) if z.len() != expected => Err(CheckpointError::Array {
            name: "z".into(),
            expected: format!("{expected} f32"),
            found: format!("{} f32", z.len()),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use glam::Vec3;
    use render::mesh::Mesh;

    use super::*;

    #[test]
    fn a_plan_of_the_paper_preset_is_held_to_the_memory_and_to_sizes_that_can_be() {
        let capture = Capture {
            path: "nowhere".into(),
            frames: Vec::new(),
            mesh: Mesh::default(),
            centre: Vec3::ZERO,
            lamps: None,
        };
        let with = |memory: u64| Settings {
            memory,
            ..Settings::of(Preset::Paper)
        };
        let begun = |counters: [u64; 5]| Checkpoint {
            settings: with(4 << 30),
            capture: 0,
            iteration: 1,
            seconds: 1.0,
            arrays: BTreeMap::from([("counters".to_owned(), Array::U64(counters.to_vec()))]),
        };
        let usual = begun([2048, 32, 1000, 1, 0]);
        let needed = memory_to_resume(&capture, &with(4 << 30), &usual).unwrap();
        assert_eq!(
            memory_to_resume(&capture, &with(needed), &usual).ok(),
            Some(needed)
        );
        let error = memory_to_resume(&capture, &with(needed - 1), &usual).unwrap_err();
        assert!(matches!(error, CheckpointError::Memory { .. }), "{error}");
        let enough = format!("--memory {}MiB", needed.div_ceil(1 << 20));
        assert!(error.to_string().contains(&enough), "{error}");

        let hostile = begun([u64::MAX, 32, 1000, 1, 0]);
        let error = memory_to_resume(&capture, &with(u64::MAX), &hostile).unwrap_err();
        assert!(matches!(error, CheckpointError::Array { .. }), "{error}");
    }
}
