//! Whether a capture shows any occluder at all.

use super::super::fast::{self, Problem, Stage, Start};
use super::{ReconstructError, Run};

/// The prior ties most parameters of an occluder to each other: they count for no more than this share of the values.
const OF_VALUES: f64 = 0.1;

impl Run<'_> {
    /// Whether the occluders of the round just ended explain no more than as many parameters would of anything.
    ///
    /// By Akaike's criterion with overdispersion (Burnham & Anderson, Model Selection, 2002, 2.5): a parameter has to lower the
    /// cost by χ² per residual of what is explained without. Without a moving shadow light and albedo cannot be told apart;
    /// an occluder that is fitted all the same then hides light that was never there.
    ///
    /// `occluders` is how many parameters they have.
    pub(super) fn unoccluded(
        &self,
        problem: &Problem<'_>,
        stage: &Stage,
        occluders: usize,
        used: &(dyn Fn(usize, u32) -> bool + Sync),
    ) -> Result<bool, ReconstructError> {
        let (Some(_), Some(last)) = (problem.occluders, self.curve.last()) else {
            return Ok(false);
        };
        self.report("signs of an occluder", last.loss, 0.0);
        let clear = Problem {
            occluders: None,
            ..*problem
        };
        let (observations, shared) = fast::prepare(&clear, stage, used)?;
        let mut cost = f64::INFINITY;
        let start = Start::from(vec![0.0; shared.parameters()]);
        fast::solve(&shared, stage, start, &mut |step| {
            cost = step.cost;
            !self.control.stopped()
        })?;
        let values = 3.0 * observations.views.len() as f64;
        let parameters = (occluders as f64).min(OF_VALUES * values);
        let chi2 = 2.0 * cost / values;
        Ok(cost - last.loss < parameters * chi2.max(1.0))
    }
}
