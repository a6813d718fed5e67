//! How much sites' albedos and residuals scatter.

use super::{Fit, FitError, Study};
use crate::criticism::statistics::median;

/// The least scale of the variances. They allow for footprints and the model's own error, so that less than one is common.
const LEAST: f64 = 0.1;

impl Fit {
    /// Each site's own albedo at its best, and how much sites differ.
    pub(super) fn site_albedo(&mut self, study: &Study<'_>) -> Result<(), FitError> {
        let precision = self.precision(study, &|i| study.develops(i));
        let r = self.residual_of_mean(study);
        let own = precision.own(&r);
        self.parameters.deviation = own.iter().map(|o| o.0).collect();
        for c in 0..3 {
            // Without the prior each site's estimate scatters by τ² and its own variance.
            let (mut sizes, mut errors): (Vec<f64>, Vec<f64>) = own
                .iter()
                .skip(c)
                .step_by(3)
                .filter_map(|o| {
                    let free = f64::from(o.1).powi(-2) - self.tau[c].powi(-2);
                    let estimate = f64::from(o.0) / (f64::from(o.1).powi(2) * free);
                    (free * 0.04 > 1.0).then(|| (estimate.abs(), 1.0 / free))
                })
                .unzip();
            if sizes.len() > 10 {
                let spread = median(&mut sizes) / 0.6745;
                let noise = median(&mut errors);
                self.tau[c] = (spread * spread - noise).max(0.0).sqrt().clamp(0.002, 0.5);
            }
        }
        self.evaluate(study)
    }

    /// The scale of the variances, of the surface and of the background, and who is an outlier.
    pub(super) fn variances(&mut self, study: &Study<'_>) {
        let r = self.residual(study);
        let views = study.seen.views.len();
        let standard = |i: usize| f64::from(r[i] / study.variance[i].sqrt());
        // About their middle: an offset that all values share is a finding, not noise.
        let spread = |range: std::ops::Range<usize>| {
            let all: Vec<f64> = range
                .filter(|&i| study.develops(i / 3))
                .map(standard)
                .collect();
            let middle = median(&mut all.clone());
            let mut sizes: Vec<f64> = all.iter().map(|z| (z - middle).abs()).collect();
            let spread = median(&mut sizes) / 0.6745;
            if spread.is_finite() {
                spread.powi(2)
            } else {
                1.0
            }
        };
        // A residual has been fitted already: never take it for far better than the sensor's noise.
        self.inflation = spread(0..3 * views).max(LEAST);
        self.dark_inflation = spread(3 * views..r.len()).max(LEAST);
        self.trust = (0..r.len())
            .map(|i| {
                // The background has no outliers to guard against, and what is bright there is evidence.
                if i >= 3 * views {
                    return 1.0;
                }
                let scale = self.scale(i, views).sqrt();
                (3.0 / (standard(i) / scale).abs().max(1e-9)).min(1.0) as f32
            })
            .collect();
    }

    pub(super) fn scale(&self, i: usize, views: usize) -> f64 {
        if i < 3 * views {
            self.inflation
        } else {
            self.dark_inflation
        }
    }
}
