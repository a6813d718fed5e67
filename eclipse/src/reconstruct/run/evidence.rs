//! Whether a capture shows any occluder at all.

use super::super::{
    fast::{self, Stage, Start},
    model::Shared,
    patches::Observations,
    shell::Shells,
};
use super::{ReconstructError, Run};
use crate::reconstruction::Ended;

/// The prior ties most parameters of an occluder to each other: they count for no more than this share of the values.
const OF_VALUES: f64 = 0.1;

/// Whether it is asked for after so many rounds of a stage: once, after the first of all, also where the stage had no time for the
/// whole of it. A run that stops there will ask when it goes on.
pub(super) fn is_asked([stage, rounds]: [usize; 2], ended: Ended) -> bool {
    (stage, rounds) == (0, 1) && matches!(ended, Ended::Converged | Ended::TimeLimit)
}

impl Run<'_> {
    /// The model without occluders, if those of the round just ended explain no more than as many parameters would of anything, and
    /// where it has come to in such a round.
    ///
    /// By Akaike's criterion with overdispersion (Burnham & Anderson, Model Selection, 2002, 2.5): a parameter has to lower the
    /// cost by χ² per residual of what is explained without. Without a moving shadow light and albedo cannot be told apart;
    /// an occluder that is fitted all the same then hides light that was never there.
    pub(super) fn unoccluded(
        &self,
        shared: &Shared,
        stage: &Stage,
        observations: &Observations,
    ) -> Result<Option<(Shared, Start)>, ReconstructError> {
        let occluders = shared.ranges()[1].len();
        let Some(last) = self.curve.last().filter(|_| occluders > 0) else {
            return Ok(None);
        };
        self.report("signs of an occluder", last.loss, 0.0);
        let clear = self.clear(shared, observations)?;
        let mut cost = f64::INFINITY;
        let start = Start::from(vec![0.0; clear.parameters()]);
        // As many steps as the other had.
        let stage = &Stage {
            steps: stage.steps.min(self.iteration() as usize),
            ..*stage
        };
        let found = fast::solve(&clear, stage, start, &mut |step| {
            cost = step.cost;
            !self.control.stopped()
        })?;
        let found = Start {
            damping: found.damping,
            ..Start::from(found.z)
        };
        let values = 3.0 * observations.views.len() as f64;
        let parameters = (occluders as f64).min(OF_VALUES * values);
        let chi2 = 2.0 * cost / values;
        Ok((cost - last.loss < parameters * chi2.max(1.0)).then_some((clear, found)))
    }

    /// The same model with nothing in the way of the light.
    pub(super) fn clear(
        &self,
        shared: &Shared,
        observations: &Observations,
    ) -> Result<Shared, ReconstructError> {
        let cameras = self.capture.frames.iter().map(|frame| &frame.camera);
        Ok(shared.unoccluded(observations, Shells::spheres(cameras))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_is_asked_once_however_short_the_run() {
        for ended in [Ended::Converged, Ended::TimeLimit] {
            assert!(is_asked([0, 1], ended));
            assert!(!is_asked([0, 2], ended) && !is_asked([1, 1], ended));
        }
        for ended in [Ended::Interrupted, Ended::Iterations] {
            assert!(!is_asked([0, 1], ended));
        }
    }
}
