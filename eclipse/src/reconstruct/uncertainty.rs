//! How far off light, albedo and occluders may be where a solve ended: standard deviations by [`super::laplace`].

use std::borrow::Cow;

use autodiff::RunError;
use render::sampler::SampleKey;

use super::{
    laplace::{Effort, Laplace, Part, weighted_squares},
    least_squares::{Linearisation, Projector},
    model::{At, Shared},
};

/// Tells the random numbers of the probes from all others of a seed.
const PROBES: u32 = 0x1ab1_ace5;

/// What data say about everything that was solved for, on the solver's own grids.
pub struct Posterior<'a> {
    at: At<'a>,
    laplace: Laplace,
    radiance: Vec<f32>,
    prior: Vec<f64>,
    albedo: Vec<f32>,
    /// Of each albedo, were the light known: by its data and prior, and the part of it that is noise.
    albedo_variance: Vec<[f64; 2]>,
    occluders: std::ops::Range<usize>,
    /// Root mean square of the residuals, in units of what they were expected to be before weights were lowered for their sake.
    pub misfit: f64,
}

/// Standard deviations of everything that was solved for.
pub struct Deviations {
    /// Of the radiance, `[texel][channel]`: of all that is not known, half the width of the interval that holds 68 % of it, which
    /// is no less where the logarithm's deviation is small and more where it is large.
    pub radiance: Vec<f32>,
    /// Of the transmittance, `[texel of the masks' grid][frame]`; empty without occluders.
    pub masks: Vec<f32>,
    /// Of the albedo relative to itself, `[channel][patch]`.
    pub albedo: Vec<f32>,
}

impl<'a> Posterior<'a> {
    /// Of the solution `z` for the data that `shared` was last given; `go_on` as in [`Laplace::new`].
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug.
    pub fn new(
        shared: &'a Shared,
        z: &[f32],
        effort: Effort,
        seed: u64,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Result<Self, RunError> {
        let (mut at, albedo) = shared.linearise(z)?;
        let radiance = at.radiance()?;
        let projector = Projector::new(&at, shared.albedos(), shared.albedo_precision);
        // Where weights are zero there is no data; where they are too large for what is left, they say too much.
        let (sum, count) = at
            .residual()
            .iter()
            .zip(at.by_albedo())
            .filter(|(_, slope)| **slope != 0.0)
            .fold((0.0, 0u64), |(sum, n), (r, _)| {
                (sum + f64::from(*r).powi(2), n + 1)
            });
        let misfit = (sum / count.max(1) as f64).max(1.0);
        let key = SampleKey {
            seed,
            frame: PROBES,
            ..SampleKey::default()
        };
        let mut stream = key.stream();
        let traits = |at: &At<'_>, albedo: &[f32]| {
            let mut row = at.radiance_change().expect("an output of the model");
            row.extend_from_slice(albedo);
            row
        };
        let laplace = Laplace::new(
            &mut at,
            z.len(),
            &projector,
            misfit,
            effort,
            &mut || stream.normal(),
            &traits,
            go_on,
        );
        let own = projector.variances().iter().map(|variance| {
            // Data count as much less as the misfit says, the prior does not.
            let tied = f64::from(shared.albedo_precision);
            let data = (1.0 / variance - tied).max(0.0) / misfit;
            let all = 1.0 / (data + tied);
            [all, all.powi(2) * data]
        });
        Ok(Self {
            laplace,
            radiance,
            prior: shared.prior_variances(z),
            albedo,
            albedo_variance: own.collect(),
            occluders: shared.ranges()[1].clone(),
            misfit: shared.excess * misfit.sqrt(),
            at,
        })
    }

    /// How many numbers are known from the photographs rather than from what is assumed.
    pub fn known(&self) -> f64 {
        self.laplace.known()
    }

    /// The same with what there was no time to find; far more means that the deviations are too large.
    pub fn known_at_most(&self) -> f64 {
        self.laplace.known_at_most()
    }

    /// Of all that is not known, or of one part of it.
    pub fn deviations(&mut self, part: Part) -> Deviations {
        let n = self.radiance.len();
        let laplace = &self.laplace;
        let rest_weight = match part {
            Part::All => 1.0 / laplace.rest.len().max(1) as f64,
            _ => 0.0,
        };
        let traits = |weights: Vec<f64>, range: std::ops::Range<usize>| {
            let rows = laplace
                .traits
                .iter()
                .map(move |row| row[range.clone()].into());
            weighted_squares(weights.into_iter().zip(rows))
        };
        let radiance = match part {
            // The prior's own variance is known exactly: what data took away from it is all that was found.
            Part::All => {
                let gained = traits(laplace.gained(), 0..n);
                let left = traits(laplace.weights(Part::All), 0..n);
                let gained = gained.into_iter().chain(std::iter::repeat(0.0));
                let left = left.into_iter().chain(std::iter::repeat(0.0));
                let all = self.radiance.iter().zip(&self.prior).zip(gained.zip(left));
                all.map(|((radiance, prior), (gained, left))| {
                    let radiance = f64::from(*radiance);
                    let variance = (radiance.powi(2) * prior - gained).max(left);
                    half_width(radiance, variance.sqrt()).powi(2)
                })
                .collect()
            }
            _ => traits(laplace.weights(part), 0..n),
        };
        let found = laplace.traits.iter().zip(laplace.weights(part));
        let rest = laplace.rest.iter().map(|(_, row)| (row, rest_weight));
        let moved = weighted_squares(
            found
                .chain(rest)
                .map(|(row, weight)| (weight, Cow::from(&row[n..]))),
        );
        let moved = moved.into_iter().chain(std::iter::repeat(0.0));
        let albedo = self.albedo.iter().zip(&self.albedo_variance).zip(moved);
        let of_part = usize::from(part == Part::Noise);
        let albedo = albedo
            .map(|((value, own), moved)| {
                ((own[of_part] + moved).max(0.0).sqrt() / f64::from(value.max(1e-3))) as f32
            })
            .collect();
        let vectors = laplace.vectors.iter().zip(laplace.weights(part));
        let rest = laplace.rest.iter().map(|(z, _)| (z, rest_weight));
        let (at, occluders) = (&mut self.at, self.occluders.clone());
        let masks = weighted_squares(
            vectors
                .chain(rest)
                .filter(|(_, weight)| *weight > 0.0)
                .map(|(z, weight)| (weight, at.mask_change(&z[occluders.clone()]).into())),
        );
        let root = |variances: Vec<f64>| variances.iter().map(|v| v.sqrt() as f32).collect();
        Deviations {
            radiance: root(radiance),
            masks: root(masks),
            albedo,
        }
    }
}

/// Half the width of the interval e^±σ about a value whose logarithm is normal, where it moves by `deviation` to first order: the
/// first order alone, σ, is too small by a half where no more is known than the prior's σ of 1.4.
fn half_width(value: f64, deviation: f64) -> f64 {
    let relative = deviation / value;
    if relative.is_finite() {
        value * relative.sinh()
    } else {
        deviation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_logarithms_are_wider_than_the_first_order_where_little_is_known() {
        assert!((half_width(2.0, 0.02) - 0.02).abs() < 1e-6);
        // e^±1.4 is 4.06 and 0.25.
        assert!((half_width(0.5, 0.7) - 0.5 * 0.5 * (4.055 - 0.2466)).abs() < 1e-3);
        assert_eq!(half_width(0.0, 0.0), 0.0);
    }
}
