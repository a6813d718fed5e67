//! Predicted standard deviations beside errors and the spread over draws, a value each.

use render::sampler::SampleKey;

use crate::{report::text::number, studies::ranks::rank_correlation};

/// Errors are of the size of deviations when their ratio lies between this and one over it.
pub(super) const HONEST: f64 = 0.5;
/// Where deviations are large errors should be: least rank correlation over values.
pub(super) const CORRELATED: f64 = 0.4;

/// Of a normal distribution 95 % lie within two deviations; so many must.
const COVERED: f64 = 0.8;

/// A quantity as one draw found it, with its predicted deviations.
#[derive(Clone, Debug, Default)]
pub(super) struct Values {
    pub found: Vec<f32>,
    pub deviation: Vec<f32>,
}

/// Per value of a quantity, over all draws.
#[derive(Clone)]
pub(super) struct Spread {
    /// What it is of.
    pub name: &'static str,
    /// How much each value counts.
    weight: Vec<f64>,
    /// Root mean square of the predicted deviation.
    pub predicted: Vec<f64>,
    /// Deviation of the draws from their mean.
    pub between: Vec<f64>,
    /// Root mean square of the error.
    pub error: Vec<f64>,
    /// Shares of errors within one and two deviations.
    pub within: [f64; 2],
    /// How many they are.
    draws: usize,
    /// Draws may spread by so much of the deviation: by all of it and the standard error of a deviation that so many draws tell.
    allowed: f64,
}

impl Spread {
    /// Of at least two draws; `weight` tells how much each value counts, and each has a truth.
    pub(super) fn new(
        name: &'static str,
        truth: &[f32],
        weight: Vec<f64>,
        draws: &[&Values],
    ) -> Self {
        let n = draws.len() as f64;
        let (mut within, mut all) = ([0.0; 2], 0.0);
        let (mut predicted, mut between, mut error) = (Vec::new(), Vec::new(), Vec::new());
        for (i, (truth, weight)) in truth.iter().zip(&weight).enumerate() {
            let values = || draws.iter().map(|d| f64::from(d.found[i]));
            let deviations = || draws.iter().map(|d| f64::from(d.deviation[i]));
            let errors = || values().map(|v| v - f64::from(*truth));
            let centre = values().sum::<f64>() / n;
            let squares: f64 = values().map(|v| (v - centre).powi(2)).sum();
            between.push((squares / (n - 1.0)).sqrt());
            error.push((errors().map(|e| e * e).sum::<f64>() / n).sqrt());
            predicted.push((deviations().map(|d| d * d).sum::<f64>() / n).sqrt());
            for (error, deviation) in errors().zip(deviations()) {
                for (k, within) in within.iter_mut().enumerate() {
                    if error.abs() <= (k + 1) as f64 * deviation {
                        *within += weight;
                    }
                }
                all += weight;
            }
        }
        Self {
            name,
            weight,
            predicted,
            between,
            error,
            within: within.map(|sum| sum / all),
            draws: draws.len(),
            allowed: 1.0 + (2.0 * (n - 1.0)).sqrt().recip(),
        }
    }

    /// Root mean square of `of` over that of the prediction.
    fn over_predicted(&self, of: &[f64]) -> f64 {
        let square = |values: &[f64]| {
            let weighted = values.iter().zip(&self.weight);
            weighted.map(|(v, weight)| weight * v * v).sum::<f64>()
        };
        (square(of) / square(&self.predicted)).sqrt()
    }

    /// Errors over deviations.
    pub(super) fn size(&self) -> f64 {
        self.over_predicted(&self.error)
    }

    /// The spread of draws over deviations.
    pub(super) fn noise(&self) -> f64 {
        self.over_predicted(&self.between)
    }

    /// Which shares of what counts, and of its squared error, some values have.
    pub(super) fn shares(&self, some: &[bool]) -> [f64; 2] {
        let (mut those, mut all) = ([0.0; 2], [0.0; 2]);
        for ((weight, error), some) in self.weight.iter().zip(&self.error).zip(some) {
            for (i, value) in [*weight, weight * error * error].into_iter().enumerate() {
                all[i] += value;
                those[i] += if *some { value } else { 0.0 };
            }
        }
        [0, 1].map(|i| those[i] / all[i])
    }

    /// The same without these values, but for how many errors lie within deviations.
    pub(super) fn without(&self, these: &[bool]) -> Self {
        let weights = self.weight.iter().zip(these);
        Self {
            weight: weights
                .map(|(weight, out)| if *out { 0.0 } else { *weight })
                .collect(),
            ..self.clone()
        }
    }

    /// Pairs of a positive deviation and `of`, of all values that count: where none is predicted there is nothing to rank.
    pub(super) fn pairs(&self, of: &[f64]) -> Vec<[f64; 2]> {
        let pairs = self.predicted.iter().zip(of).zip(&self.weight);
        pairs
            .filter(|((predicted, _), weight)| **predicted > 0.0 && **weight > 0.0)
            .map(|((predicted, value), _)| [*predicted, *value])
            .collect()
    }

    /// Of errors with deviations.
    pub(super) fn place(&self) -> f64 {
        rank_correlation(&self.pairs(&self.error))
    }

    /// The same if errors were drawn from a normal distribution with these very deviations, and were as alike from draw to draw as they
    /// are: there is one truth, and where all deviations are much the same chance decides which errors are large.
    pub(super) fn place_if_drawn(&self) -> f64 {
        let own = (self.noise() / self.size()).min(1.0);
        let shared = (1.0 - own * own).sqrt();
        let mut stream = SampleKey::default().stream();
        let mut normal = || f64::from(stream.normal());
        let drawn = self.predicted.iter().map(|deviation| {
            let of_truth = shared * normal();
            let draws = (0..self.draws).map(|_| (of_truth + own * normal()).powi(2));
            deviation * (draws.sum::<f64>() / self.draws as f64).sqrt()
        });
        rank_correlation(&self.pairs(&drawn.collect::<Vec<_>>()))
    }

    /// Of the spread of draws with deviations.
    pub(super) fn place_of_noise(&self) -> f64 {
        rank_correlation(&self.pairs(&self.between))
    }

    /// Whether errors are of the size of deviations, draws spread by no more than those allow, errors are where deviations are large,
    /// and most lie within two of them.
    pub(super) fn parts(&self) -> [bool; 4] {
        [
            honest(self.size()),
            self.noise() <= self.allowed,
            self.place() > CORRELATED,
            self.within[1] > COVERED,
        ]
    }

    /// Whether it held, with its numbers.
    pub(super) fn words(&self) -> String {
        let held = self.parts().iter().all(|&held| held);
        format!(
            "{}: {}: errors are {} of what was predicted (RMS), draws spread by {} of it; {} % and {} % of errors lie within one and \
             two deviations; the rank correlation of errors and deviations is {}",
            self.name,
            if held { "held" } else { "not held" },
            number(self.size()),
            number(self.noise()),
            number(100.0 * self.within[0]),
            number(100.0 * self.within[1]),
            number(self.place()),
        )
    }

    /// What failed.
    pub(super) fn failures(&self) -> Vec<Failure> {
        let [size, noise, place, covered] = self.parts();
        let name = self.name;
        let ratio = self.size();
        let mut failures = Vec::new();
        let mut add = |held: bool, kind, words: String| {
            if !held {
                failures.push(Failure { kind, words });
            }
        };
        let (kind, words) = if ratio < HONEST {
            (Kind::Small, "less than half of")
        } else if ratio > 1.0 / HONEST {
            (Kind::Other, "more than twice")
        } else {
            (Kind::Other, "not comparable with")
        };
        add(
            size,
            kind,
            format!("errors of the {name} are {words} what was predicted"),
        );
        add(
            noise,
            Kind::Other,
            format!("draws of the {name} spread by more than was predicted"),
        );
        add(
            place,
            Kind::Misplaced,
            format!("errors of the {name} are not where deviations are large"),
        );
        add(
            covered,
            Kind::Other,
            format!(
                "{} % of errors of the {name} lie beyond two deviations",
                number(100.0 * (1.0 - self.within[1]))
            ),
        );
        failures
    }
}

/// A part that failed.
#[derive(Debug)]
pub(super) struct Failure {
    pub kind: Kind,
    /// What it is.
    pub words: String,
}

/// What failures of one cause have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Errors are much smaller than was predicted.
    Small,
    /// They are elsewhere.
    Misplaced,
    /// Deviations are too small.
    Other,
}

/// Whether errors are of the size of deviations.
fn honest(ratio: f64) -> bool {
    (HONEST..=1.0 / HONEST).contains(&ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two draws of four values about a truth of 1, off by these shares of their deviations, and a fifth that does not count.
    fn spread(shares: [f32; 2], deviations: [f32; 4]) -> Spread {
        let draw = |share: f32| Values {
            found: deviations
                .iter()
                .map(|d| 1.0 + share * d)
                .chain([70.0])
                .collect(),
            deviation: deviations.into_iter().chain([0.1]).collect(),
        };
        let draws = shares.map(draw);
        let weight = vec![1.0, 1.0, 1.0, 1.0, 0.0];
        Spread::new("light", &[1.0; 5], weight, &[&draws[0], &draws[1]])
    }

    #[test]
    fn errors_that_deviations_foretell_hold() {
        let found = spread([1.0, -1.0], [0.1, 0.2, 0.3, 0.4]);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        assert!(near(found.size(), 1.0) && near(found.noise(), 2f64.sqrt()));
        assert!(near(found.place(), 1.0) && near(found.place_of_noise(), 1.0));
        assert_eq!(found.parts(), [true; 4]);
        assert!(found.words().starts_with("light: held"));
        assert!(found.failures().is_empty());
        assert_eq!(found.within[1], 1.0);
    }

    #[test]
    fn what_failed_is_named() {
        let small = spread([0.2, 0.2], [0.1, 0.2, 0.3, 0.4]);
        assert!((small.size() - 0.2).abs() < 1e-5 && small.noise() < 1e-5);
        assert_eq!(small.within, [1.0; 2]);
        assert_eq!(small.parts(), [false, true, true, true]);
        assert!(
            small.failures()[0]
                .words
                .contains("light are less than half")
        );

        let wild = spread([3.0, -3.0], [0.1, 0.2, 0.3, 0.4]);
        assert_eq!(wild.parts(), [false, false, true, false]);
        assert_eq!(wild.within, [0.0; 2]);
        let failures = wild.failures();
        assert!(failures.iter().all(|failure| failure.kind == Kind::Other));
        let failures: Vec<String> = failures.into_iter().map(|f| f.words).collect();
        let failures = failures.join(", ");
        for failure in [
            "more than twice what",
            "draws of the light spread",
            "100 % of errors of the light lie beyond",
        ] {
            assert!(failures.contains(failure), "{failures}");
        }
        assert!(wild.words().starts_with("light: not held"));
    }

    #[test]
    fn deviations_that_hardly_vary_foretell_little_of_where_errors_are() {
        let of = |least: f32| {
            let deviation: Vec<f32> = (0..4000)
                .map(|i| least + (1.0 - least) * i as f32 / 4000.0)
                .collect();
            // Draws differ by a tenth of what they are off by.
            let draw = |share: f32| Values {
                found: deviation.iter().map(|d| share * d).collect(),
                deviation: deviation.clone(),
            };
            let draws = [draw(0.9), draw(1.1)];
            let weight = vec![1.0; 4000];
            Spread::new("light", &[0.0; 4000], weight, &[&draws[0], &draws[1]]).place_if_drawn()
        };
        let (alike, apart) = (of(0.8), of(0.01));
        assert!(alike < 0.15 && apart > 0.4, "{alike} {apart}");
    }

    #[test]
    fn some_values_can_be_left_out() {
        let found = spread([1.0, -1.0], [0.1, 0.2, 0.3, 0.4]);
        let last = [false, false, false, true, true];
        let [values, error] = found.shares(&last);
        assert!((values - 0.25).abs() < 1e-12 && (error - 0.16 / 0.3).abs() < 1e-5);
        let rest = found.without(&last);
        assert_eq!(rest.pairs(&rest.error).len(), 3);
    }

    #[test]
    fn where_nothing_is_predicted_nothing_holds() {
        let none = spread([1.0, 1.0], [0.0; 4]);
        // No error is within no deviation.
        assert_eq!(none.parts(), [false, false, false, true]);
        assert_eq!(none.failures().len(), 3);
        let misplaced = Spread {
            error: vec![0.4, 0.3, 0.2, 0.1, 0.0],
            ..spread([1.0, -1.0], [0.1, 0.2, 0.3, 0.4])
        };
        assert_eq!(misplaced.parts(), [true, true, false, true]);
        assert!(
            misplaced.failures()[0]
                .words
                .contains("not where deviations")
        );
    }
}
