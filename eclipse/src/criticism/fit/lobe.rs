//! The specular lobe as a part of the nuisance.

use rayon::prelude::*;

use super::{Fit, FitError, Study};
use crate::criticism::transport::{Lobe, reflect_by};

/// What is expected of the lobe: α = 0.45 within a factor, κ = 0.04.
const LOBE_PRIOR: [(f32, f32); 2] = [(-0.8, 0.6), (0.04, 0.03)];

/// The largest change of κ a step may make.
const LARGEST_STEP: f32 = 0.1;

impl Fit {
    /// Differences of renders under slightly other lobes, in units of the prior, with where the present lobe lies in it.
    pub fn lobe_columns(&self, study: &Study<'_>) -> Result<Vec<(Vec<f32>, f32)>, FitError> {
        let Some(own) = self.lobe else {
            return Ok(Vec::new());
        };
        let [(_, log_sd), (_, kappa_sd)] = LOBE_PRIOR;
        let step = 0.05f32;
        let low = (own.kappa - 0.01).max(0.0);
        let high = own.kappa + 0.01;
        let of_alpha = |alpha: f32| Lobe { alpha, ..own };
        let of_kappa = |kappa: f32| Lobe { kappa, ..own };
        let [wide, narrow, more, less] = self.under_lobes(
            study,
            [
                of_alpha(own.alpha * step.exp()),
                of_alpha(own.alpha * (-step).exp()),
                of_kappa(high),
                of_kappa(low),
            ],
        );
        let difference = |a: &[f32], b: &[f32], scale: f32| -> Vec<f32> {
            (0..a.len())
                .map(|i| self.mean.slope[i] * scale * (a[i] - b[i]))
                .collect()
        };
        let [alpha, kappa] = unusual(own);
        Ok(vec![
            (difference(&wide, &narrow, log_sd / (2.0 * step)), alpha),
            (difference(&more, &less, kappa_sd / (high - low)), kappa),
        ])
    }

    /// The ideal values under other lobes, all in one pass over the light that reaches the views.
    fn under_lobes(&self, study: &Study<'_>, lobes: [Lobe; 4]) -> [Vec<f32>; 4] {
        let seen = &study.seen;
        let passing = self.passing(study);
        let of_view = |v: usize| {
            let view = &seen.views[v];
            let site = view.site as usize;
            let normal = seen.sites[site].point.normal;
            let outgoing = seen.outgoing(view);
            let albedo = &self.mean.albedo[3 * site..][..3];
            let mut sums = [[0.0f32; 3]; 4];
            for (source, weight, incident) in self.horizon.row(seen, view) {
                let share = passing.as_ref().map_or(1.0, |pass| pass(v, source));
                let light = &self.radiance[3 * source..][..3];
                let reflected = reflect_by(lobes, normal, incident, outgoing);
                for (sum, (d, s)) in sums.iter_mut().zip(reflected) {
                    for c in 0..3 {
                        sum[c] += share * weight * (albedo[c] * d + s) * light[c];
                    }
                }
            }
            sums
        };
        let views: Vec<[[f32; 3]; 4]> =
            (0..seen.views.len()).into_par_iter().map(of_view).collect();
        [0, 1, 2, 3].map(|lobe| {
            let mut values: Vec<f32> = views.iter().flat_map(|sums| sums[lobe]).collect();
            values.resize(3 * seen.len(), 0.0);
            values
        })
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
        kappa: (lobe.kappa + (kappa * kappa_sd).clamp(-LARGEST_STEP, LARGEST_STEP))
            .clamp(0.004, 0.9),
    }
}
