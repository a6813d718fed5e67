//! Fig. 9 and S3: one thing varied at a time on small captures of our own, with somebody in the light and with nobody.

mod figure;
mod trend;

use std::cmp::Ordering;

use serde_json::{Map, Value, json};

use self::{
    figure::figure,
    trend::{Trend, in_short},
};
use super::trial::Solved;
use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{listed, seeds},
    small::{BATCH, Setup, iterations, misfit, solve, solve_by_rays, telling_steps},
};
use crate::report::text::number;

/// Names of the sweeps whose trends are a part of the claim.
const LAMPS: &str = "lamps";
const PERSON: &str = "person";
const ROUGHNESS: &str = "roughness";
/// Where so much more of the photographs is left than their noise, a solve by the paper's algorithm was cut short.
const CUT_SHORT: f64 = 2.0;

/// The study.
pub(super) struct Sweeps;

impl Study for Sweeps {
    fn name(&self) -> &'static str {
        "sweeps"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let mut found = Found::default();
        let curves = bench.each(sweeps(bench), |sweep| Curve::new(bench, sweep, &mut found))?;
        Ok(evidence(bench, &curves))
    }
}

/// One thing that is varied.
struct Sweep {
    name: &'static str,
    label: &'static str,
    logarithmic: bool,
    points: Vec<(f64, Case)>,
}

/// A capture, and how it is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Case {
    setup: Setup,
    /// By the paper's algorithm with so many rays from each surface point; `None` for the fast preset.
    rays: Option<u64>,
}

impl From<Setup> for Case {
    fn from(setup: Setup) -> Self {
        Self { setup, rays: None }
    }
}

/// What is varied, and over which values: at a glance, quick, and in full. Quick ones have a third value where a part of the
/// claim is about a trend, but for roughness, whose solves are the longest.
fn sweeps(bench: &Bench<'_>) -> Vec<Sweep> {
    let base = Setup::telling(bench.scale);
    let sweep = |name, label, logarithmic, values: [&[f32]; 3], set: &dyn Fn(f32) -> Case| Sweep {
        name,
        label,
        logarithmic,
        points: bench
            .of_scale(values)
            .iter()
            .map(|&value| (in_words(value), set(value)))
            .collect(),
    };
    vec![
        sweep(
            LAMPS,
            "radius of lamps at 1/e, degrees",
            false,
            [
                &[12.0, 30.0],
                &[5.0, 12.0, 30.0],
                &[4.0, 7.0, 12.0, 20.0, 30.0, 45.0],
            ],
            &|lamp| Setup { lamp, ..base }.into(),
        ),
        sweep(
            ROUGHNESS,
            "roughness α (1 is matt)",
            false,
            [&[0.2, 1.0], &[0.2, 1.0], &[0.1, 0.2, 0.35, 0.5, 0.7, 1.0]],
            &|alpha| {
                Setup {
                    alpha: (alpha < 1.0).then_some(alpha),
                    ..base
                }
                .into()
            },
        ),
        sweep(
            PERSON,
            "height of the person, relative",
            false,
            [
                &[1.0, 1.6],
                &[0.5, 1.0, 1.6],
                &[0.3, 0.5, 0.75, 1.0, 1.3, 1.6],
            ],
            &|person| {
                Setup {
                    person: Some(person),
                    ..base
                }
                .into()
            },
        ),
        sweep(
            "noise",
            "noise σ at a pixel value of 0.75",
            true,
            [
                &[0.005],
                &[0.005, 0.05],
                &[0.001, 0.002, 0.005, 0.01, 0.02, 0.05],
            ],
            &|noise| Setup { noise, ..base }.into(),
        ),
        sweep(
            "rays",
            "secondary rays of the paper's algorithm",
            true,
            [&[4.0], &[4.0, 64.0], &[4.0, 8.0, 16.0, 64.0, 256.0]],
            &|rays| Case {
                setup: Setup::noisy(bench.scale),
                rays: Some(rays as u64),
            },
        ),
        // Last: cameras elsewhere have to look anew.
        sweep(
            "images",
            "photographs",
            false,
            [&[6.0], &[24.0, 48.0], &[8.0, 16.0, 32.0, 48.0, 96.0]],
            &|frames| {
                Setup {
                    frames: frames as usize,
                    ..base
                }
                .into()
            },
        ),
    ]
}

/// The number that people read: 0.2, not the nearest one of single precision.
fn in_words(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(value.into())
}

/// What was found of cases that have been solved.
#[derive(Default)]
struct Found(Vec<(Case, Outcome)>);

/// How a solve ended.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Relative squared error of light.
    error: f64,
    /// Of the paper's algorithm, see [`misfit`].
    misfit: Option<f64>,
    /// Of the fast preset: residuals over what they were taken to be, RMS.
    left: Option<f64>,
}

impl Found {
    /// With somebody in the light and with nobody, a seed each.
    fn of(&mut self, bench: &Bench<'_>, case: Case) -> Result<Vec<[Outcome; 2]>, StudyError> {
        bench.each(bench.seeds(), |seed| {
            let somebody = Setup {
                scene: seed,
                seed,
                ..case.setup
            };
            let nobody = Setup {
                person: None,
                ..somebody
            };
            let mut of = |setup| self.outcome(bench, Case { setup, ..case });
            Ok([of(somebody)?, of(nobody)?])
        })
    }

    fn outcome(&mut self, bench: &Bench<'_>, case: Case) -> Result<Outcome, StudyError> {
        if let Some((_, outcome)) = self.0.iter().find(|(known, _)| *known == case) {
            return Ok(*outcome);
        }
        let (trial, solved) = match case.rays {
            None => solve(bench, case.setup)?,
            Some(rays) => solve_by_rays(bench, case.setup, rays)?,
        };
        let error = solved.scores.environment.texels.relative_mse_aligned;
        let outcome = Outcome {
            error: error.unwrap_or(f64::NAN),
            misfit: case.rays.map(|_| misfit(&trial, &case.setup, &solved)),
            left: case.rays.is_none().then(|| left(&solved)),
        };
        self.0.push((case, outcome));
        Ok(outcome)
    }
}

/// See [`Outcome::left`].
fn left(solved: &Solved) -> f64 {
    let doubt = solved.found.uncertainty.as_ref();
    doubt.map_or(f64::NAN, |doubt| doubt.summary.misfit)
}

/// A sweep's errors.
struct Curve {
    sweep: Sweep,
    /// `[value][seed]`: with somebody in the light and with nobody.
    errors: Vec<Vec<[f64; 2]>>,
    /// Mean misfit of the solves with somebody in the light, where the paper's algorithm made them.
    misfit: Option<f64>,
    /// The same by the fast preset, a value each, as [`Outcome::left`].
    left: Vec<f64>,
}

impl Curve {
    fn new(bench: &Bench<'_>, mut sweep: Sweep, found: &mut Found) -> Result<Self, StudyError> {
        let cases = sweep.points.iter();
        let outcomes = bench.each(cases, |(_, case)| found.of(bench, *case))?;
        // After a stop only those that were solved.
        sweep.points.truncate(outcomes.len());
        let all = outcomes.iter().flatten();
        let misfits: Vec<f64> = all.filter_map(|pair| pair[0].misfit).collect();
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
        let left = outcomes.iter().map(|seeds| {
            let left: Vec<f64> = seeds.iter().filter_map(|pair| pair[0].left).collect();
            mean(&left)
        });
        let errors = outcomes.iter().map(|seeds| {
            let pairs = seeds.iter().map(|pair| pair.map(|outcome| outcome.error));
            pairs.collect()
        });
        Ok(Self {
            errors: errors.collect(),
            misfit: (!misfits.is_empty()).then(|| mean(&misfits)),
            left: left.collect(),
            sweep,
        })
    }

    /// Whether solves came far enough for their errors to say anything.
    fn tested(&self) -> bool {
        self.misfit.is_none_or(|misfit| misfit <= CUT_SHORT)
    }

    /// Means over seeds.
    fn means(&self, which: usize) -> Vec<f64> {
        let mean = |pairs: &Vec<[f64; 2]>| {
            pairs.iter().map(|pair| pair[which]).sum::<f64>() / pairs.len() as f64
        };
        self.errors.iter().map(mean).collect()
    }

    /// The values at which somebody in the light is no help, in any seed.
    fn helpless(&self) -> Vec<f64> {
        let points = self.sweep.points.iter().zip(&self.errors);
        points
            .filter(|(_, pairs)| pairs.iter().any(no_help))
            .map(|((value, _), _)| *value)
            .collect()
    }

    /// What came of the claim here, in a word.
    fn outcome(&self) -> &'static str {
        match self.tested() {
            true => outcome(self.helpless().is_empty()),
            false => "not tested",
        }
    }

    /// The same and, where it is not that the claim held, why.
    fn outcome_and_why(&self) -> String {
        match (self.tested(), self.helpless().is_empty()) {
            (true, true) => self.outcome().to_owned(),
            _ => format!("{}: {}", self.outcome(), self.why()),
        }
    }

    /// What was measured that explains no help.
    fn why(&self) -> String {
        match self.misfit {
            Some(misfit) if misfit > CUT_SHORT => format!(
                "solves ended with {} times the variance of the noise left, so that their iterations were too few",
                number(misfit)
            ),
            Some(_) => "photographs were explained, and the cause was not found".to_owned(),
            None => format!(
                "residuals are {} times what noise and the model's coarseness would leave (RMS, with somebody), beyond which the cause was \
                 not found",
                listed(&self.left)
            ),
        }
    }

    fn sentence(&self) -> String {
        let ends = |which: usize| {
            let means = self.means(which);
            format!("{} to {}", number(means[0]), number(means[means.len() - 1]))
        };
        let helpless = self.helpless();
        let outcome = self.outcome();
        let but = match (self.tested(), helpless.is_empty()) {
            (false, _) => format!(" ({outcome}: {})", self.why()),
            (true, true) => format!(" (better in every seed: {outcome})"),
            (true, false) => format!(
                " (no help in some seed at {}: {outcome}; {})",
                listed(&helpless),
                self.why()
            ),
        };
        let points = &self.sweep.points;
        format!(
            "over {} from {} to {}: {} with somebody in the light, {} with nobody{but}",
            self.sweep.label,
            number(points[0].0),
            number(points[points.len() - 1].0),
            ends(0),
            ends(1),
        )
    }
}

/// A part of the claim that was tested, in a word.
fn outcome(held: bool) -> &'static str {
    match held {
        true => "held",
        false => "not held",
    }
}

/// Whether somebody in the light did not lower the error. An error that is no number is lower than nothing.
fn no_help([with, without]: &[f64; 2]) -> bool {
    with.partial_cmp(without) != Some(Ordering::Less)
}

fn evidence(bench: &Bench<'_>, curves: &[Curve]) -> Evidence {
    let trends = Trend::all(curves);
    let noisy = Setup::noisy(bench.scale);
    let helps = curves.iter();
    let helps = helps.map(|c| c.tested().then(|| c.helpless().is_empty()));
    let trended = trends.iter().map(|trend| Some(trend.held));
    let held: Vec<Option<bool>> = helps.chain(trended).collect();
    let sentence = in_short(curves, &trends);
    let mut details: Vec<String> = curves.iter().map(Curve::sentence).collect();
    details.extend(trends.into_iter().map(|trend| trend.words));
    let numbers: Map<String, Value> = curves
        .iter()
        .map(|curve| {
            let of = |((value, _), pairs): (&(f64, Case), &Vec<[f64; 2]>)| {
                let list = |which: usize| pairs.iter().map(|p| p[which]).collect::<Vec<_>>();
                (
                    number(*value),
                    json!({"somebody": list(0), "nobody": list(1)}),
                )
            };
            let points = curve.sweep.points.iter().zip(&curve.errors);
            let mut table: Map<String, Value> = points.map(of).collect();
            match curve.misfit {
                Some(misfit) => table.insert("misfit".to_owned(), json!(misfit)),
                None => table.insert("residuals_over_expected".to_owned(), json!(curve.left)),
            };
            (curve.sweep.name.to_owned(), Value::Object(table))
        })
        .collect();
    Evidence {
        name: "sweeps",
        title: "Light, material, occluder, photographs, noise and rays, one at a time",
        source: "Verbin et al. 2024, Fig. 9 and S3",
        claim: "Over the frequency of light, roughness, the occluder's size, the number of images, their noise and the number of \
                secondary rays, light is recovered better with an unseen occluder that is modelled than without one in the scene; larger occluders help more; and the gain \
                grows with the light's frequency and with the object's roughness.",
        verdict: Verdict::of_all(&held),
        sentence,
        numbers: Value::Object(numbers),
        figures: curves.iter().map(figure).collect(),
        details: vec![format!(
            "Relative MSE of the light {}.",
            details.join("; ")
        )],
        notes: vec![
            conditions(bench),
            "Somebody is no help where nobody in the light is as good in any seed. A trend holds where it does between the ends of \
             its sweep in every seed. The gain from somebody in the light is the share of the error that they take away."
                .into(),
            format!(
                "The fast preset integrates by quadrature and has no secondary rays: over their number the paper's algorithm is compared \
                 with itself, on {} photographs of {} x {} pixels with noise of {}, in {} iterations of {} pixels each. Misfit: the variance of what it leaves of the photographs over that of \
                 their noise. The paper's occluders are masks on a sphere through the camera, these on one 1.2 times as large; the fast preset looks \
                 for a figure on an upright cylinder.",
                noisy.frames,
                noisy.resolution,
                noisy.resolution,
                number(noisy.noise.into()),
                iterations(bench),
                BATCH.pixels
            ),
        ],
    }
}

fn conditions(bench: &Bench<'_>) -> String {
    let base = Setup::telling(bench.scale);
    format!(
        "Three balls under six lamps of {}° (the radius at which they are 1/e as bright), matt, {} photographs of {} x {} pixels, noise {}, a person of usual \
         height, unless varied; {} for lamps, noise and solver alike. The fast preset but for secondary rays, {} steps of the 24 of its coarse stage, so that \
         no error falls below what texels of 7° can represent. How many do best depends on the lamps: wide ones are found in fewer. Errors \
         after the best scale of each channel.",
        base.lamp,
        base.frames,
        base.resolution,
        base.resolution,
        base.noise,
        seeds(bench.seeds().end),
        telling_steps(bench),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A curve of two seeds that was measured at these values.
    fn curve(name: &'static str, errors: &[(f64, [[f64; 2]; 2])]) -> Curve {
        let points = errors.iter().map(|(value, _)| (*value, Setup::BASE.into()));
        Curve {
            sweep: Sweep {
                name,
                label: name,
                logarithmic: false,
                points: points.collect(),
            },
            errors: errors.iter().map(|(_, seeds)| seeds.to_vec()).collect(),
            misfit: None,
            left: vec![2.5; errors.len()],
        }
    }

    #[test]
    fn an_error_that_is_no_number_is_no_help() {
        assert!(!no_help(&[0.1, 0.2]));
        for pair in [[0.2, 0.2], [f64::NAN, 0.2], [0.1, f64::NAN]] {
            assert!(no_help(&pair), "{pair:?}");
        }
        let broken = curve(
            "noise",
            &[(1.0, [[0.1, 0.2]; 2]), (2.0, [[0.1, 0.2], [f64::NAN, 0.2]])],
        );
        assert_eq!(broken.helpless(), [2.0]);
        assert!(broken.sentence().contains("at 2: not held"));
    }

    #[test]
    fn what_was_cut_short_was_not_tested() {
        let with = |error: f64, misfit: f64| Curve {
            misfit: Some(misfit),
            ..curve("rays", &[(4.0, [[error, 0.5]; 2]), (64.0, [[0.3, 0.5]; 2])])
        };
        for error in [0.4, 0.6] {
            let short = with(error, 30.0);
            assert!(!short.tested());
            let told = short.sentence();
            assert!(
                told.contains("(not tested: solves ended with 30") && !told.contains("held"),
                "{told}"
            );
            assert!(in_short(&[short], &[]).contains("(not tested: solves ended with 30"));
        }
        let held = with(0.4, 1.2).sentence();
        assert!(held.contains("held)"), "{held}");
        let unknown = with(0.6, 1.2).sentence();
        assert!(unknown.contains("the cause was not found"), "{unknown}");
    }

    #[test]
    fn where_somebody_is_no_help_what_is_left_of_photographs_is_told() {
        let errors = [(5.0, [[0.6, 0.5]; 2]), (12.0, [[0.3, 0.5]; 2])];
        let helpless = curve(LAMPS, &errors);
        let told = helpless.sentence();
        assert!(
            told.contains("at 5: not held; residuals are 2.5, 2.5 times"),
            "{told}"
        );
        let short = in_short(&[helpless], &[]);
        assert!(
            short.contains(
                "lamps 5, 12: 0.6, 0.3 with somebody in the light, 0.5, 0.5 with nobody (not held: residuals are 2.5, 2.5 times"
            ),
            "{short}"
        );
    }

    #[test]
    fn trends_hold_where_every_seed_has_them() {
        let person = |last: [[f64; 2]; 2]| curve(PERSON, &[(0.5, [[0.4, 0.5]; 2]), (1.6, last)]);
        let held = |curve: Curve| Trend::all(&[curve])[0].held;
        assert!(held(person([[0.2, 0.5], [0.3, 0.5]])));
        assert!(!held(person([[0.2, 0.5], [0.4, 0.5]])));
        assert!(!held(person([[0.2, 0.5], [f64::NAN, 0.5]])));
        // Narrow lamps: half of the error is gone; wide ones: a fifth.
        let lamps = [(5.0, [[0.3, 0.6]; 2]), (30.0, [[0.4, 0.5]; 2])];
        let trends = Trend::all(&[curve(LAMPS, &lamps)]);
        assert!(trends[0].held);
        let words = &trends[0].words;
        assert!(
            words.contains("frequency: held (0.5, 0.2 at 5, 30"),
            "{words}"
        );
        // That harm grows towards the other end shows no gain.
        let harmful = [(5.0, [[0.6, 0.6]; 2]), (30.0, [[0.9, 0.5]; 2])];
        assert!(!Trend::all(&[curve(LAMPS, &harmful)])[0].held);
        // A matt object gains more than a glossy one.
        let glossy = [(0.2, [[0.5, 0.6]; 2]), (1.0, [[0.3, 0.6]; 2])];
        assert!(Trend::all(&[curve(ROUGHNESS, &glossy)])[0].held);
        let reversed = [(0.2, [[0.3, 0.6]; 2]), (1.0, [[0.5, 0.6]; 2])];
        assert!(!Trend::all(&[curve(ROUGHNESS, &reversed)])[0].held);
        // Of a sweep that was cut short nothing is said.
        assert!(Trend::all(&[curve(LAMPS, &lamps[..1])]).is_empty());
    }
}
