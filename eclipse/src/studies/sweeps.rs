//! Fig. 9 and S3: one thing varied at a time on small captures of our own, with somebody in the light and with nobody.

mod figure;
mod trend;
mod varied;

use std::cmp::Ordering;

use serde_json::{Map, Value, json};

use self::{
    figure::figure,
    trend::{Trend, in_short},
    varied::{Case, How, Sweep, sweeps},
};
use super::trial::Solved;
use super::{
    Evidence, Scale, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{listed, mean, seeds},
    small::{
        BATCH, Setup, iterations, misfit, solve, solve_by_rays, solve_longer, steps, telling_steps,
    },
};
use crate::report::text::number;

/// Names of the sweeps whose trends are a part of the claim.
const LAMPS: &str = "lamps";
const PERSON: &str = "person";
const ROUGHNESS: &str = "roughness";
const NOISE: &str = "noise";

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

/// What was found of cases that have been solved.
#[derive(Default)]
struct Found(Vec<(Case, Outcome)>);

/// How a solve ended.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Relative squared error of light.
    error: f64,
    /// Variance that is left of the photographs over what was expected: by the paper's algorithm of their noise, see [`misfit`]; by the fast
    /// preset of noise and its model's coarseness.
    misfit: f64,
}

impl Found {
    /// With somebody in the light and with nobody, a seed each.
    fn of(&mut self, bench: &Bench<'_>, case: Case) -> Result<Vec<[Outcome; 2]>, StudyError> {
        bench.each(bench.seeds(), |seed| self.pair(bench, case, seed))
    }

    /// The same of a seed.
    fn pair(
        &mut self,
        bench: &Bench<'_>,
        case: Case,
        seed: u64,
    ) -> Result<[Outcome; 2], StudyError> {
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
    }

    fn outcome(&mut self, bench: &Bench<'_>, case: Case) -> Result<Outcome, StudyError> {
        if let Some((_, outcome)) = self.0.iter().find(|(known, _)| *known == case) {
            return Ok(*outcome);
        }
        let (trial, solved) = match case.how {
            How::Fast => solve(bench, case.setup)?,
            How::Longer => solve_longer(bench, case.setup)?,
            How::Rays(rays) => solve_by_rays(bench, case.setup, rays)?,
        };
        let error = solved.scores.environment.texels.relative_mse_aligned;
        let outcome = Outcome {
            error: error.unwrap_or(f64::NAN),
            misfit: match case.how {
                How::Fast | How::Longer => left(&solved).powi(2),
                How::Rays(_) => misfit(&trial, &case.setup, &solved),
            },
        };
        self.0.push((case, outcome));
        Ok(outcome)
    }
}

/// Residuals of the fast preset over what they were taken to be, RMS.
fn left(solved: &Solved) -> f64 {
    let doubt = solved.found.uncertainty.as_ref();
    doubt.map_or(f64::NAN, |doubt| doubt.summary.misfit)
}

/// A value's worst seed in more steps: errors with somebody in the light and with nobody.
struct Longer {
    value: f64,
    seed: usize,
    /// In as many steps as all.
    before: [f64; 2],
    after: [f64; 2],
}

impl Longer {
    /// Whether more steps make somebody a help.
    fn helps(&self) -> bool {
        !no_help(&self.after)
    }

    /// What too few steps are.
    fn cause(&self) -> &'static str {
        let [after, before] = [self.after, self.before];
        let share = |[with, without]: [f64; 2]| with / without;
        match (self.helps(), share(after) < share(before)) {
            (true, _) => "the cause",
            (false, true) => "a part of the cause",
            (false, false) if after[0] > before[0] => {
                "not the cause: more lead away from the truth"
            }
            (false, false) => "not the cause",
        }
    }

    fn sentence(&self) -> String {
        let [after, before] = [self.after, self.before];
        format!(
            "at {} seed {} in all steps of the coarse stage is off by {} with somebody and by {} with nobody, in place of {} and {}: too few \
             steps are {}",
            number(self.value),
            self.seed,
            number(after[0]),
            number(after[1]),
            number(before[0]),
            number(before[1]),
            self.cause()
        )
    }
}

/// A sweep's errors.
struct Curve {
    sweep: Sweep,
    /// `[value][seed]`: with somebody in the light and with nobody.
    errors: Vec<Vec<[f64; 2]>>,
    /// Mean misfit of the solves with somebody in the light, a value each.
    misfit: Vec<f64>,
    /// What more steps made of values at which somebody was no help.
    longer: Vec<Longer>,
}

impl Curve {
    fn new(bench: &Bench<'_>, mut sweep: Sweep, found: &mut Found) -> Result<Self, StudyError> {
        let cases = sweep.points.iter();
        let outcomes = bench.each(cases, |(_, case)| found.of(bench, *case))?;
        // After a stop only those that were solved.
        sweep.points.truncate(outcomes.len());
        let misfit = outcomes.iter().map(|seeds| {
            let of_seeds: Vec<f64> = seeds.iter().map(|pair| pair[0].misfit).collect();
            mean(&of_seeds)
        });
        let errors = outcomes.iter().map(|seeds| {
            let pairs = seeds.iter().map(|pair| pair.map(|outcome| outcome.error));
            pairs.collect()
        });
        let mut curve = Self {
            errors: errors.collect(),
            misfit: misfit.collect(),
            longer: Vec::new(),
            sweep,
        };
        curve.longer = curve.with_more_steps(bench, found)?;
        Ok(curve)
    }

    /// Where somebody is no help to the fast preset the worst seed is solved again in more steps, if there are any: whether too few are
    /// the cause.
    fn with_more_steps(
        &self,
        bench: &Bench<'_>,
        found: &mut Found,
    ) -> Result<Vec<Longer>, StudyError> {
        let more = telling_steps(bench) < steps(bench);
        let points = self.sweep.points.iter().zip(&self.errors);
        let again = points.filter(|((_, case), pairs)| {
            more && case.how == How::Fast && pairs.iter().any(no_help)
        });
        let tried = bench.each(again, |((value, case), pairs)| {
            let seed = worst(pairs);
            let longer = Case {
                how: How::Longer,
                ..*case
            };
            let after = found.pair(bench, longer, seed as u64)?;
            Ok(Longer {
                value: *value,
                seed,
                before: pairs[seed],
                after: after.map(|outcome| outcome.error),
            })
        });
        match tried {
            // What was found until then stands.
            Err(StudyError::Stopped) => {
                bench.note_cut();
                Ok(Vec::new())
            }
            tried => tried,
        }
    }

    /// Means over seeds.
    fn means(&self, which: usize) -> Vec<f64> {
        let errors = self.errors.iter().map(|pairs| {
            let of_seeds: Vec<f64> = pairs.iter().map(|pair| pair[which]).collect();
            mean(&of_seeds)
        });
        errors.collect()
    }

    /// The values at which somebody in the light is no help, in any seed.
    fn helpless(&self) -> Vec<f64> {
        let points = self.sweep.points.iter().zip(&self.errors);
        points
            .filter(|(_, pairs)| pairs.iter().any(no_help))
            .map(|((value, _), _)| *value)
            .collect()
    }

    /// Whether somebody is a help at every value, in every seed.
    fn held(&self) -> bool {
        self.helpless().is_empty()
    }

    /// What was measured that explains no help at a value, for the first line.
    fn why_at(&self, value: f64) -> String {
        let longer = self.longer.iter().find(|longer| longer.value == value);
        longer.map_or("why was not tested".to_owned(), |longer| {
            format!("too few steps are {}", longer.cause())
        })
    }

    /// The same of all, with its numbers.
    fn why(&self) -> String {
        let mut words: Vec<String> = self.longer.iter().map(Longer::sentence).collect();
        if words.is_empty() {
            words.push("whether more steps do better was not tested".to_owned());
        } else if !self.longer.iter().all(Longer::helps) {
            words.push("beyond that the cause was not found".to_owned());
        }
        words.join("; ")
    }

    fn sentence(&self) -> String {
        let helpless = self.helpless();
        let outcome = match helpless.is_empty() {
            true => "better in every seed: held".to_owned(),
            false => format!(
                "no help in some seed at {}: not held; {}",
                listed(&helpless),
                self.why()
            ),
        };
        let points = self.sweep.points.iter().map(|point| point.0);
        let points: Vec<f64> = points.collect();
        let (with, without) = (self.means(0), self.means(1));
        let mut sentence = format!(
            "over {} ({}): {} with somebody in the light, {} with nobody ({outcome}). Solves with somebody leave {} times the variance that was \
             expected of photographs",
            self.sweep.label,
            listed(&points),
            listed(&with),
            listed(&without),
            listed(&self.misfit)
        );
        let last = with.len() - 1;
        if self.sweep.name == NOISE && with[last] < with[0] {
            sentence +=
                "; more noise lowers the error with somebody in the light, and why was not found";
        }
        sentence
    }
}

/// The seed that somebody in the light helps least.
fn worst(pairs: &[[f64; 2]]) -> usize {
    let share = |[with, without]: &[f64; 2]| match with / without {
        share if share.is_nan() => f64::INFINITY,
        share => share,
    };
    let seeds = (0..pairs.len()).max_by(|&a, &b| share(&pairs[a]).total_cmp(&share(&pairs[b])));
    seeds.unwrap_or(0)
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
    let helps = curves.iter().map(Curve::held);
    let held: Vec<bool> = helps.chain(trends.iter().map(|trend| trend.held)).collect();
    let sentence = in_short(curves, &trends);
    let in_words = |curve: &Curve| format!("Relative MSE of the light {}.", curve.sentence());
    let mut details: Vec<String> = curves.iter().map(in_words).collect();
    details.extend(trends.into_iter().map(|trend| format!("{}.", trend.words)));
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
            table.insert("misfit".to_owned(), json!(curve.misfit));
            let longer = curve.longer.iter();
            let longer: Map<String, Value> = longer
                .map(|of| {
                    let after =
                        json!({"seed": of.seed, "somebody": of.after[0], "nobody": of.after[1]});
                    (number(of.value), after)
                })
                .collect();
            if !longer.is_empty() {
                table.insert("worst_seed_in_more_steps".to_owned(), longer.into());
            }
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
        verdict: Verdict::of(&held),
        sentence,
        numbers: Value::Object(numbers),
        figures: curves.iter().map(figure).collect(),
        details,
        notes: vec![
            conditions(bench),
            match bench.scale {
                Scale::Full => "Five or six values a sweep.".to_owned(),
                _ => "A quick run has two values a sweep, three where a trend is claimed but for roughness: with two, a trend is a difference.".to_owned(),
            },
            "Somebody is no help where nobody in the light is as good in any seed. A trend holds where it does between the ends of \
             its sweep in every seed. The gain from somebody in the light is the share of the error that they take away."
                .into(),
            format!(
                "The fast preset integrates by quadrature and has no secondary rays: over their number the paper's algorithm is compared \
                 with itself, on {} photographs of {} x {} pixels with noise of {}, in {} iterations of {} pixels each. Misfit: the variance of what is left of the photographs with somebody in the light over what was \
                 expected, which is their noise and, of the fast preset, its model's coarseness. One \
                 algorithm is compared with itself in as many steps, so that a solve that has not come to the noise is judged like any other. The paper's occluders are masks on a sphere through the camera, these on one 1.2 times as large; the fast preset looks \
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
            misfit: vec![1.2; errors.len()],
            longer: Vec::new(),
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
        assert!(!broken.held() && broken.sentence().contains("at 2: not held"));
    }

    #[test]
    fn every_sweep_is_judged_by_the_same_rule_and_what_was_measured_of_a_failure_is_told() {
        let errors = [(5.0, [[0.6, 0.5], [0.4, 0.5]]), (12.0, [[0.3, 0.5]; 2])];
        for name in [LAMPS, "rays"] {
            let helpless = curve(name, &errors);
            let told = helpless.sentence();
            assert!(
                told.contains("at 5: not held; whether more steps do better was not tested"),
                "{told}"
            );
            let short = Curve {
                misfit: vec![30.0, 1.0],
                ..helpless
            };
            assert!(!short.held());
            let told = short.sentence();
            assert!(told.contains("leave 30, 1 times the variance"), "{told}");
            let short = in_short(&[short], &[]);
            assert!(short.contains("0 of 1 sweeps held"), "{short}");
            assert!(
                short.contains(&format!(
                    "{name} at 5 (1 of 2 seeds, 0.5 against 0.5; why was not tested)"
                )),
                "{short}"
            );
        }
        let held = curve("rays", &errors[1..]);
        assert!(held.held() && held.sentence().contains("in every seed: held)"));
        assert!(!in_short(&[held], &[]).contains("against"));
    }

    #[test]
    fn more_steps_are_the_cause_where_they_make_it_a_help() {
        let with = |after: [f64; 2]| {
            let curve = Curve {
                longer: vec![Longer {
                    value: 5.0,
                    seed: 1,
                    before: [0.6, 0.5],
                    after,
                }],
                ..curve(LAMPS, &[(5.0, [[0.6, 0.5]; 2])])
            };
            let first = in_short(std::slice::from_ref(&curve), &[]);
            assert!(first.contains("; too few steps are "), "{first}");
            curve.sentence()
        };
        let cause = with([0.4, 0.5]);
        assert!(
            cause.contains("too few steps are the cause") && !cause.contains("not found"),
            "{cause}"
        );
        let part = with([0.55, 0.5]);
        assert!(
            part.contains("steps are a part of the cause; beyond that the cause was not found"),
            "{part}"
        );
        // A lower error that nobody's is lower than by more is no gain.
        for after in [[0.7, 0.5], [0.59, 0.3], [f64::NAN, 0.5]] {
            let told = with(after);
            assert!(told.contains("too few steps are not the cause"), "{told}");
            assert_eq!(told.contains("away from the truth"), after[0] > 0.6);
        }
    }

    #[test]
    fn the_seed_that_is_helped_least_is_tried_again() {
        assert_eq!(worst(&[[0.4, 0.5], [0.6, 0.5], [0.9, 0.8]]), 1);
        assert_eq!(worst(&[[0.4, 0.5], [f64::NAN, 0.5]]), 1);
    }

    #[test]
    fn that_noise_lowers_an_error_is_told() {
        let told = |last: f64| {
            let errors = [(0.005, [[0.3, 0.6]; 2]), (0.05, [[last, 0.6]; 2])];
            curve(NOISE, &errors)
                .sentence()
                .contains("more noise lowers")
        };
        assert!(told(0.2) && !told(0.4));
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
