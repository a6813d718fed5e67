//! Whether standard deviations are of the size of errors: against the spread over draws of noise and seeds, and the truth.

mod edges;
mod misplaced;
mod spread;
mod truths;

use render::{image::Image, lat_long::LatLong};
use serde_json::{Map, Value, json};

use self::{
    edges::Edges,
    misplaced::Misplaced,
    spread::{Failure, Kind, Spread, Values},
    truths::Truths,
};
use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone, but, listed, mean},
    small::{Setup, settings, steps},
    trial::{Solved, Trial},
};
use crate::{reconstruction::Uncertainty, report::text::number};

/// Draws of noise, and seeds of the solver with them: at a glance, quick, in full.
const DRAWS: [u64; 3] = [2, 5, 12];
/// Where so many times as many numbers may be known as were found to be, solves were too short for their deviations.
const UNFINISHED: f64 = 1.5;
/// Where masks truly block less, and deviate by less in every draw, they are not compared.
const DOUBT: f32 = 0.01;
/// The quantity whose errors are looked at beside rims as well.
const ALBEDO: &str = "albedo";
/// Most dots of a figure.
const DOTS: usize = 2000;

/// The study.
pub(super) struct Uncertain;

impl Study for Uncertain {
    fn name(&self) -> &'static str {
        "uncertainty"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let mut first = None;
        let draws = bench.each(0..bench.of_scale(DRAWS), |seed| {
            let setup = Setup {
                seed,
                ..Setup::of(bench.scale)
            };
            let (trial, draw) = draw(bench, setup, &format!("draw {seed}"))?;
            // Noise differs from draw to draw, the truth does not.
            first.get_or_insert(trial);
            Ok(draw)
        })?;
        // One draw has no spread.
        match first {
            Some(trial) if draws.len() > 1 => {
                let quantities = Quantity::all(&trial, &draws);
                let albedo = &quantities[1].spread;
                let edges = Edges::new(albedo, &trial)?;
                let truths = Truths::new(bench, &trial, &draws, albedo)?;
                let misplaced = Misplaced::new(albedo, edges, truths);
                Ok(evidence(bench, &quantities, &draws, &misplaced))
            }
            _ => Err(bench.nothing("at least two draws")),
        }
    }
}

/// A capture, and what comes of it with its seed of noise for the solver as well.
fn draw(bench: &Bench<'_>, setup: Setup, label: &str) -> Result<(Trial, Draw), StudyError> {
    let trial = setup.trial(bench, "balls")?;
    let settings = settings(bench, &trial, setup.seed);
    let solved = bench.reconstructed(&trial, label, &settings)?;
    let draw = Draw::new(&trial, &solved)?;
    Ok((trial, draw))
}

/// One draw of noise and what came of it.
struct Draw {
    light: Values,
    /// Through all cameras, one after the other.
    albedo: Values,
    /// Of all frames, one after the other.
    masks: Values,
    /// Share of the solve's time.
    cost: f64,
    /// Numbers known from the photographs: found to be, and at most.
    known: [f64; 2],
}

impl Draw {
    fn new(trial: &Trial, solved: &Solved) -> Result<Self, StudyError> {
        let doubt = solved.found.uncertainty.as_ref();
        // A run that ends in time leaves them but for who stops it meanwhile.
        let doubt = doubt.ok_or(StudyError::Stopped)?;
        let solving = solved.found.curve.last().map_or(f64::NAN, |p| p.seconds);
        let albedo = doubt.albedo.iter().flat_map(|image| &image.data);
        let draw = Self {
            light: Values {
                found: solved.found.environment.data.clone(),
                deviation: doubt.environment.data.clone(),
            },
            albedo: Values {
                found: (0..trial.capture.frames.len())
                    .flat_map(|frame| solved.own_albedo_through(frame).data)
                    .collect(),
                deviation: albedo.copied().collect(),
            },
            masks: masks(trial, solved, doubt),
            cost: doubt.summary.seconds / solving,
            known: [doubt.summary.known, doubt.summary.known_at_most],
        };
        let whole = [&draw.light, &draw.albedo, &draw.masks]
            .iter()
            .all(|values| values.found.len() == values.deviation.len());
        match whole {
            true => Ok(draw),
            false => Err(StudyError::Nothing("standard deviations of every value")),
        }
    }
}

/// Masks and their deviations; where none were found light passes for certain.
fn masks(trial: &Trial, solved: &Solved, doubt: &Uncertainty) -> Values {
    let joined = |images: &[Image], none: f32| match images.is_empty() {
        true => vec![none; trial.capture.frames.len() * trial.light.width * trial.light.height],
        false => images.iter().flat_map(|i| &i.data).copied().collect(),
    };
    Values {
        found: joined(&solved.found.occluders, 1.0),
        deviation: joined(&doubt.occluders, 0.0),
    }
}

/// What deviations are of, and how a part of it is shown.
struct Quantity {
    spread: Spread,
    /// Width, height and channels of the first image.
    shape: [usize; 3],
    /// What that shows.
    shown: &'static str,
}

impl Quantity {
    /// Light, albedo and masks.
    fn all(trial: &Trial, draws: &[Draw]) -> [Self; 3] {
        let light = &trial.light;
        let grid = LatLong::new(light.height, light.width);
        let of = |of: fn(&Draw) -> &Values| draws.iter().map(of).collect::<Vec<_>>();
        let masks = trial.truth.occluders.as_deref().unwrap_or_default();
        let dark = light.data.chunks_exact(3).enumerate().map(|(texel, rgb)| {
            f64::from(grid.solid_angle(texel / grid.columns) * rgb.iter().sum::<f32>())
        });
        let dark: Vec<f64> = dark.collect();
        let blocked: Vec<f32> = masks.iter().flat_map(|mask| &mask.data).copied().collect();
        // Of most directions nobody doubts that light passes: they would outweigh all others.
        let doubtful = |i: usize| {
            blocked[i] < 1.0 - DOUBT || draws.iter().any(|d| d.masks.deviation[i] > DOUBT)
        };
        let weights = (0..blocked.len()).map(|i| match doubtful(i) {
            true => dark[i % dark.len()],
            false => 0.0,
        });
        let weights: Vec<f64> = weights.collect();
        let frame = trial.truth.albedo.first().map(|truth| &truth.albedo);
        let frame = frame.map_or([0, 0, 3], |image| [image.width, image.height, 3]);
        [
            Self {
                spread: Spread::new(
                    "light",
                    &light.data,
                    vec![1.0; light.data.len()],
                    &of(|d| &d.light),
                ),
                shape: [light.width, light.height, 3],
                shown: "the map of light",
            },
            Self {
                spread: albedo_spread(trial, &of(|d| &d.albedo)),
                shape: frame,
                shown: "the first photograph's albedo",
            },
            Self {
                spread: Spread::new("masks", &blocked, weights, &of(|d| &d.masks)),
                shape: [light.width, light.height, 1],
                shown: "the first photograph's mask",
            },
        ]
    }
}

/// Of what each pixel of all photographs sees, where the object covers it wholly.
fn albedo_spread(trial: &Trial, draws: &[&Values]) -> Spread {
    let truth = || trial.truth.albedo.iter();
    let albedo: Vec<f32> = truth()
        .flat_map(|truth| &truth.albedo.data)
        .copied()
        .collect();
    let object = truth().flat_map(|truth| &truth.object);
    let object = object.flat_map(|&object| [f64::from(u8::from(object)); 3]);
    Spread::new(ALBEDO, &albedo, object.collect(), draws)
}

fn evidence(
    bench: &Bench<'_>,
    quantities: &[Quantity; 3],
    draws: &[Draw],
    misplaced: &Misplaced,
) -> Evidence {
    let over = |of: &dyn Fn(&Draw) -> f64| mean(&draws.iter().map(of).collect::<Vec<_>>());
    let cost = over(&|d| d.cost);
    let known = [over(&|d| d.known[0]), over(&|d| d.known[1])];
    let spreads = || quantities.iter().map(|quantity| &quantity.spread);
    let parts: Vec<bool> = spreads().flat_map(Spread::parts).collect();
    let words: Vec<String> = spreads().map(Spread::words).collect();
    let failures: Vec<(&str, Failure)> = spreads()
        .flat_map(|spread| spread.failures().into_iter().map(|f| (spread.name, f)))
        .collect();
    let setup = Setup::of(bench.scale);
    Evidence {
        name: "uncertainty",
        title: "Standard deviations against errors",
        source: "Beyond the paper",
        claim: "What a reconstruction says of its own errors, of light, albedo and masks, is of their size, is no less than what another \
                draw of noise changes, and is large where they are.",
        verdict: Verdict::of(&parts),
        sentence: format!(
            "errors of {} are {} times as large as was predicted (RMS, {} draws of noise and seeds), and {} % lie within two standard \
             deviations, of a normal distribution 95 %.{}",
            listed_names(spreads()),
            listed(&spreads().map(Spread::size).collect::<Vec<_>>()),
            draws.len(),
            listed(&spreads().map(|s| 100.0 * s.within[1]).collect::<Vec<_>>()),
            why(&failures, known, misplaced)
        ),
        numbers: numbers(spreads(), draws.len(), cost, known, misplaced),
        figures: quantities.iter().flat_map(figures).collect(),
        details: vec![format!(
            "{}. For a normal distribution 68 and 95 % lie within one and two deviations. They took {} % of the solve's time.",
            words.join(". "),
            number(100.0 * cost)
        )],
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
             tape's products. Light and albedo are compared as they were found, without a best scale: how bright the one is and how dark \
             the other is a part of what is not known. Directions count alike for the light; for masks by the true light from them and their solid angle, \
             where something truly blocks a hundredth of it or the deviation is above 0.01 in some draw; \
             for the albedo every pixel that the object covers wholly. Rank correlations (Spearman) are over values of which some deviation is predicted."
                .into(),
        ],
    }
}

fn numbers<'a>(
    spreads: impl Iterator<Item = &'a Spread>,
    draws: usize,
    cost: f64,
    known: [f64; 2],
    misplaced: &Misplaced,
) -> Value {
    let mut numbers = Map::new();
    numbers.insert("draws".into(), json!(draws));
    for spread in spreads {
        for (what, value) in [
            ("error_over_predicted", spread.size()),
            ("spread_over_predicted", spread.noise()),
            ("within_one_deviation", spread.within[0]),
            ("within_two_deviations", spread.within[1]),
            ("rank_correlation_of_error", spread.place()),
            ("rank_correlation_of_spread", spread.place_of_noise()),
        ] {
            numbers.insert(format!("{}_{what}", spread.name), json!(value));
        }
    }
    let edges = &misplaced.edges;
    for (what, value) in [
        ("share_of_pixels_at_edges", edges.shares[0]),
        ("share_of_squared_error_at_edges", edges.shares[1]),
        ("rank_correlation_of_error_elsewhere", edges.elsewhere),
        ("rank_correlation_if_drawn", misplaced.drawn),
    ] {
        numbers.insert(format!("{ALBEDO}_{what}"), json!(value));
    }
    if let Some(truths) = &misplaced.truths {
        numbers.insert("scenes".into(), json!(truths.scenes));
        numbers.insert(
            "albedo_rank_correlation_over_scenes".into(),
            json!(truths.place),
        );
    }
    numbers.insert("share_of_solve_time".into(), json!(cost));
    numbers.insert("known_numbers".into(), json!(known[0]));
    numbers.insert("known_numbers_at_most".into(), json!(known[1]));
    Value::Object(numbers)
}

/// What is compared: `light, albedo, masks`.
fn listed_names<'a>(spreads: impl Iterator<Item = &'a Spread>) -> String {
    spreads
        .map(|spread| spread.name)
        .collect::<Vec<_>>()
        .join(", ")
}

/// What failed of which quantity, each with what was measured that explains it.
fn why(failures: &[(&str, Failure)], known: [f64; 2], misplaced: &Misplaced) -> String {
    let parts = failures.iter().map(|(name, failure)| {
        format!(
            "{} ({})",
            failure.words,
            cause(name, failure.kind, known, misplaced)
        )
    });
    let parts: Vec<(String, bool)> = parts.map(|words| (words, false)).collect();
    but(&parts)
}

fn cause(name: &str, kind: Kind, known: [f64; 2], misplaced: &Misplaced) -> String {
    match kind {
        // A short solve counts what it had no time to find as unknown.
        Kind::Small if known[1] > UNFINISHED * known[0] => format!(
            "deviations are too large where a solve had no time to find what is known: {} numbers were, up to {} may be",
            number(known[0]),
            number(known[1])
        ),
        Kind::Misplaced if name == ALBEDO => misplaced.why(),
        _ => "the cause was not found; deviations know nothing of what the model leaves out"
            .to_owned(),
    }
}

/// Errors and spread over deviations, and where they are.
fn figures(quantity: &Quantity) -> [Figure; 2] {
    let spread = &quantity.spread;
    let dots = |of: &[f64]| -> Vec<[f64; 2]> {
        let pairs = spread.pairs(of);
        let every = pairs.len() / DOTS + 1;
        let some = pairs.into_iter().step_by(every);
        // A logarithm of nothing cannot be drawn.
        some.filter(|pair| pair[1] > 0.0).collect()
    };
    let (errors, between) = (dots(&spread.error), dots(&spread.between));
    let all = || errors.iter().chain(&between).flatten().copied();
    let range = [
        all().fold(f64::INFINITY, f64::min).max(1e-4),
        1.2 * all().fold(0.0, f64::max),
    ];
    let most = spread.predicted.iter().copied().fold(1e-12, f64::max);
    let high = 0.5 * most as f32;
    let [width, height, channels] = quantity.shape;
    let map = |label: &str, values: &[f64]| {
        let values = values.chunks_exact(channels).take(width * height);
        Picture {
            label: label.to_owned(),
            values: Image {
                width,
                height,
                channels: 1,
                data: values.map(|v| mean(v) as f32).collect(),
            },
            tone: Tone::Heat { low: 0.0, high },
        }
    };
    [
        Figure {
            name: format!("{}-errors-over-deviations", spread.name),
            caption: format!(
                "RMS error of the {}, and its spread over draws, over the predicted deviation; some of all values.",
                spread.name
            ),
            content: Content::Chart(Chart {
                x: Axis::logarithmic("predicted deviation", range),
                y: Axis::logarithmic("error or spread", range),
                series: vec![
                    Series::dots("error", errors.clone()),
                    Series::dots("spread", between.clone()),
                    Series::line("equal", vec![[range[0]; 2], [range[1]; 2]]),
                ],
            }),
        },
        Figure {
            name: format!("{}-maps", spread.name),
            caption: format!(
                "Of {}: predicted deviation, RMS error and spread over draws; one scale, mean over channels.",
                quantity.shown
            ),
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
    fn each_failure_is_told_with_its_own_cause() {
        let misplaced = Misplaced {
            edges: Edges {
                shares: [0.1, 0.6],
                elsewhere: 0.5,
            },
            drawn: 0.2,
            truths: None,
        };
        let told = |failures: &[(&'static str, Kind)], known| {
            let failures = failures.iter().map(|&(name, kind)| {
                let words = format!("errors of the {name} are wrong");
                (name, Failure { kind, words })
            });
            why(&failures.collect::<Vec<_>>(), known, &misplaced)
        };
        assert_eq!(told(&[], [10.0, 90.0]), "");
        let short = told(&[("masks", Kind::Small)], [10.0, 90.0]);
        assert!(
            short.starts_with(" But errors of the masks are wrong (")
                && short.contains("up to 90 may be"),
            "{short}"
        );
        let long = told(&[("masks", Kind::Small)], [10.0, 11.0]);
        assert!(long.contains("the cause was not found"), "{long}");
        let two = told(
            &[(ALBEDO, Kind::Misplaced), ("light", Kind::Misplaced)],
            [10.0, 90.0],
        );
        let (albedo, light) = two.split_once("; errors of the light").unwrap();
        assert!(albedo.contains("beside rims and contacts"), "{two}");
        assert!(light.contains("the cause was not found"), "{two}");
    }
}
