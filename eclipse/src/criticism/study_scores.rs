//! Scores of diagnoses against labels.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Diagnosis, Verdict, diagnosis::Finding, effects, oracle::Yardstick};

/// Identifier of an effect that no table knows.
pub const OUTSIDE: &str = "outside";

/// All that a label may call true.
pub fn names() -> Vec<&'static str> {
    let effects = effects::all().into_iter().map(|effect| effect.id());
    effects.chain([OUTSIDE]).collect()
}

/// One capture's outcome.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// Its name.
    pub capture: String,
    /// What is true.
    pub truth: Vec<String>,
    /// The verdict.
    pub verdict: Verdict,
    /// What was added to the model, in order.
    pub found: Vec<String>,
    /// What the first finding is ambiguous with.
    pub ambiguous_with: Vec<String>,
    /// What each of the others is ambiguous with, where that is anything.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub others_ambiguous_with: BTreeMap<String, Vec<String>>,
    /// The physics that ranks first: by its refit where there was one, else by its gain in the first screening.
    pub first: String,
    /// Its gain in the first screening and the standard error.
    pub first_gain: [f64; 2],
    /// Gain on sealed data of everything that was found.
    pub sealed_gain: f64,
    /// That gain over the gain of a refit that was told the truth, both on sealed data, on patches alone where either has numbers of
    /// single frames; absent where the latter is not three standard errors.
    pub gain_over_oracle: Option<f64>,
    /// Whether a refit that was told the truth gains three standard errors on sealed data: with less, the recording does not hold
    /// the effect beyond what light and texture imitate. Absent where nothing known is true.
    pub above_limit: Option<bool>,
    /// χ² a sealed value before and after.
    pub sealed_chi2: [f64; 2],
    /// The sentence.
    pub sentence: String,
    /// Seconds it took, its reconstruction included.
    pub seconds: f64,
    /// Seconds of that which the reconstruction took.
    pub reconstruction_seconds: f64,
}

impl Case {
    /// Of a diagnosis.
    pub fn new(capture: &str, truth: &[String], d: &Diagnosis, measure: Option<Yardstick>) -> Self {
        let physics = d.ranking.iter().find(|r| !r.capacity);
        let owned = |f: &Finding| -> Vec<String> {
            f.ambiguous_with.iter().map(|s| (*s).to_owned()).collect()
        };
        let others = d.effects.iter().skip(1);
        let seconds = |part: &str| d.seconds.get(part).copied();
        Self {
            capture: capture.to_owned(),
            truth: truth.to_vec(),
            verdict: d.verdict,
            found: d.effects.iter().map(|e| e.id.to_owned()).collect(),
            ambiguous_with: d.effects.first().map_or(Vec::new(), owned),
            others_ambiguous_with: others
                .filter(|f| !f.ambiguous_with.is_empty())
                .map(|f| (f.id.to_owned(), owned(f)))
                .collect(),
            first: physics.map_or(String::new(), |r| r.id.to_owned()),
            first_gain: physics.map_or([0.0; 2], |r| [r.gain, r.gain_se]),
            sealed_gain: d.effects.iter().map(|e| e.sealed_gain).sum(),
            gain_over_oracle: measure.filter(above_limit).map(|m| m.diagnosed / m.told),
            above_limit: measure.as_ref().map(above_limit),
            sealed_chi2: [d.sealed.chi2_before, d.sealed.chi2_after],
            sentence: d.sentence.clone(),
            seconds: seconds("total").or_else(|| seconds("all")).unwrap_or(0.0),
            reconstruction_seconds: seconds("reconstruction").unwrap_or(0.0),
        }
    }

    /// Whether something is said to be missing, be it named or not.
    pub fn alarms(&self) -> bool {
        !matches!(
            self.verdict,
            Verdict::NothingMissing | Verdict::Underpowered
        )
    }

    /// Whether the true effect is the first that was named.
    fn top1(&self) -> bool {
        self.found.first().is_some_and(|f| self.truth.contains(f))
    }

    fn in_set(&self) -> bool {
        let mut set = self.found.first().into_iter().chain(&self.ambiguous_with);
        set.any(|f| self.truth.contains(f))
    }

    /// A line for people.
    pub fn line(&self) -> String {
        let others = self.others_ambiguous_with.iter();
        let others: String = others
            .map(|(id, rivals)| format!(", {id} with {}", rivals.join(", ")))
            .collect();
        format!(
            "{:20} truth [{}]: {:?} [{}] ambiguous [{}{others}] first {} {:.0} ± {:.0}, sealed χ² {:.2} → {:.2}, {:.0} s",
            self.capture,
            self.truth.join(", "),
            self.verdict,
            self.found.join(", "),
            self.ambiguous_with.join(", "),
            self.first,
            self.first_gain[0],
            self.first_gain[1],
            self.sealed_chi2[0],
            self.sealed_chi2[1],
            self.seconds,
        )
    }
}

fn above_limit(measure: &Yardstick) -> bool {
    measure.told > 3.0 * measure.error
}

/// Scores of all captures.
#[derive(Clone, Debug, Serialize)]
pub struct Scores {
    /// Share of single effects that were named first.
    pub top1: Option<f64>,
    /// Share of single effects within the ambiguity set.
    pub in_set: Option<f64>,
    /// As `top1`, of single effects above the detection limit.
    pub top1_above_limit: Option<f64>,
    /// As `in_set`, of single effects above the detection limit.
    pub in_set_above_limit: Option<f64>,
    /// Share of nulls in which something was found.
    pub false_alarm_rate: Option<f64>,
    /// Share of nulls with any verdict but *nothing missing* and *underpowered*: something is said to be missing, be it named or not.
    pub any_alarm_rate: Option<f64>,
    /// Share of compounds of which both effects were found; physics outside the table, which nothing can find, makes no compound.
    pub compound_both: Option<f64>,
    /// Share of captures with physics outside the table in which nothing was named.
    pub abstains_outside: Option<f64>,
    /// Mean of the captures' own, each at most 1: a diagnosis that gains more than the truth has fitted something else besides, and does
    /// not make up for another that gains nothing.
    pub gain_over_oracle: Option<f64>,
    /// Truth → named first → how often.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// Every capture.
    pub captures: Vec<Case>,
}

impl Scores {
    /// Of these cases.
    pub fn new(captures: Vec<Case>) -> Self {
        let share = |of: &dyn Fn(&&Case) -> bool, hit: &dyn Fn(&Case) -> bool| {
            let chosen: Vec<&Case> = captures.iter().filter(|c| of(c)).collect();
            (!chosen.is_empty())
                .then(|| chosen.iter().filter(|c| hit(c)).count() as f64 / chosen.len() as f64)
        };
        let outside = |c: &Case| c.truth.iter().any(|t| t == OUTSIDE);
        let single = |c: &&Case| c.truth.len() == 1 && !outside(c);
        let above = |c: &&Case| single(c) && c.above_limit == Some(true);
        let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
        for case in &captures {
            let truth = if case.truth.is_empty() {
                "nothing".to_owned()
            } else {
                case.truth.join("+")
            };
            let named = case
                .found
                .first()
                .cloned()
                .unwrap_or_else(|| "nothing".to_owned());
            *confusion
                .entry(truth)
                .or_default()
                .entry(named)
                .or_default() += 1;
        }
        Self {
            top1: share(&single, &Case::top1),
            in_set: share(&single, &Case::in_set),
            top1_above_limit: share(&above, &Case::top1),
            in_set_above_limit: share(&above, &Case::in_set),
            false_alarm_rate: share(&|c| c.truth.is_empty(), &|c| !c.found.is_empty()),
            any_alarm_rate: share(&|c| c.truth.is_empty(), &Case::alarms),
            compound_both: share(&|c| c.truth.len() > 1 && !outside(c), &|c| {
                c.truth.iter().all(|t| c.found.contains(t))
            }),
            abstains_outside: share(&|c| outside(c), &|c| c.found.is_empty()),
            gain_over_oracle: mean(
                captures
                    .iter()
                    .filter_map(|c| Some(c.gain_over_oracle?.min(1.0))),
            ),
            confusion,
            captures,
        }
    }

    /// For people.
    pub fn table(&self) -> String {
        let number = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:.2}"));
        let mut text = String::new();
        for (name, value) in [
            ("true effect first, single effects", self.top1),
            ("truth within the ambiguity set", self.in_set),
            ("first, of those above the limit", self.top1_above_limit),
            ("in the set, of those", self.in_set_above_limit),
            ("false alarms on nulls", self.false_alarm_rate),
            ("nulls said to lack something", self.any_alarm_rate),
            ("both effects of compounds", self.compound_both),
            ("abstains outside the table", self.abstains_outside),
            ("sealed gain over a told refit", self.gain_over_oracle),
        ] {
            text += &format!("{name:36} {}\n", number(value));
        }
        text += "\ntruth → named first\n";
        for (truth, row) in &self.confusion {
            let row: Vec<String> = row.iter().map(|(n, k)| format!("{n} {k}")).collect();
            text += &format!("{truth:36} {}\n", row.join(", "));
        }
        text
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(truth: &[&str], found: &[&str], rivals: &[&str], above_limit: Option<bool>) -> Case {
        let owned = |names: &[&str]| names.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        Case {
            capture: "some".to_owned(),
            truth: owned(truth),
            verdict: Verdict::Explained,
            found: owned(found),
            ambiguous_with: owned(rivals),
            others_ambiguous_with: BTreeMap::new(),
            first: String::new(),
            first_gain: [0.0; 2],
            sealed_gain: 0.0,
            gain_over_oracle: None,
            above_limit,
            sealed_chi2: [1.0; 2],
            sentence: String::new(),
            seconds: 0.0,
            reconstruction_seconds: 0.0,
        }
    }

    #[test]
    fn what_a_second_finding_is_ambiguous_with_is_told_and_is_no_rival_of_the_first() {
        let found = vec![
            Finding::example("vignetting", Vec::new()),
            Finding::example("black_level", vec!["veiling_glare"]),
        ];
        let d = Diagnosis::example(Verdict::Ambiguous, found);
        let case = Case::new("some", &["veiling_glare".to_owned()], &d, None);
        assert!(case.ambiguous_with.is_empty() && !case.in_set());
        let line = case.line();
        assert!(line.contains("black_level with veiling_glare"), "{line}");
    }

    #[test]
    fn a_capture_takes_as_long_as_the_command_did() {
        let mut d = Diagnosis::example(Verdict::NothingMissing, Vec::new());
        let seconds = |d: &Diagnosis| {
            let case = Case::new("some", &[], d, None);
            [case.seconds, case.reconstruction_seconds]
        };
        d.seconds.insert("all".to_owned(), 20.0);
        assert_eq!(seconds(&d), [20.0, 0.0]);
        d.seconds.insert("reconstruction".to_owned(), 30.0);
        d.seconds.insert("total".to_owned(), 51.0);
        assert_eq!(seconds(&d), [51.0, 30.0]);
    }

    #[test]
    fn shares_are_of_the_captures_they_are_about() {
        let scores = Scores::new(vec![
            case(&["pose_error"], &["pose_error"], &[], Some(true)),
            case(&["emission"], &[], &[], Some(false)),
            case(&["vignetting"], &["medium"], &["vignetting"], Some(true)),
            case(&[], &[], &[], None),
            case(&[], &["medium"], &[], None),
            case(
                &["moving_occluder", "exposure_drift"],
                &["moving_occluder", "exposure_drift"],
                &[],
                Some(true),
            ),
            case(
                &["moving_occluder", "response_curve"],
                &["moving_occluder"],
                &[],
                Some(true),
            ),
            case(&[OUTSIDE], &["medium"], &[], None),
            case(&["vignetting", OUTSIDE], &["vignetting"], &[], None),
        ]);
        let close = |share: Option<f64>, of: f64| (share.unwrap() - of).abs() < 1e-12;
        assert!(close(scores.top1, 1.0 / 3.0) && close(scores.in_set, 2.0 / 3.0));
        assert!(close(scores.top1_above_limit, 0.5) && close(scores.in_set_above_limit, 1.0));
        assert!(close(scores.false_alarm_rate, 0.5) && close(scores.compound_both, 0.5));
        assert!(close(scores.abstains_outside, 0.0));
        assert_eq!(scores.gain_over_oracle, None);
        let gains = |gain| Case {
            gain_over_oracle: gain,
            ..case(&["vignetting"], &[], &[], None)
        };
        let gained = Scores::new([Some(1.8), Some(0.2), None].map(gains).into());
        assert!(close(gained.gain_over_oracle, 0.6));
        // All of these cases are said to lack something.
        assert!(close(scores.any_alarm_rate, 1.0));
        let silent = |verdict| Case {
            verdict,
            ..case(&[], &[], &[], None)
        };
        let nulls = [
            Verdict::NothingMissing,
            Verdict::Underpowered,
            Verdict::Unexplained,
        ];
        let nulls = Scores::new(nulls.map(silent).into());
        assert!(close(nulls.any_alarm_rate, 1.0 / 3.0));
        assert!(close(nulls.false_alarm_rate, 0.0));
        assert_eq!(scores.confusion["emission"]["nothing"], 1);
        assert_eq!(scores.confusion["nothing"]["medium"], 1);
    }
}
