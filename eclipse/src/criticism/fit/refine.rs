//! Steps until nothing changes.

use super::{Fit, FitError, Study};

/// A relative change of the cost in a step that counts as none: a fortieth of what an effect must gain to be looked at.
const SETTLED: f64 = 1e-4;
/// A relative change of a deviation that counts as none.
const STEADY: f64 = 0.01;

impl Fit {
    /// Takes up to `steps` steps on the development data; fewer where two in a row change next to nothing, neither the cost nor what
    /// it is measured by.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn refine(&mut self, study: &Study<'_>, steps: usize) -> Result<(), FitError> {
        self.refine_while(study, steps, &|_| true)
    }

    /// The same as long as `goes_on` says so, asked before each step with its number.
    ///
    /// # Errors
    /// As [`refine`](Self::refine).
    pub fn refine_while(
        &mut self,
        study: &Study<'_>,
        steps: usize,
        goes_on: &dyn Fn(usize) -> bool,
    ) -> Result<(), FitError> {
        let mut settled = 0;
        for step in (0..steps).take_while(|&step| goes_on(step)) {
            self.relink(study)?;
            let lobe = self.lobe.is_some();
            // Under the same weights: what their estimates do to the cost is no progress.
            let precision = self.precision(study, &|i| study.develops(i));
            let before = self.cost_under(study, &precision);
            self.step(study, &precision, lobe)?;
            let after = self.cost_under(study, &precision);
            let scales = self.scales();
            self.site_albedo(study)?;
            if step > 0 {
                self.variances(study);
            }
            tracing::debug!(step, before, after, tau = ?self.tau, lobe = ?self.lobe, "nuisance step");
            let pairs = scales.into_iter().zip(self.scales());
            let steady = pairs.fold(true, |so_far, (was, is)| {
                so_far && (is / was).ln().abs() < STEADY
            });
            settled = if steady && (before - after).abs() < SETTLED * after.abs() {
                settled + 1
            } else {
                0
            };
            if step > 2 && settled > 1 {
                break;
            }
        }
        Ok(())
    }

    /// What the cost is measured by.
    fn scales(&self) -> [f64; 5] {
        let [a, b, c] = self.tau;
        [a, b, c, self.inflation, self.dark_inflation]
    }
}
