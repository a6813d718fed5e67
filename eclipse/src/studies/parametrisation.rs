//! Table 1 and Fig. 10: what light and masks are parametrised by, in the paper's own algorithm.

mod claims;

use serde_json::{Map, Value, json};

use self::claims::{Claim, claims, in_short, untested};
use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, listed, mean, range, seeds},
    small::{BATCH, Object, Setup, iterations, misfit, paper_settings},
    trial::Trial,
};
use crate::{
    evaluate::occluders,
    image_io::white,
    report::text::number,
    settings::{LightForm, MaskForm, Settings},
};

/// What is compared on every object.
const TABLE: [Variant; 4] = [
    Variant::Full,
    Variant::FreeMasks,
    Variant::FreeLight,
    Variant::NoMasks,
];
/// What is looked at on the first object alone, beside degrees of the harmonics.
const ALONE: [Variant; 4] = [
    Variant::ShortSteps,
    Variant::Ratio(0.5),
    Variant::Bias(0.0),
    Variant::Bias(100.0),
];
/// Degrees of the harmonics below the paper's.
const DEGREES: [&[usize]; 3] = [&[4], &[4, 12], &[2, 4, 8, 12, 16, 20]];

/// The study.
pub(super) struct Parametrisation;

impl Study for Parametrisation {
    fn name(&self) -> &'static str {
        "parametrisation"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let kinds = kinds(bench);
        let mut pictures = Vec::new();
        // Seed by seed, so that a stop leaves as many of each.
        let found = bench.each(bench.seeds(), |seed| {
            let mut scores = Vec::new();
            for (object, variants) in &kinds {
                let setup = Setup {
                    object: *object,
                    scene: seed,
                    seed,
                    ..Setup::noisy(bench.scale)
                };
                let trial = setup.trial(bench, object.name())?;
                for variant in variants {
                    // The pictures are of the first capture.
                    let shown = seed == 0 && *object == Object::ALL[0] && TABLE.contains(variant);
                    let pictures = shown.then_some(&mut pictures);
                    scores.push(variant.solve(bench, &trial, &setup, pictures)?);
                }
                if seed == 0 && *object == Object::ALL[0] {
                    pictures.push(Picture::light("truth", &trial.light, white([&trial.light])));
                }
            }
            Ok(scores)
        })?;
        let all = kinds
            .iter()
            .flat_map(|(object, variants)| variants.iter().map(|&variant| (*object, variant)));
        let rows = all.enumerate().map(|(index, (object, variant))| Row {
            object,
            variant,
            scores: found.iter().map(|of_seed| of_seed[index]).collect(),
        });
        Ok(evidence(bench, &rows.collect::<Vec<_>>(), pictures))
    }
}

/// Which variants are solved of which object.
fn kinds(bench: &Bench<'_>) -> Vec<(Object, Vec<Variant>)> {
    let degrees = bench.of_scale(DEGREES).iter().map(|&d| Variant::Degree(d));
    let mut beside: Vec<Variant> = ALONE.into_iter().chain(degrees).collect();
    let of = |object| {
        // What is left beside the table goes to the first object.
        let variants = TABLE.into_iter().chain(std::mem::take(&mut beside));
        (object, variants.collect())
    };
    Object::ALL.into_iter().map(of).collect()
}

/// The paper's model, or what is changed of it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Variant {
    Full,
    /// A free logit for every texel and frame.
    FreeMasks,
    /// A free logarithm of radiance for every texel.
    FreeLight,
    /// The same with steps as long as the learning rate and not as those of the pyramid's finest level.
    ShortSteps,
    /// Another ratio a of the pyramid's levels.
    Ratio(f64),
    /// Another degree of the harmonics.
    Degree(usize),
    /// Another logit of masks at the start.
    Bias(f64),
    /// Occluders are not modelled.
    NoMasks,
}

impl Variant {
    fn words(self) -> String {
        match self {
            Self::Full => "full model".into(),
            Self::FreeMasks => "free masks".into(),
            Self::FreeLight => "free light".into(),
            Self::ShortSteps => "free light in short steps".into(),
            Self::Ratio(ratio) => format!("a = {}", number(ratio)),
            Self::Degree(degree) => format!("degree {degree}"),
            Self::Bias(bias) => format!("initial bias {}", number(bias)),
            Self::NoMasks => "no occluders".into(),
        }
    }

    fn settings(self, mut settings: Settings) -> Settings {
        let chosen = &mut settings.parametrisation;
        match self {
            Self::Full => (),
            Self::FreeMasks => chosen.masks = MaskForm::Texels,
            Self::FreeLight => chosen.light = LightForm::Texels,
            Self::ShortSteps => {
                chosen.light = LightForm::Texels;
                chosen.level_ratio = 1.0;
            }
            Self::Ratio(ratio) => chosen.level_ratio = ratio,
            Self::Degree(degree) => settings.harmonic_degree = degree,
            Self::Bias(bias) => chosen.mask_logit = bias,
            Self::NoMasks => settings.occluders = false,
        }
        settings
    }

    /// What comes of a capture; its light goes to `pictures`, if they are given.
    fn solve(
        self,
        bench: &Bench<'_>,
        trial: &Trial,
        setup: &Setup,
        pictures: Option<&mut Vec<Picture>>,
    ) -> Result<Scores, StudyError> {
        let settings = self.settings(paper_settings(bench, trial, setup.seed));
        let words = format!("{}, {}, seed {}", trial.name, self.words(), setup.seed);
        let solved = bench.reconstructed(trial, &words, &settings)?;
        if let Some(pictures) = pictures {
            let white = white([&trial.light]);
            pictures.push(Picture::light(self.words(), &solved.light(), white));
        }
        let truth = trial.truth.occluders.as_deref().unwrap_or_default();
        let scaled = occluders::compare_scaled(&solved.found.occluders, truth, &trial.light)?;
        let as_found = solved.scores.occluders;
        Ok(Scores {
            light: solved.environment_error(),
            albedo: solved.albedo(),
            overlap: as_found.iou.unwrap_or(f64::NAN),
            masks: scaled.map_or(f64::NAN, |scaled| scaled.error),
            factor: scaled.map_or(f64::NAN, |scaled| scaled.factor),
            as_found: as_found.energy_weighted_error.unwrap_or(f64::NAN),
            misfit: misfit(trial, setup, &solved),
            constant: trial.constant_error(),
        })
    }
}

/// How far from the truth a solve ended.
#[derive(Clone, Copy, Debug, Default)]
struct Scores {
    /// Relative RMSE of the light.
    light: f64,
    /// Decibels.
    albedo: f64,
    /// Of masks with the true ones, intersection over union.
    overlap: f64,
    /// The light that masks get wrong over the light that is blocked, after the best factor common to them.
    masks: f64,
    /// That factor: light is as much too bright.
    factor: f64,
    /// The same as `masks` as they were found.
    as_found: f64,
    /// See [`misfit`].
    misfit: f64,
    /// Relative RMSE of the best constant map.
    constant: f64,
}

/// Scores of a variant on an object, a seed each.
struct Row {
    object: Object,
    variant: Variant,
    scores: Vec<Scores>,
}

impl Row {
    fn list(&self, of: fn(&Scores) -> f64) -> Vec<f64> {
        self.scores.iter().map(of).collect()
    }

    fn mean(&self, of: fn(&Scores) -> f64) -> f64 {
        mean(&self.list(of))
    }

    fn lights(&self) -> Vec<f64> {
        self.list(|s| s.light)
    }

    fn light(&self) -> f64 {
        self.mean(|s| s.light)
    }
}

/// The row of a variant on an object; `rows` hold every variant of [`TABLE`] on every object.
fn row(rows: &[Row], object: Object, variant: Variant) -> Option<&Row> {
    rows.iter()
        .find(|row| row.object == object && row.variant == variant)
}

fn evidence(bench: &Bench<'_>, rows: &[Row], pictures: Vec<Picture>) -> Evidence {
    let claims = claims(rows);
    let held: Vec<Option<bool>> = claims.iter().flat_map(Claim::outcomes).collect();
    let said: Vec<String> = claims.iter().map(|claim| claim.words()).collect();
    let setup = Setup::noisy(bench.scale);
    let mut figures = vec![table(rows), degrees(rows)];
    figures.push(Figure {
        name: "light".into(),
        caption: "The light of the balls, first seed, after the best scale of each channel: the paper's model, free masks, free light, no \
                  occluders, and the truth."
            .into(),
        content: Content::Pictures(pictures),
    });
    Evidence {
        name: "parametrisation",
        title: "What light and masks are parametrised by",
        source: "Verbin et al. 2024, Table 1 and Fig. 10",
        claim: "Spherical harmonics before a sigmoid are a better parametrisation of masks than a free value for every texel, and a \
                pyramid of levels is a better one of light; levels are better weighted by a = 2 than by a = 1/2, harmonics of high degree \
                do as well as those of low degree or better, and masks that start near one do better than masks that start at one half.",
        verdict: Verdict::of_all(&held),
        sentence: format!(
            "{} (better by the light's error, in every seed). {}.",
            in_short(&claims),
            full_model(rows)
        ),
        numbers: numbers(rows),
        figures,
        details: vec![
            said.into_iter().chain(untested(rows)).collect::<Vec<_>>().join("; ") + ".",
            format!("Relative RMSE of the light, a seed each: {}.", measured(rows)),
        ],
        notes: vec![
            format!(
                "Four matt objects under six lamps, {} photographs of {} x {} pixels with noise of {} and somebody in the light; {} for lamps, noise and \
                 solver alike. The paper's algorithm on a small scale: {} iterations of {} pixels with {} rays each, where the paper has \
                 2^16 pixels and 1024 rays. Learning rates are the paper's, 3e-3 of light and 1 of masks, lowered by the square root of \
                 the batch; they are the same in every variant. A variant counts as better only where its error is lower in every seed; one that is \
                 slower is worse.",
                setup.frames,
                setup.resolution,
                setup.resolution,
                number(setup.noise.into()),
                seeds(bench.seeds().end),
                iterations(bench),
                BATCH.pixels,
                BATCH.rays
            ),
            "Free masks: a logit for every texel and photograph in place of harmonics. Free light: a logarithm of radiance for every texel, \
             with the weight that the pyramid's finest level has (2^5), so that Adam's steps are as long as there; in short steps the \
             weight is 1, and steps are as long as the learning rate. Both start as the full model does, and neither has a prior."
                .into(),
            format!(
                "The full model has harmonics of degree 24, a = 2, and masks that start at a logit of 5: the paper's bias of 100 has no \
                 gradient in single precision. What is beside the table was looked at on the {} alone. Mask error: the light that masks get \
                 wrong over the light that is truly blocked; no mask at all scores 1. It is taken after the best factor common to all masks, as photographs \
                 cannot tell masks that let through half as much from half the light, and the light's error is taken after its best scale. Misfit: the variance of what is left of the \
                 photographs over that of their noise.",
                Object::ALL[0].name()
            ),
        ],
    }
}

/// How good the full model is at all: its masks, and its light against that without any.
fn full_model(rows: &[Row]) -> String {
    let of = |variant: Variant, of: fn(&Scores) -> f64| {
        let those = rows.iter().filter(|row| row.variant == variant);
        let means: Vec<f64> = those.map(|row| row.mean(of)).collect();
        match range(&means).map(number) {
            [low, high] if low == high => low,
            [low, high] => format!("{low} to {high}"),
        }
    };
    format!(
        "The full model's masks get {} times as much light wrong as is blocked (none at all 1; after the best factor common to them, which is {}); its \
         light is off by {}, without occluders in the model by {}, the best constant map by {}",
        of(Variant::Full, |s| s.masks),
        of(Variant::Full, |s| s.factor),
        of(Variant::Full, |s| s.light),
        of(Variant::NoMasks, |s| s.light),
        of(Variant::Full, |s| s.constant)
    )
}

/// Errors of the light of every variant, object by object.
fn measured(rows: &[Row]) -> String {
    let of = |object: Object| {
        let own: Vec<&Row> = rows.iter().filter(|r| r.object == object).collect();
        let errors: Vec<String> = own
            .iter()
            .map(|row| format!("{} {}", row.variant.words(), listed(&row.lights())))
            .collect();
        let constant = own.first().map_or(f64::NAN, |row| row.mean(|s| s.constant));
        format!(
            "{}: {} (the best constant map {})",
            object.name(),
            errors.join("; "),
            number(constant)
        )
    };
    Object::ALL.map(of).join(". ")
}

fn numbers(rows: &[Row]) -> Value {
    let of = |object: Object| {
        let own = rows.iter().filter(|r| r.object == object);
        let table: Map<String, Value> = own
            .map(|row| {
                let numbers = json!({
                    "environment_relative_rmse": row.lights(),
                    "albedo_psnr": row.list(|s| s.albedo),
                    "mask_iou": row.list(|s| s.overlap),
                    "mask_error": row.list(|s| s.masks),
                    "mask_factor": row.list(|s| s.factor),
                    "mask_error_as_found": row.list(|s| s.as_found),
                    "misfit": row.list(|s| s.misfit),
                    "map_of_one_value": row.list(|s| s.constant),
                });
                (row.variant.words(), numbers)
            })
            .collect();
        (object.name().to_owned(), Value::Object(table))
    };
    Value::Object(Object::ALL.map(of).into_iter().collect())
}

/// A dot a seed, object by object.
fn table(rows: &[Row]) -> Figure {
    let of = |variant: Variant| {
        let objects = Object::ALL.into_iter().enumerate();
        let errors = objects.map(|(place, object)| {
            let errors = row(rows, object, variant).map_or_else(Vec::new, Row::lights);
            (place as f64 + 1.0, errors)
        });
        Series::dots_by_seed(&variant.words(), errors)
    };
    let names: Vec<String> = Object::ALL
        .iter()
        .enumerate()
        .map(|(place, object)| format!("{} {}", place + 1, object.name()))
        .collect();
    let all = rows.iter().filter(|row| TABLE.contains(&row.variant));
    let worst = all.flat_map(Row::lights).fold(0.0, f64::max);
    Figure {
        name: "table".into(),
        caption: "Relative RMSE of the light on each object, a dot a seed.".into(),
        content: Content::Chart(Chart {
            x: Axis::linear(
                format!("object: {}", names.join(", ")),
                [0.5, Object::ALL.len() as f64 + 0.5],
            ),
            y: Axis::linear("relative RMSE of the light", [0.0, 1.1 * worst]),
            series: TABLE.into_iter().flat_map(of).collect(),
        }),
    }
}

/// Over the degree of the harmonics, on the first object.
fn degrees(rows: &[Row]) -> Figure {
    let own: Vec<&Row> = rows.iter().filter(|r| r.object == Object::ALL[0]).collect();
    let of_degrees = own
        .iter()
        .filter_map(|row| Some((degree(row.variant)? as f64, *row)));
    let mut of_degrees: Vec<(f64, &Row)> = of_degrees.collect();
    of_degrees.sort_by(|a, b| a.0.total_cmp(&b.0));
    let high = of_degrees.last().map_or(1.0, |(degree, _)| degree + 1.0);
    let means = of_degrees
        .iter()
        .map(|(degree, row)| [*degree, row.light()]);
    let of_seeds = of_degrees
        .iter()
        .map(|(degree, row)| (*degree, row.lights()));
    let level = |variant: Variant| {
        let row = own.iter().find(|row| row.variant == variant);
        let error = row.map_or(f64::NAN, |row| row.light());
        let label = format!("{}, mean", variant.words());
        Series::line(label, vec![[0.0, error], [high, error]])
    };
    let mut series = vec![Series::line("harmonics, mean", means.collect())];
    series.extend(Series::dots_by_seed("harmonics", of_seeds));
    series.extend([level(Variant::FreeMasks), level(Variant::NoMasks)]);
    let worst = own.iter().flat_map(|row| row.lights()).fold(0.0, f64::max);
    Figure {
        name: "degree".into(),
        caption: format!(
            "Relative RMSE of the light over the degree of the masks' harmonics on the {}: a dot a seed, and means as lines.",
            Object::ALL[0].name()
        ),
        content: Content::Chart(Chart {
            x: Axis::linear("degree", [0.0, high]),
            y: Axis::linear("relative RMSE of the light", [0.0, 1.1 * worst]),
            series,
        }),
    }
}

/// Of a variant's harmonics, where nothing else is changed.
fn degree(variant: Variant) -> Option<usize> {
    match variant {
        Variant::Full => Some(Settings::of(crate::settings::Preset::Paper).harmonic_degree),
        Variant::Degree(degree) => Some(degree),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Preset;

    #[test]
    fn every_variant_is_one_that_a_run_can_be_made_with_and_another() {
        let full = Settings::of(Preset::Paper);
        assert_eq!(Variant::Full.settings(full.clone()), full);
        let degrees = DEGREES.into_iter().flatten().map(|&d| Variant::Degree(d));
        let others = TABLE[1..].iter().chain(&ALONE).copied().chain(degrees);
        for variant in others {
            let settings = variant.settings(full.clone());
            settings.check().unwrap();
            assert_ne!(settings, full, "{variant:?}");
        }
    }

    #[test]
    fn free_light_takes_steps_as_long_as_the_finest_level_unless_it_takes_short_ones() {
        let chosen = |variant: Variant| variant.settings(Settings::of(Preset::Paper));
        let ratio = |variant| chosen(variant).parametrisation.level_ratio;
        assert_eq!(ratio(Variant::FreeLight), ratio(Variant::Full));
        assert_eq!(ratio(Variant::ShortSteps), 1.0);
    }
}
