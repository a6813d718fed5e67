//! The specular lobe as a part of the nuisance.

use super::{Fit, FitError, Study};
use crate::criticism::{scene::Scene, transport::Lobe};

/// What is expected of the lobe: α = 0.45 within a factor, κ = 0.04.
const LOBE_PRIOR: [(f32, f32); 2] = [(-0.8, 0.6), (0.04, 0.03)];

impl Fit {
    /// Differences of renders under slightly other lobes, in units of the prior, with where the present lobe lies in it.
    pub fn lobe_columns(&self, study: &Study<'_>) -> Result<Vec<(Vec<f32>, f32)>, FitError> {
        let Some(own) = self.lobe else {
            return Ok(Vec::new());
        };
        let value = |lobe: Lobe| {
            let transport = self.occluded(study, study.transport(&self.horizon, Some(lobe)));
            let scene = Scene {
                transport: &transport,
                bare: &transport,
                ..self.scene(study)
            };
            scene.lit_by(&self.radiance)
        };
        let [(_, log_sd), (_, kappa_sd)] = LOBE_PRIOR;
        let step = 0.05f32;
        let wide = value(Lobe {
            alpha: own.alpha * step.exp(),
            ..own
        });
        let narrow = value(Lobe {
            alpha: own.alpha * (-step).exp(),
            ..own
        });
        let low = (own.kappa - 0.01).max(0.0);
        let high = own.kappa + 0.01;
        let (more, less) = (
            value(Lobe { kappa: high, ..own }),
            value(Lobe { kappa: low, ..own }),
        );
        let difference = |a: &[f32], b: &[f32], scale: f32| -> Vec<f32> {
            (0..a.len())
                .map(|i| self.mean.slope[i] * scale * (a[i] - b[i]))
                .collect()
        };
        Ok(vec![
            (
                difference(&wide, &narrow, log_sd / (2.0 * step)),
                unusual(own)[0],
            ),
            (
                difference(&more, &less, kappa_sd / (high - low)),
                unusual(own)[1],
            ),
        ])
    }
}

/// Where a lobe lies in the prior, in standard deviations.
pub(super) fn unusual(lobe: Lobe) -> [f32; 2] {
    let [(log_mean, log_sd), (kappa_mean, kappa_sd)] = LOBE_PRIOR;
    [
        (lobe.alpha.ln() - log_mean) / log_sd,
        (lobe.kappa - kappa_mean) / kappa_sd,
    ]
}

/// A lobe after a step in units of the prior.
pub(super) fn moved(lobe: Lobe, alpha: f32, kappa: f32) -> Lobe {
    let [(_, log_sd), (_, kappa_sd)] = LOBE_PRIOR;
    let log = lobe.alpha.ln() + (alpha * log_sd).clamp(-0.3, 0.3);
    Lobe {
        alpha: log.exp().clamp(0.08, 1.0),
        // Some reflection is left, so that its width keeps a slope.
        kappa: (lobe.kappa + (kappa * kappa_sd).clamp(-0.02, 0.02)).clamp(0.004, 0.9),
    }
}
