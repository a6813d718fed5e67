//! S6: materials of shiny objects, on small captures of our own.

use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, listed, range, seeds},
    small::{KAPPA, Setup, settings},
    trial::{Solved, Trial},
};
use crate::{image_io::white, report::text::number, settings::Settings};

/// Roughness: the supplement's, and that of the paper's other objects.
const ALPHAS: [f32; 2] = [0.2, 0.6];
/// Steps of a reconstruction: the lobe is fitted anew in every round.
const STEPS: [u64; 3] = [1, 30, 30];
/// Largest error of α, relative, and of κ that count as recovered.
const CLOSE: [f64; 2] = [0.25, 0.02];

/// A relative RMSE of the light beyond which no highlight of it is known.
const BLURRED: f64 = 0.6;

/// The study.
pub(super) struct Shiny;

impl Study for Shiny {
    fn name(&self) -> &'static str {
        "shiny"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let rows = bench.each(ALPHAS, |alpha| Row::new(bench, alpha))?;
        Ok(evidence(bench, &rows))
    }
}

/// Photographs of a shiny object: from three times as many its lobe was found no better, in more than the time.
fn base(bench: &Bench<'_>) -> Setup {
    Setup {
        frames: Setup::BASE.frames.min(Setup::telling(bench.scale).frames),
        ..Setup::telling(bench.scale)
    }
}

struct Row {
    alpha: f64,
    /// The first seed's capture.
    shown: Trial,
    solved: Vec<Solved>,
}

impl Row {
    fn new(bench: &Bench<'_>, alpha: f32) -> Result<Self, StudyError> {
        let mut shown = None;
        let solved = bench.each(bench.seeds(), |seed| {
            let setup = Setup {
                alpha: Some(alpha),
                scene: seed,
                seed,
                ..base(bench)
            };
            let trial = setup.trial(bench, &format!("balls of α {alpha}"))?;
            let settings = Settings {
                iterations: Some(bench.of_scale(STEPS)),
                ..settings(bench, &trial, seed)
            };
            let words = format!("{}, seed {seed}", trial.name);
            let solved = bench.reconstructed(&trial, &words, &settings)?;
            shown.get_or_insert(trial);
            Ok(solved)
        })?;
        Ok(Self {
            alpha: alpha.into(),
            shown: shown.ok_or(StudyError::Nothing("at least one seed"))?,
            solved,
        })
    }

    fn list(&self, of: impl Fn(&Solved) -> Option<f64>) -> Vec<f64> {
        self.solved
            .iter()
            .map(|s| of(s).unwrap_or(f64::NAN))
            .collect()
    }

    fn alphas(&self) -> Vec<f64> {
        self.list(|s| s.found.vertex_materials.first().map(|m| m.alpha.into()))
    }

    fn kappas(&self) -> Vec<f64> {
        self.list(|s| s.found.vertex_materials.first().map(|m| m.kappa.into()))
    }

    fn held(&self) -> bool {
        self.misses().is_empty()
    }

    fn why(&self) -> &'static str {
        why(&self.list(|s| Some(s.environment_error())))
    }

    /// What was not recovered, and in how many seeds.
    fn misses(&self) -> Vec<String> {
        misses(self.alpha, &self.alphas(), &self.kappas())
    }
}

/// Why materials may be off, by what was measured of the `lights` that were found with them.
fn why(lights: &[f64]) -> &'static str {
    match range(lights)[0] > BLURRED {
        true => {
            "the light was hardly found either, and a highlight is its image; the cause was not found"
        }
        false => "the cause was not found",
    }
}

/// The same of these α and κ, a seed each.
fn misses(alpha: f64, alphas: &[f64], kappas: &[f64]) -> Vec<String> {
    let count = |of: &[f64], wrong: &dyn Fn(f64) -> bool| of.iter().filter(|v| wrong(**v)).count();
    let (off, kappa) = (CLOSE[0] * alpha, f64::from(KAPPA));
    let ways = [
        (
            "α is too large by more than a quarter, a highlight taken for a broader one",
            count(alphas, &|a| a - alpha > off),
        ),
        (
            "α is too small by more than a quarter, a highlight taken for a narrower one",
            count(alphas, &|a| alpha - a > off),
        ),
        (
            "κ is off by more than 0.02",
            count(kappas, &|k| (k - kappa).abs() > CLOSE[1]),
        ),
        (
            "no material was found",
            count(alphas, &|a| a.is_nan()).max(count(kappas, &|k| k.is_nan())),
        ),
    ];
    let missed = ways.into_iter().filter(|(_, seeds)| *seeds > 0);
    missed
        .map(|(words, seeds)| format!("{words}, in {seeds} of {}", alphas.len()))
        .collect()
}

fn evidence(bench: &Bench<'_>, rows: &[Row]) -> Evidence {
    let base = base(bench);
    let held: Vec<bool> = rows.iter().map(Row::held).collect();
    let sentences: Vec<String> = rows
        .iter()
        .map(|row| {
            format!(
                "α {}: found α {}, κ {} (true {KAPPA}){}",
                number(row.alpha),
                listed(&row.alphas()),
                listed(&row.kappas()),
                match row.misses() {
                    missed if missed.is_empty() => String::new(),
                    _ => format!("; {}", row.why()),
                }
            )
        })
        .collect();
    let beside = rows.iter().map(|row| {
        format!(
            "α {}: albedo {} dB, light's relative RMSE {}{}.",
            number(row.alpha),
            listed(&row.list(|s| s.scores.albedo.psnr_aligned)),
            listed(&row.list(|s| Some(s.environment_error()))),
            match row.misses() {
                missed if missed.is_empty() => String::new(),
                missed => format!("; {}", missed.join("; ")),
            }
        )
    });
    let beside = beside.collect();
    let numbers: Map<String, Value> = rows
        .iter()
        .map(|row| {
            let numbers = json!({
                "alpha": row.alphas(),
                "kappa": row.kappas(),
                "alpha_rmse": row.list(|s| s.scores.materials.alpha_rmse),
                "kappa_rmse": row.list(|s| s.scores.materials.kappa_rmse),
                "albedo_psnr": row.list(|s| s.scores.albedo.psnr_aligned),
                "environment_relative_rmse": row.list(|s| Some(s.environment_error())),
            });
            (format!("alpha {}", number(row.alpha)), numbers)
        })
        .collect();
    let alphas = rows.iter().map(|row| (row.alpha, row.alphas()));
    let mut roughness = Series::dots_by_seed("recovered", alphas);
    roughness.push(Series::line("equal", vec![[0.0; 2], [1.0; 2]]));
    let mut figures = vec![Figure {
        name: "roughness".into(),
        caption: "Roughness α as recovered, over the true one.".into(),
        content: Content::Chart(Chart {
            x: Axis::linear("true α", [0.0, 1.0]),
            y: Axis::linear("recovered α", [0.0, 1.0]),
            series: roughness,
        }),
    }];
    figures.extend(rows.iter().map(|row| {
        let bright = white([&row.shown.light]);
        Figure {
            name: format!("light-alpha-{}", number(row.alpha)),
            caption: "Recovered light and the truth; first seed.".into(),
            content: Content::Pictures(vec![
                Picture::light("recovered", &row.solved[0].light(), bright),
                Picture::light("true", &row.shown.light, bright),
            ]),
        }
    }));
    Evidence {
        name: "shiny",
        title: "Materials of shiny objects",
        source: "Verbin et al. 2024, S6",
        claim: "Materials are recovered for shinier objects too (α = 0.2).",
        verdict: Verdict::of(&held),
        sentence: format!(
            "{} (within a quarter of α and {} of κ counts as recovered).",
            sentences.join("; "),
            CLOSE[1]
        ),
        numbers: Value::Object(numbers),
        figures,
        details: beside,
        notes: vec![format!(
            "Three balls under six lamps of 12°, {} photographs of {} x {} pixels, a person in the light; {} for lamps, noise and \
             solver alike; the fast preset, {} steps. It fits one lobe for the whole object, which is true here.",
            base.frames,
            base.resolution,
            base.resolution,
            seeds(bench.seeds().end),
            bench.of_scale(STEPS),
        )],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_miss_is_what_was_measured() {
        assert!(misses(0.2, &[0.2, 0.24, 0.16], &[0.04; 3]).is_empty());
        let said = |alphas: &[f64], kappas: &[f64]| misses(0.2, alphas, kappas).join("; ");
        let broad = said(&[0.3, 0.2, 0.4], &[0.04; 3]);
        assert!(
            broad.contains("too large") && broad.contains("in 2 of 3"),
            "{broad}"
        );
        assert!(
            !broad.contains("too small") && !broad.contains('κ'),
            "{broad}"
        );
        let narrow = said(&[0.1], &[0.09]);
        assert!(
            narrow.contains("too small") && narrow.contains('κ'),
            "{narrow}"
        );
        assert!(said(&[f64::NAN], &[0.04]).contains("no material"));
        assert!(why(&[0.8, 0.7]).contains("the light was hardly found"));
        assert!(why(&[0.8, 0.4]).contains("the cause was not found"));
    }
}
