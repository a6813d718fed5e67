//! What the paper says of trends along the sweeps, and everything in short.

use super::{Curve, LAMPS, PERSON, ROUGHNESS, outcome};
use crate::studies::evidence::listed;

/// A part of the claim beyond "better with somebody than with nobody": what is less at one end of a sweep than at the other, in every
/// seed.
pub(super) struct Trend {
    what: &'static str,
    /// With its numbers.
    pub words: String,
    pub held: bool,
}

/// At which end of a sweep something is to be largest.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Largest {
    First,
    Last,
}

impl Trend {
    /// That `of` a pair of errors is largest at an end and least at the other; none of a sweep of one value, as is left after a stop. Of a
    /// `gain` there must be some at its largest: that harm grows towards the other end shows none.
    fn new(
        curve: &Curve,
        what: &'static str,
        of: fn(&[f64; 2]) -> f64,
        largest: Largest,
        gain: bool,
    ) -> Option<Self> {
        let all: Vec<Vec<f64>> = curve
            .errors
            .iter()
            .map(|p| p.iter().map(of).collect())
            .collect();
        let (first, last) = (all.first()?, all.last()?);
        if all.len() < 2 {
            return None;
        }
        let (large, small) = match largest {
            Largest::First => (first, last),
            Largest::Last => (last, first),
        };
        let mut pairs = large.iter().zip(small);
        let held = pairs.all(|(a, b)| a > b && (!gain || *a > 0.0));
        let means: Vec<f64> = all
            .iter()
            .map(|v| v.iter().sum::<f64>() / v.len() as f64)
            .collect();
        let values: Vec<f64> = curve.sweep.points.iter().map(|point| point.0).collect();
        let word = outcome(held);
        Some(Self {
            what,
            words: format!(
                "{what}: {word} ({} at {}, means; from {} to {} at the ends, a seed each)",
                listed(&means),
                listed(&values),
                listed(first),
                listed(last)
            ),
            held,
        })
    }

    /// What the paper says of the trends of these curves.
    pub(super) fn all(curves: &[Curve]) -> Vec<Self> {
        let find = |name: &str| curves.iter().find(|curve| curve.sweep.name == name);
        let taken_away = |[with, without]: &[f64; 2]| 1.0 - with / without;
        let size = find(PERSON).and_then(|curve| {
            let what = "larger occluders lower the error of the light";
            Self::new(curve, what, |[with, _]| *with, Largest::First, false)
        });
        // Wide lamps are light of low frequency.
        let frequency = find(LAMPS).and_then(|curve| {
            let what = "the share of the error that somebody in the light takes away grows with the light's frequency";
            Self::new(curve, what, taken_away, Largest::First, true)
        });
        let roughness = find(ROUGHNESS).and_then(|curve| {
            let what = "it grows with the object's roughness";
            Self::new(curve, what, taken_away, Largest::Last, true)
        });
        [size, frequency, roughness].into_iter().flatten().collect()
    }
}

/// What held and what did not, with the mean errors.
pub(super) fn in_short(curves: &[Curve], trends: &[Trend]) -> String {
    let of = |curve: &Curve| {
        let values: Vec<f64> = curve.sweep.points.iter().map(|point| point.0).collect();
        format!(
            "{} {}: {} with somebody in the light, {} with nobody ({})",
            curve.sweep.label,
            listed(&values),
            listed(&curve.means(0)),
            listed(&curve.means(1)),
            curve.outcome_and_why()
        )
    };
    let trends = trends.iter().map(|trend| {
        let why = match trend.held {
            true => "",
            false => ", the cause was not found",
        };
        format!("{}: {}{why}", trend.what, outcome(trend.held))
    });
    let parts: Vec<String> = curves.iter().map(of).chain(trends).collect();
    format!(
        "relative MSE of the light, means of seeds, by {}.",
        parts.join("; ")
    )
}
