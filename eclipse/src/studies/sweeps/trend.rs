//! What the paper says of trends along the sweeps, and everything in short.

use super::{Curve, LAMPS, PERSON, ROUGHNESS, no_help, outcome};
use crate::{
    report::text::number,
    studies::evidence::{listed, mean},
};

/// A part of the claim beyond "better with somebody than with nobody": what is less at one end of a sweep than at the other, in every
/// seed.
pub(super) struct Trend {
    /// In a few words.
    name: &'static str,
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
        [name, what]: [&'static str; 2],
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
        let means: Vec<f64> = all.iter().map(|seeds| mean(seeds)).collect();
        let values: Vec<f64> = curve.sweep.points.iter().map(|point| point.0).collect();
        let word = outcome(held);
        Some(Self {
            name,
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
            let what = [
                "larger occluders are better",
                "Larger occluders lower the error of the light",
            ];
            Self::new(curve, what, |[with, _]| *with, Largest::First, false)
        });
        // Wide lamps are light of low frequency.
        let frequency = find(LAMPS).and_then(|curve| {
            let what = [
                "more is gained at higher frequency",
                "The share of the error that somebody in the light takes away grows with the light's frequency",
            ];
            Self::new(curve, what, taken_away, Largest::First, true)
        });
        let roughness = find(ROUGHNESS).and_then(|curve| {
            let what = [
                "more is gained on rougher objects",
                "That share grows with the object's roughness",
            ];
            Self::new(curve, what, taken_away, Largest::Last, true)
        });
        [size, frequency, roughness].into_iter().flatten().collect()
    }
}

/// What held, and with its mean errors what did not.
pub(super) fn in_short(curves: &[Curve], trends: &[Trend]) -> String {
    let counted = |what: &str, held: &[&str], all: usize| match all {
        0 => None,
        _ if held.is_empty() => Some(format!("0 of {all} {what} held")),
        _ => Some(format!(
            "{} of {all} {what} held ({})",
            held.len(),
            held.join(", ")
        )),
    };
    let helped = curves.iter().filter(|curve| curve.held());
    let helped: Vec<&str> = helped.map(|curve| curve.sweep.name).collect();
    let trended = trends.iter().filter(|trend| trend.held);
    let trended: Vec<&str> = trended.map(|trend| trend.name).collect();
    let counts = [
        counted("sweeps", &helped, curves.len()),
        counted("trends", &trended, trends.len()),
    ];
    let failed = curves.iter().filter(|curve| !curve.held()).map(failures);
    let failed: Vec<String> = failed.collect();
    let helpless = match failed.is_empty() {
        true => String::new(),
        false => format!(
            " Somebody in the light is no help over {} (relative MSE of the light with somebody against nobody, means).",
            failed.join("; ")
        ),
    };
    let untrue = trends.iter().filter(|trend| !trend.held);
    let untrue: Vec<&str> = untrue.map(|trend| trend.name).collect();
    let untrue = match untrue.is_empty() {
        true => String::new(),
        false => format!(
            " It is not so that {} (why was not found).",
            untrue.join(", nor that ")
        ),
    };
    let counts: Vec<String> = counts.into_iter().flatten().collect();
    format!("{}.{helpless}{untrue}", counts.join(", "))
}

/// Where somebody is no help, and in how many seeds.
fn failures(curve: &Curve) -> String {
    let means = curve.means(0).into_iter().zip(curve.means(1));
    let points = curve.sweep.points.iter().zip(&curve.errors).zip(means);
    let failed = points.filter_map(|(((value, _), pairs), (with, without))| {
        let seeds = pairs.iter().filter(|pair| no_help(pair)).count();
        (seeds > 0).then(|| {
            format!(
                "{} ({seeds} of {} seeds, {} against {}; {})",
                number(*value),
                pairs.len(),
                number(with),
                number(without),
                curve.why_at(*value)
            )
        })
    });
    let failed: Vec<String> = failed.collect();
    format!("{} at {}", curve.sweep.name, failed.join(", "))
}
