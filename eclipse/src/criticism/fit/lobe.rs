//! The specular lobe as a part of the nuisance.

use rayon::prelude::*;

use super::{Fit, FitError, Study};
use crate::criticism::{
    glossy::{Arriving, Reflected},
    transport::Lobe,
};

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
        let of_view = |(light, by): &mut (Arriving, [Reflected; 4]), v: usize| {
            let view = &seen.views[v];
            let site = view.site as usize;
            let albedo = &self.mean.albedo[3 * site..][..3];
            light.replace(self.horizon.row(seen, view));
            light.see(seen.sites[site].point.normal, seen.outgoing(view));
            if let Some(pass) = &passing {
                let weights = light.weight.iter_mut().zip(&light.source);
                weights.for_each(|(weight, &source)| *weight *= pass(v, source as usize));
            }
            for (lobe, by) in lobes.into_iter().zip(by.iter_mut()) {
                light.reflect(Some(lobe), by);
            }
            let mut sums = [[0.0f32; 3]; 4];
            for (sum, by) in sums.iter_mut().zip(by) {
                let sources = light.source.iter().zip(&light.weight);
                let both = by.diffuse.iter().zip(&by.specular);
                for ((&source, weight), (d, s)) in sources.zip(both) {
                    let radiance = &self.radiance[3 * source as usize..][..3];
                    for c in 0..3 {
                        sum[c] += weight * (albedo[c] * d + s) * radiance[c];
                    }
                }
            }
            sums
        };
        let views: Vec<[[f32; 3]; 4]> = (0..seen.views.len())
            .into_par_iter()
            .map_init(Default::default, of_view)
            .collect();
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
