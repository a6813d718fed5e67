//! Fig. 1, 4 and S1: light, albedo and occluders of every capture at hand, against those who do not model occluders.

use std::rc::Rc;

use render::image::Image;
use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Content, Figure, Picture, range},
    trial::{Solved, Trial, ends},
};
use crate::{image_io::white, report::text::number};

/// Ends the name of a capture that is another's without anybody in the light.
pub(super) const CLEAR: &str = "-unoccluded";
/// Where no capture is there without anybody in the light, and where one is.
const CLAIMS: [&str; 2] = [
    "With unseen occluders modelled and recovered, light and albedo come closer to the truth than without, and light than by \
     recovering it only convolved with the material.",
    "With unseen occluders modelled and recovered, light and albedo come closer to the truth than without, and light than by \
     recovering it only convolved with the material, and than by the object's shadows on itself alone, where it was photographed with \
     nobody there too.",
];

/// The study.
pub(super) struct Recovery;

impl Study for Recovery {
    fn name(&self) -> &'static str {
        "recovery"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = bench.trials()?;
        let rows = bench.each_trial(&trials, |trial| Row::new(bench, trial))?;
        evidence(bench, &rows)
    }
}

/// A capture and what was recovered of it, a seed each.
struct Row {
    trial: Rc<Trial>,
    modelled: Vec<Rc<Solved>>,
    ignored: Vec<Rc<Solved>>,
    /// The true light convolved with the object's material.
    blurred: Image,
    /// Its error.
    convolved: f64,
}

impl Row {
    fn new(bench: &Bench<'_>, trial: &Rc<Trial>) -> Result<Self, StudyError> {
        let pairs = bench.each(bench.seeds(), |seed| {
            Ok((
                bench.solve(trial, true, seed)?,
                bench.solve(trial, false, seed)?,
            ))
        })?;
        let (modelled, ignored) = pairs.into_iter().unzip();
        let blurred = trial.convolved();
        Ok(Self {
            modelled,
            ignored,
            convolved: trial.error(&blurred),
            blurred,
            trial: Rc::clone(trial),
        })
    }

    fn environment(solved: &[Rc<Solved>]) -> [f64; 2] {
        range(&values(solved, Solved::environment_error))
    }

    fn albedo(solved: &[Rc<Solved>]) -> [f64; 2] {
        range(&values(solved, Solved::albedo))
    }

    /// The claim's parts; `clear` is the same without anybody in the light.
    fn parts(&self, clear: Option<&Self>) -> Vec<(&'static str, bool)> {
        let ways = [&self.modelled, &self.ignored];
        let albedo = !self.trial.truth.albedo.is_empty();
        let compared = Compared {
            light: ways.map(|solved| Self::environment(solved)),
            convolved: self.convolved,
            clear: clear.map(|clear| Self::environment(&clear.ignored)),
            albedo: albedo.then(|| ways.map(|solved| Self::albedo(solved))),
            masks: self.trial.occluded().then(|| self.masks(Self::mask_error)),
        };
        compared.parts()
    }

    /// Whether the light is worse in every seed where occluders are modelled.
    fn misled(&self) -> bool {
        let (with, without) = (
            Self::environment(&self.modelled),
            Self::environment(&self.ignored),
        );
        with[0] > without[1]
    }

    fn masks(&self, of: fn(&Solved) -> f64) -> [f64; 2] {
        range(&values(&self.modelled, of))
    }

    fn mask_error(solved: &Solved) -> f64 {
        let error = solved.scores.occluders.energy_weighted_error;
        error.unwrap_or(f64::NAN)
    }

    fn mask_overlap(solved: &Solved) -> f64 {
        solved.scores.occluders.iou.unwrap_or(f64::NAN)
    }

    /// The light's errors, for one look.
    fn sentence(&self) -> String {
        format!(
            "{} {} ({} without, {} convolved)",
            self.trial.name,
            span(Self::environment(&self.modelled)),
            span(Self::environment(&self.ignored)),
            number(self.convolved),
        )
    }

    /// How many solves that looked for somebody kept an occluder.
    fn kept(&self) -> usize {
        let kept = |solved: &&Rc<Solved>| !solved.found.occluders.is_empty();
        self.modelled.iter().filter(kept).count()
    }

    /// Everything else.
    fn detail(&self) -> String {
        format!(
            "{}: {} of {} solves kept an occluder; albedo {} dB with occluders modelled, {} without{}.",
            self.trial.name,
            self.kept(),
            self.modelled.len(),
            span(Self::albedo(&self.modelled)),
            span(Self::albedo(&self.ignored)),
            match self.trial.occluded() {
                true => format!(
                    "; overlap of masks {}",
                    span(self.masks(Self::mask_overlap))
                ),
                false => String::new(),
            }
        )
    }

    fn numbers(&self) -> Value {
        let of = |solved: &[Rc<Solved>]| {
            let list = |of: fn(&Solved) -> Option<f64>| -> Value {
                let values = solved.iter().map(|s| of(s));
                values.map(|v| json!(v)).collect::<Vec<_>>().into()
            };
            json!({
                "environment_relative_rmse": list(|s| s.scores.environment.texels.relative_rmse_aligned),
                "environment_rmse": list(|s| s.scores.environment.texels.rmse_aligned),
                "albedo_psnr": list(|s| s.scores.albedo.psnr_aligned),
                "mask_iou": list(|s| s.scores.occluders.iou),
                "mask_error": list(|s| s.scores.occluders.energy_weighted_error),
            })
        };
        json!({
            "somebody_in_the_light": self.trial.occluded(),
            "occluders_modelled": of(&self.modelled),
            "occluders_not_modelled": of(&self.ignored),
            "convolved_light_relative_rmse": self.convolved,
        })
    }

    /// Light, albedo and masks of the first seed.
    fn figures(&self) -> Vec<Figure> {
        let (with, without) = (&self.modelled[0], &self.ignored[0]);
        let light = &self.trial.light;
        let bright = white([light]);
        let labelled = |words: &str, error: f64| format!("{words}: {}", number(error));
        let mut maps = vec![
            Picture::light(
                labelled("recovered", with.environment_error()),
                &with.light(),
                bright,
            ),
            Picture::light(
                labelled("occluders not modelled", without.environment_error()),
                &without.light(),
                bright,
            ),
        ];
        maps.push(Picture::light(
            labelled("light convolved", self.convolved),
            &self.blurred,
            white([&self.blurred]),
        ));
        maps.push(Picture::light("true", light, bright));
        let mut figures = vec![Figure {
            name: format!("{}-light", self.trial.name),
            caption: format!(
                "Light, scaled to the truth, with its relative RMSE, first seed; the third is shown brighter, as it would be dim.{}",
                match with.found.occluders.is_empty() {
                    true =>
                        " No occluder was kept: the first two are of one model, after different steps.",
                    false => "",
                }
            ),
            content: Content::Pictures(maps),
        }];
        if let Some(truth) = self.trial.truth.albedo.first() {
            let decibels = |solved: &Solved| format!("{} dB", number(solved.albedo()));
            figures.push(Figure {
                name: format!("{}-albedo", self.trial.name),
                caption: "Albedo through the first camera; decibels are of all cameras.".into(),
                content: Content::Pictures(vec![
                    Picture::light(
                        format!("recovered: {}", decibels(with)),
                        &with.albedo_through(0),
                        1.0,
                    ),
                    Picture::light(
                        format!("occluders not modelled: {}", decibels(without)),
                        &without.albedo_through(0),
                        1.0,
                    ),
                    Picture::light("true", &truth.albedo.to_rgb(), 1.0),
                ]),
            });
        }
        let masks = self.trial.truth.occluders.as_deref().unwrap_or_default();
        if let (Some(truth), Some(found)) = (masks.first(), with.found.occluders.first()) {
            figures.push(Figure {
                name: format!("{}-occluder", self.trial.name),
                caption: "What the occluder of the first photograph lets through.".into(),
                content: Content::Pictures(vec![
                    Picture::light("recovered", found, 1.0),
                    Picture::light("true", truth, 1.0),
                ]),
            });
        }
        figures
    }
}

/// What is compared of one capture, least and most over seeds: only what has a truth and a counterpart.
struct Compared {
    /// Errors with occluders modelled, and without.
    light: [[f64; 2]; 2],
    /// The error of the true light convolved with the material.
    convolved: f64,
    /// Errors without anybody in the light.
    clear: Option<[f64; 2]>,
    /// Decibels, as `light`.
    albedo: Option<[[f64; 2]; 2]>,
    /// The light that masks get wrong over what is blocked.
    masks: Option<[f64; 2]>,
}

impl Compared {
    /// By the worst seed with occluders modelled and the best without; what is no number is not better.
    fn parts(&self) -> Vec<(&'static str, bool)> {
        let [[_, worst], [best_without, _]] = self.light;
        let mut parts = vec![
            (
                "its light is no better than without occluders in the model",
                worst < best_without,
            ),
            (
                "its light is no better than light convolved with the material",
                worst < self.convolved,
            ),
        ];
        if let Some([best_clear, _]) = self.clear {
            parts.push((
                "its light is no better than by the object's own shadows alone",
                worst < best_clear,
            ));
        }
        if let Some([[worst, _], [_, best_without]]) = self.albedo {
            parts.push((
                "its albedo is no better than without occluders in the model",
                worst > best_without,
            ));
        }
        if let Some([_, worst]) = self.masks {
            // No mask at all gets as much light wrong as is blocked.
            parts.push(("its masks are no better than none", worst < 1.0));
        }
        parts
    }
}

/// The light's errors of every capture, with occluders modelled and without.
fn errors(rows: &[Row]) -> Figure {
    let of = |solved: fn(&Row) -> &[Rc<Solved>]| -> Vec<Vec<f64>> {
        let errors = rows
            .iter()
            .map(|row| values(solved(row), Solved::environment_error));
        errors.collect()
    };
    let names: Vec<String> = rows.iter().map(|row| row.trial.name.clone()).collect();
    Figure::of_seeds(
        "errors",
        "Relative RMSE of the light with occluders modelled and not",
        "relative RMSE of the light",
        &names,
        &[
            ("occluders modelled", of(|row| &row.modelled)),
            ("not modelled", of(|row| &row.ignored)),
        ],
    )
}

fn values(solved: &[Rc<Solved>], of: fn(&Solved) -> f64) -> Vec<f64> {
    solved.iter().map(|s| of(s)).collect()
}

fn span([low, high]: [f64; 2]) -> String {
    if low == high || low.is_nan() {
        number(low)
    } else {
        format!("{}–{}", number(low), number(high))
    }
}

fn evidence(bench: &Bench<'_>, rows: &[Row]) -> Result<Evidence, StudyError> {
    let (occluded, clear): (Vec<&Row>, Vec<&Row>) =
        rows.iter().partition(|row| row.trial.occluded());
    if occluded.is_empty() {
        return Err(bench.nothing("a capture with truth/occluders.exr: somebody in the light"));
    }
    // The same object, photographed without anybody in the light.
    let clear_of = |row: &Row| {
        let name = format!("{}{CLEAR}", row.trial.name);
        clear.iter().copied().find(|other| other.trial.name == name)
    };
    let parts: Vec<(&Row, &str, bool)> = occluded
        .iter()
        .flat_map(|row| {
            let parts = row.parts(clear_of(row)).into_iter();
            parts.map(|(words, held)| (*row, words, held))
        })
        .collect();
    let paired = occluded.iter().any(|row| clear_of(row).is_some());
    let failed: Vec<String> = parts
        .iter()
        .filter(|(.., held)| !held)
        .map(|(row, words, _)| format!("{}: {words}", row.trial.name))
        .collect();
    let listed: Vec<String> = occluded.iter().map(|row| row.sentence()).collect();
    let mut sentence = format!(
        "relative RMSE of the light with occluders modelled, on captures with somebody in it, against none in the model and the true light \
         convolved with the material: {}.",
        listed.join("; ")
    );
    let mut details: Vec<String> = occluded.iter().map(|row| row.detail()).collect();
    if !clear.is_empty() {
        let listed: Vec<String> = clear.iter().map(|row| row.sentence()).collect();
        details.extend(clear.iter().map(|row| row.detail()));
        details.push(format!(
            "With nobody in the light, where the object's own shadows are all there is, the same numbers: {}.",
            listed.join("; ")
        ));
        let misled: Vec<&str> = clear
            .iter()
            .filter(|row| row.misled())
            .map(|row| &*row.trial.name)
            .collect();
        if !misled.is_empty() {
            details.push(format!(
                "Where nobody is in the light, to look for somebody makes the light worse in every seed on {}.",
                misled.join(", ")
            ));
        }
    }
    let alone = occluded.iter().filter(|row| clear_of(row).is_none());
    let alone: Vec<&str> = alone.map(|row| &*row.trial.name).collect();
    if !alone.is_empty() {
        details.push(format!(
            "Not compared with the object's own shadows alone, as they were not photographed without anybody there: {}.",
            alone.join(", ")
        ));
    }
    if !failed.is_empty() {
        let mut behind: Vec<&Row> = Vec::new();
        for (row, ..) in parts.iter().filter(|(.., held)| !held) {
            if !behind.iter().any(|known| std::ptr::eq(*known, *row)) {
                behind.push(row);
            }
        }
        let solves = behind.iter().flat_map(|row| &row.modelled);
        sentence += &format!(
            " It failed where: {}; {}.",
            failed.join("; "),
            ends(solves.map(Rc::as_ref), bench.seconds())
        );
    }
    let numbers: Map<String, Value> = rows
        .iter()
        .map(|row| (row.trial.name.clone(), row.numbers()))
        .collect();
    Ok(Evidence {
        name: "recovery",
        title: "Light, albedo and occluders recovered",
        source: "Verbin et al. 2024, Fig. 1, 4 and S1",
        claim: CLAIMS[usize::from(paired)],
        verdict: Verdict::of(&parts.iter().map(|(.., held)| *held).collect::<Vec<_>>()),
        sentence,
        numbers: Value::Object(numbers),
        figures: [errors(rows)]
            .into_iter()
            .chain(rows.iter().flat_map(Row::figures))
            .collect(),
        details,
        notes: vec![
            bench.conditions(),
            "Light and albedo share a scale in each channel that no photograph tells: both are scaled to the truth's light. A constant \
             map scores near 1 where light is made of windows and lamps. Convolved light is the truth itself as a surface of the \
             object's true material (its lobe, its mean albedo) shows it to whoever looks at it from straight in front, and so the best \
             that methods can do which do not take light and material apart. Matt captures are told to be matt. Masks: intersection over union of what is blocked, and the light that differs over the light that is blocked."
                .into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_judged_by_the_worst_seed_against_the_best() {
        let good = || Compared {
            light: [[0.4, 0.5], [0.6, 0.9]],
            convolved: 0.8,
            clear: Some([0.7, 0.8]),
            albedo: Some([[25.0, 28.0], [10.0, 20.0]]),
            masks: Some([0.5, 0.9]),
        };
        let failed = |compared: Compared| -> Vec<usize> {
            let parts = compared.parts().into_iter().enumerate();
            parts
                .filter_map(|(i, (_, held))| (!held).then_some(i))
                .collect()
        };
        let with = |change: fn(&mut Compared)| {
            let mut compared = good();
            change(&mut compared);
            failed(compared)
        };
        assert_eq!(failed(good()), [0usize; 0]);
        assert_eq!(with(|c| c.light[1][0] = 0.45), [0]);
        assert_eq!(with(|c| c.convolved = 0.45), [1]);
        assert_eq!(with(|c| c.clear = Some([0.45, 0.8])), [2]);
        assert_eq!(with(|c| c.albedo = Some([[25.0, 28.0], [10.0, 26.0]])), [3]);
        assert_eq!(with(|c| c.masks = Some([0.5, 1.1])), [4]);
        assert_eq!(with(|c| c.light[0] = [f64::NAN; 2]), [0, 1, 2]);
        // What has no truth is not asked for.
        let alone = Compared {
            clear: None,
            albedo: None,
            masks: None,
            ..good()
        };
        assert_eq!(alone.parts().len(), 2);
    }
}
