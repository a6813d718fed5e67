//! Whether standard deviations are of the size of errors: against the spread over draws of noise and seeds, and the truth.

use render::image::Image;
use serde_json::json;

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone},
    ranks::rank_correlation,
    small::{Setup, settings, steps},
    trial::{Solved, Trial},
};
use crate::report::text::number;

/// Draws of noise, and seeds of the solver with them: at a glance, quick, in full.
const DRAWS: [u64; 3] = [2, 5, 12];
/// Errors are of the size of deviations when their ratio lies between this and one over it.
const HONEST: f64 = 0.5;
/// Where deviations are large errors should be: least rank correlation over directions.
const CORRELATED: f64 = 0.4;
/// Where so many times as many numbers may be known as were found to be, solves were too short for their deviations.
const UNFINISHED: f64 = 1.5;

/// The study.
pub(super) struct Uncertain;

impl Study for Uncertain {
    fn name(&self) -> &'static str {
        "uncertainty"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let mut light = None;
        let draws = bench.each(0..bench.of_scale(DRAWS), |seed| {
            let trial = Setup {
                seed,
                ..Setup::of(bench.scale)
            }
            .trial("balls")?;
            let settings = settings(bench, &trial, seed);
            let solved = bench.reconstructed(&trial, &format!("draw {seed}"), &settings)?;
            let draw = Draw::new(&trial, &solved)?;
            light.get_or_insert(trial.light);
            Ok(draw)
        })?;
        // One draw has no spread.
        match light {
            Some(light) if draws.len() > 1 => {
                let spread = Spread::new(&light, &draws);
                Ok(evidence(bench, &spread, &draws))
            }
            _ => Err(bench.nothing("at least two draws")),
        }
    }
}

/// One draw of noise and what came of it, in the truth's scale.
struct Draw {
    light: Image,
    deviation: Image,
    albedo_error: f64,
    albedo_deviation: f64,
    mask_error: f64,
    mask_deviation: f64,
    /// Share of the solve's time.
    cost: f64,
    /// Numbers known from the photographs: found to be, and at most.
    known: [f64; 2],
}

impl Draw {
    fn new(trial: &Trial, solved: &Solved) -> Result<Self, StudyError> {
        let doubt = solved.found.uncertainty.as_ref();
        let doubt = doubt.ok_or(StudyError::Nothing("standard deviations"))?;
        let mut deviation = doubt.environment.clone();
        for (i, value) in deviation.data.iter_mut().enumerate() {
            *value *= solved.scale[i % 3] as f32;
        }
        let solving = solved.found.curve.last().map_or(f64::NAN, |p| p.seconds);
        let mask = |expected: &Option<f64>| expected.map(|e| e * e);
        let masks: Vec<f64> = doubt.summary.occluders.iter().filter_map(mask).collect();
        Ok(Self {
            light: solved.light(),
            deviation,
            albedo_error: 10f64.powf(-solved.albedo() / 20.0),
            albedo_deviation: doubt.summary.albedo / mean(&solved.scale),
            mask_error: mask_rms(trial, solved),
            mask_deviation: mean(&masks).sqrt(),
            cost: doubt.summary.seconds / solving,
            known: [doubt.summary.known, doubt.summary.known_at_most],
        })
    }
}

/// RMS error of the masks over frames and directions, weighted by true light and solid angle.
fn mask_rms(trial: &Trial, solved: &Solved) -> f64 {
    let Some(truth) = &trial.truth.occluders else {
        return f64::NAN;
    };
    let (mut sum, mut all) = (0.0, 0.0);
    for (found, truth) in solved.found.occluders.iter().zip(truth) {
        for (texel, (a, b)) in found.data.iter().zip(&truth.data).enumerate() {
            let v = ((texel / truth.width) as f64 + 0.5) / truth.height as f64;
            let light: f32 = trial.light.data[3 * texel..3 * texel + 3].iter().sum();
            let weight = (std::f64::consts::PI * v).sin() * f64::from(light);
            sum += weight * f64::from(a - b).powi(2);
            all += weight;
        }
    }
    (sum / all).sqrt()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Per value of the map of light, over all draws.
struct Spread {
    /// Root mean square of the predicted deviation.
    predicted: Vec<f64>,
    /// Deviation of the draws from their mean.
    between: Vec<f64>,
    /// Root mean square of the error.
    error: Vec<f64>,
    /// Shares of errors within one and two deviations.
    within: [f64; 2],
}

impl Spread {
    fn new(truth: &Image, draws: &[Draw]) -> Self {
        let n = draws.len() as f64;
        let mut within = [0.0; 2];
        let mut spread = Self {
            predicted: Vec::new(),
            between: Vec::new(),
            error: Vec::new(),
            within,
        };
        for (i, truth) in truth.data.iter().enumerate() {
            let values: Vec<f64> = draws.iter().map(|d| d.light.data[i].into()).collect();
            let deviations = || draws.iter().map(|d| f64::from(d.deviation.data[i]));
            let centre = mean(&values);
            let rms = |sum: f64| sum.sqrt();
            let squares: f64 = values.iter().map(|v| (v - centre).powi(2)).sum();
            spread.between.push(rms(squares / (n - 1.0)));
            let errors = || values.iter().map(|v| v - f64::from(*truth));
            spread
                .error
                .push(rms(errors().map(|e| e * e).sum::<f64>() / n));
            spread
                .predicted
                .push(rms(deviations().map(|d| d * d).sum::<f64>() / n));
            for (error, deviation) in errors().zip(deviations()) {
                (0..2).for_each(|k| {
                    let reach = (k + 1) as f64 * deviation;
                    within[k] += f64::from(u8::from(error.abs() <= reach));
                });
            }
        }
        spread.within = within.map(|count| count / (n * truth.data.len() as f64));
        spread
    }

    fn ratio(of: &[f64], to: &[f64]) -> f64 {
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
        (square(of) / square(to)).sqrt()
    }
}

fn evidence(bench: &Bench<'_>, spread: &Spread, draws: &[Draw]) -> Evidence {
    let noise = Spread::ratio(&spread.between, &spread.predicted);
    let light = Spread::ratio(&spread.error, &spread.predicted);
    let over = |of: &dyn Fn(&Draw) -> f64| mean(&draws.iter().map(of).collect::<Vec<_>>());
    let albedo = over(&|d| d.albedo_error) / over(&|d| d.albedo_deviation);
    let masks = over(&|d| d.mask_error) / over(&|d| d.mask_deviation);
    let pairs = |of: &[f64]| -> Vec<[f64; 2]> {
        let pairs = spread.predicted.iter().zip(of);
        pairs.map(|(x, y)| [*x, *y]).collect()
    };
    let correlation = rank_correlation(&pairs(&spread.error));
    let between = rank_correlation(&pairs(&spread.between));
    let cost = over(&|d| d.cost);
    let parts = [
        honest(light),
        honest(albedo),
        honest(masks),
        correlation > CORRELATED,
    ];
    let known = [over(&|d| d.known[0]), over(&|d| d.known[1])];
    let why = why([light, albedo, masks], correlation, known);
    let setup = Setup::of(bench.scale);
    Evidence {
        name: "uncertainty",
        title: "Standard deviations against errors",
        source: "Beyond the paper",
        claim: "What a reconstruction says of its own errors is of their size, and large where they are.",
        verdict: Verdict::of(&parts),
        sentence: format!(
            "over {} draws of noise and seeds errors of the light are {} of what was predicted (RMS), of the albedo {}, of the masks \
             {}; {} % and {} % of errors lie within one and two deviations (68 and 95 for a normal distribution); the rank \
             correlation of errors and deviations over directions is {}; noise and seeds alone spread by {} of the prediction; it \
             took {} % of the solve's time.{why}",
            draws.len(),
            number(light),
            number(albedo),
            number(masks),
            number(100.0 * spread.within[0]),
            number(100.0 * spread.within[1]),
            number(correlation),
            number(noise),
            number(100.0 * cost),
        ),
        numbers: json!({
            "draws": draws.len(),
            "light_error_over_predicted": light,
            "light_spread_over_predicted": noise,
            "albedo_error_over_predicted": albedo,
            "mask_error_over_predicted": masks,
            "within_one_deviation": spread.within[0],
            "within_two_deviations": spread.within[1],
            "rank_correlation_of_error": correlation,
            "rank_correlation_of_spread": between,
            "share_of_solve_time": cost,
            "known_numbers": known[0],
            "known_numbers_at_most": known[1],
        }),
        figures: figures(spread, draws),
        notes: vec![
            format!(
                "Three balls, matt, {} photographs of {} x {} pixels with somebody in the light, {} steps of the fast preset; the \
                 noise of the photographs and the seed of the solver change from draw to draw, the scene does not. The spread of \
                 draws is less than the deviation where photographs say little: there every draw returns to what was assumed.",
                setup.frames,
                setup.resolution,
                setup.resolution,
                steps(bench)
            ),
            "Laplace's approximation at the solve's end: covariance (1 + A)⁻¹ in units of the prior, A by Lanczos' iteration on the \
             tape's products. Light is compared in the truth's scale, one factor a channel; deviations include what is not known of \
             that factor."
                .into(),
        ],
    }
}

/// Whether errors are of the size of deviations.
fn honest(ratio: f64) -> bool {
    (HONEST..=1.0 / HONEST).contains(&ratio)
}

/// What failed, by the ratios of errors and deviations of light, albedo and masks, and what was measured that explains it.
fn why(ratios: [f64; 3], correlation: f64, known: [f64; 2]) -> String {
    let mut not = Vec::new();
    for (what, ratio) in ["light", "albedo", "masks"].into_iter().zip(ratios) {
        if !honest(ratio) {
            let size = if ratio < HONEST {
                "less than half of"
            } else if ratio > 1.0 / HONEST {
                "more than twice"
            } else {
                "not comparable with"
            };
            not.push(format!(
                "errors of the {what} are {size} what was predicted"
            ));
        }
    }
    let placed = correlation > CORRELATED;
    if !placed {
        not.push("errors of the light are not where deviations are large".to_owned());
    }
    if not.is_empty() {
        return String::new();
    }
    // A short solve counts what it had no time to find as unknown.
    let unfinished = known[1] > UNFINISHED * known[0];
    let smaller = ratios.iter().any(|ratio| *ratio < HONEST);
    let cause = match smaller && unfinished {
        true => format!(
            "deviations are too large where a solve had no time to find what is known: {} numbers were, up to {} may be",
            number(known[0]),
            number(known[1])
        ),
        false => "the cause was not found; deviations know nothing of what the model leaves out"
            .to_owned(),
    };
    format!(" Not so: {}; {cause}.", not.join(", "))
}

fn figures(spread: &Spread, draws: &[Draw]) -> Vec<Figure> {
    let dots = |of: &[f64]| -> Vec<[f64; 2]> {
        spread
            .predicted
            .iter()
            .zip(of)
            .step_by(7)
            .map(|(x, y)| [*x, *y])
            .collect()
    };
    let all = || {
        spread
            .predicted
            .iter()
            .chain(&spread.error)
            .copied()
            .filter(|v| *v > 0.0)
    };
    let range = [
        all().fold(f64::INFINITY, f64::min).max(1e-4),
        1.2 * all().fold(0.0, f64::max),
    ];
    let map = |label: &str, values: &[f64]| {
        let first = &draws[0].light;
        let grey = values.chunks_exact(3).map(|v| (mean(v)) as f32).collect();
        let high = spread.predicted.iter().copied().fold(0.0, f64::max) as f32;
        Picture {
            label: label.to_owned(),
            values: Image {
                width: first.width,
                height: first.height,
                channels: 1,
                data: grey,
            },
            tone: Tone::Heat {
                low: 0.0,
                high: 0.5 * high,
            },
        }
    };
    vec![
        Figure {
            name: "errors-over-deviations".into(),
            caption: "Every seventh value of the map of light: RMS error, and spread over draws, over the predicted deviation.".into(),
            content: Content::Chart(Chart {
                x: Axis::logarithmic("predicted deviation", range),
                y: Axis::logarithmic("error or spread", range),
                series: vec![
                    Series::dots("error", dots(&spread.error)),
                    Series::dots("spread", dots(&spread.between)),
                    Series::line("equal", vec![[range[0]; 2], [range[1]; 2]]),
                ],
            }),
        },
        Figure {
            name: "maps".into(),
            caption: "Predicted deviation, RMS error and spread over draws; one scale, mean over channels.".into(),
            content: Content::Pictures(vec![
                map("predicted", &spread.predicted),
                map("error", &spread.error),
                map("spread", &spread.between),
            ]),
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_follow_what_was_measured() {
        assert_eq!(why([1.0, 0.6, 1.9], 0.5, [10.0, 10.0]), "");
        let large = why([3.0, 1.0, 1.0], 0.5, [10.0, 90.0]);
        assert!(large.contains("light are more than twice what"), "{large}");
        assert!(large.contains("the cause was not found"), "{large}");
        let small = why([1.0, 1.0, 0.2], 0.1, [10.0, 90.0]);
        assert!(
            small.contains("masks are less than half of what"),
            "{small}"
        );
        assert!(small.contains("not where deviations"), "{small}");
        assert!(small.contains("up to 90 may be"), "{small}");
        assert!(!why([f64::NAN, 1.0, 1.0], 0.5, [1.0; 2]).is_empty());
    }
}
