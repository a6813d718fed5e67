//! What the paper says of trends along the sweeps, and everything in short.

use super::{Curve, LAMPS, PERSON};
use crate::studies::evidence::listed;

/// A part of the claim beyond "better with somebody than with nobody": what is less at the end of a sweep than at its start, in
/// every seed.
pub(super) struct Trend {
    what: &'static str,
    /// With its numbers.
    pub words: String,
    pub held: bool,
}

impl Trend {
    /// That `of` a pair of errors falls; none of a sweep of one value, as is left after a stop.
    fn new(curve: &Curve, what: &'static str, of: fn(&[f64; 2]) -> f64) -> Option<Self> {
        let all: Vec<Vec<f64>> = curve
            .errors
            .iter()
            .map(|p| p.iter().map(of).collect())
            .collect();
        let (first, last) = (all.first()?, all.last()?);
        if all.len() < 2 {
            return None;
        }
        let mut pairs = first.iter().zip(last);
        let held = pairs.all(|(a, b)| a > b);
        let means: Vec<f64> = all
            .iter()
            .map(|v| v.iter().sum::<f64>() / v.len() as f64)
            .collect();
        let values: Vec<f64> = curve.sweep.points.iter().map(|point| point.0).collect();
        let word = if held { "held" } else { "not held" };
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
        let size = find(PERSON).and_then(|curve| {
            let what = "larger occluders lower the error of the light";
            Self::new(curve, what, |[with, _]| *with)
        });
        // Wide lamps are light of low frequency.
        let frequency = find(LAMPS).and_then(|curve| {
            let what = "the share of the error that somebody in the light takes away grows with the light's frequency";
            Self::new(curve, what, |[with, without]| 1.0 - with / without)
        });
        size.into_iter().chain(frequency).collect()
    }
}

/// What held and what did not.
pub(super) fn in_short(curves: &[Curve], trends: &[Trend]) -> String {
    let (helped, others): (Vec<&Curve>, Vec<&Curve>) =
        curves.iter().partition(|curve| curve.helpless().is_empty());
    let mut parts = Vec::new();
    if !helped.is_empty() {
        let labels: Vec<&str> = helped.iter().map(|curve| curve.sweep.label).collect();
        parts.push(format!(
            "somebody in the light lowers its error in every seed over {}",
            labels.join(", ")
        ));
    }
    if !others.is_empty() {
        let with_values = |curve: &&Curve| {
            let values = listed(&curve.helpless());
            format!("{} (at {values})", curve.sweep.label)
        };
        let labels: Vec<String> = others.iter().map(with_values).collect();
        parts.push(format!(
            "somebody in the light does not lower its error in every seed over {}",
            labels.join(", ")
        ));
    }
    let trends = trends.iter().map(|trend| {
        let word = if trend.held { "held" } else { "not held" };
        format!("{}: {word}", trend.what)
    });
    parts
        .into_iter()
        .chain(trends)
        .collect::<Vec<_>>()
        .join("; ")
        + "."
}
