//! The procedure: fit, screen, compete, refit, open the sealed data, judge.

use std::{collections::BTreeMap, time::Instant};

use super::{
    axes, baselines, certainty, compete, confirm,
    diagnosis::{Diagnosis, Finding, Refitted, Sealed, Verdict},
    effects::{self, Effect},
    fit::{Fit, FitError},
    frame_numbers::FrameNumbers,
    light::Light,
    linearise::Jacobian,
    locate::{self, Structured},
    refit::{self, Round},
    score::{Screen, screen},
    sealed::{Judge, Noise},
    sentence::sentence,
    separate::separate_by,
    silhouette::Silhouettes,
    simulation::Simulation,
    study::{Study, StudyError},
    told::{assumptions, finding, moved, put_first, ranked, shared_exponent},
    verdict::{self, Grounds},
};
use crate::capture::Capture;

/// Steps that bring the baseline near its best before effects are screened.
const BASELINE_STEPS: usize = 24;
/// Effects that are added at most.
const MOST_EFFECTS: usize = 3;
/// More photographs than these are compared at fewer places each, or memory would grow with their square.
const MANY_FRAMES: usize = 64;
/// Hot spots that are told.
const HOT_SPOTS: usize = 12;

/// About how long effects are screened and compared for the first time, in times of what the baseline took: 1.5 to 3.3 where it was
/// measured, where anything is compared at all.
const FIRST_ROUND: f64 = 2.0;

/// How a diagnosis is made.
#[derive(Clone, Debug)]
pub struct Options {
    /// About how many places of the surface are compared.
    pub sites: usize,
    /// Rows of the grid of light.
    pub rows: usize,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Effects to try; all when empty. Capacity candidates always compete.
    pub effects: Vec<String>,
    /// Seconds after which no further effect is looked for; effects are compared once however long that takes.
    pub time_limit: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            sites: 2200,
            rows: 25,
            seed: 0,
            effects: Vec::new(),
            time_limit: None,
        }
    }
}

/// A diagnosis with the models it compared, for pictures.
pub struct Outcome<'a> {
    /// What it says.
    pub diagnosis: Diagnosis,
    /// The data.
    pub study: Study<'a>,
    /// The first model.
    pub before: Fit,
    /// The last model.
    pub after: Fit,
    /// Its occluders, if it has any.
    pub silhouettes: Option<Silhouettes>,
}

/// Diagnoses a capture against its simulation; `report` is told what is being done and answers whether to go on.
///
/// # Errors
/// [`DiagnoseError`].
pub fn diagnose<'a>(
    capture: &'a Capture,
    simulation: &Simulation,
    options: &Options,
    report: &(dyn Fn(&str) -> bool + Sync),
) -> Result<Outcome<'a>, DiagnoseError> {
    let began = Instant::now();
    let mut seconds = BTreeMap::new();
    let report = |text: &str| report(text).then_some(()).ok_or(DiagnoseError::Interrupted);
    let light = light_of(capture);
    let candidates = chosen(&options.effects, light)?;
    report("visibility of the surface")?;
    let mut study = Study::new(
        capture,
        simulation,
        options.sites * MANY_FRAMES / capture.frames.len().max(MANY_FRAMES),
        options.rows,
        options.seed,
    )?;
    let mut behind = BTreeMap::new();
    if study.given.is_some() {
        report(baselines::NONE)?;
        let all = candidates.iter().copied();
        let none = baselines::without_given(&mut study, BASELINE_STEPS, all)?;
        behind.extend(none.map(|ranked| (baselines::NONE.to_owned(), ranked)));
    }
    report("light and texture at their best without any effect")?;
    let mut first = Fit::start(&study)?;
    first.refine(&study, BASELINE_STEPS)?;
    let baseline = began.elapsed().as_secs_f64();
    seconds.insert("baseline".to_owned(), baseline);
    if let Some(longer) = beyond(options.time_limit, baseline) {
        report(&longer)?;
    }

    let mut rounds: Vec<Round> = Vec::new();
    let (mut ended_by_time, mut trifle) = (false, None);
    let mut ranking = Vec::new();
    let mut refits: Vec<Refitted> = Vec::new();
    let mut longest = 0.0f64;
    loop {
        let fit = rounds.last().and_then(Round::best).unwrap_or(&first);
        report("screening effects")?;
        let screened = Instant::now();
        let free = candidates.iter().copied();
        let free = free.filter(|e| !fit.active.iter().any(|a| a.effect.id() == e.id()));
        let result = if rounds.is_empty() && light == Light::Environment {
            let (result, of_occluders) = baselines::screened(&study, fit, free)?;
            behind.extend(of_occluders);
            result
        } else {
            screen_at(&study, fit, free)?
        };
        seconds.insert(
            format!("screen {}", rounds.len() + 1),
            screened.elapsed().as_secs_f64(),
        );
        for score in &result.scores {
            tracing::debug!(
                id = score.id,
                gain = score.gain,
                se = score.gain_se,
                p = score.p,
                size = score.size,
                survival = score.survival,
                minimum_detectable = score.minimum_detectable,
                "score"
            );
        }
        if ranking.is_empty() {
            ranking = ranked(&result);
        } else {
            let inside: Vec<&str> = fit.active.iter().map(|a| a.effect.id()).collect();
            behind.insert(format!("with {}", inside.join(", ")), ranked(&result));
        }
        // A round that could not end in time is not begun.
        let until = began.elapsed().as_secs_f64() + longest;
        let late = options.time_limit.is_some_and(|limit| until > limit);
        let contenders = compete::contenders(&result);
        let physics = rounds.iter().filter(|round| round.finer.is_none());
        if physics.count() >= MOST_EFFECTS || contenders.is_empty() {
            break;
        }
        if late && !rounds.is_empty() {
            ended_by_time = true;
            break;
        }
        let refitted = Instant::now();
        let tell = |text: &str| report(text);
        let round = refit::round(&study, fit, &result.nuisance, contenders, &tell)?;
        let taken = refitted.elapsed().as_secs_f64();
        longest = longest.max(taken);
        seconds.insert(format!("refits {}", rounds.len() + 1), taken);
        if rounds.is_empty() {
            put_first(&mut ranking, &round.evidence);
        }
        refits.extend(round.evidence.iter().map(|&(id, evidence)| Refitted {
            after: rounds.len(),
            id,
            evidence,
            sealed: None,
        }));
        trifle = round.trifle(&rounds);
        if trifle.is_some() {
            break;
        }
        let ends = round.best().is_none();
        rounds.push(round);
        if ends {
            break;
        }
    }

    report("opening the sealed data")?;
    let opened = confirm::open(&study, &rounds, &mut refits)?;
    // What effects are compared with has the detail that they were compared behind.
    let named = !opened.path.is_empty();
    let physics = rounds.iter().position(|round| round.finer.is_none());
    let base = physics.filter(|_| named).unwrap_or(0);
    let before = rounds.get(base).map_or(&first, |round| &round.null);
    let after = opened.path.last().map_or(before, |step| step.fit);
    let errors = if named {
        report("how sure the numbers are")?;
        certainty::standard_errors(&study, after)?
    } else {
        BTreeMap::new()
    };
    let findings: Vec<Finding> = opened
        .path
        .iter()
        .map(|step| finding(step, after, &errors))
        .collect();
    let findings = apart(findings);
    let all_shared = after.is_shared();
    let none = FrameNumbers::none();
    let judge = Judge::new(&study, before, after, Noise::Sensor);
    let [first_errors, last_errors] = [before, after].map(|fit| judge.errors(&study, fit, &none));
    let count = first_errors.count(all_shared).max(1) as f64;
    let sealed = Sealed {
        chi2_before: first_errors.chi2(all_shared) / count,
        chi2_after: last_errors.chi2(all_shared) / count,
        rmse_before: first_errors.rmse(all_shared),
        rmse_after: last_errors.rmse(all_shared),
    };
    let structured = [before, after].map(|fit| Structured::of(&study, fit));
    let judged = verdict::judged(structured);
    let in_sealed = |fit: &Fit| Structured::in_sealed_frames(&study, fit);
    let structured_sealed = in_sealed(before)
        .zip(in_sealed(after))
        .filter(|_| all_shared);
    let hot_spots = locate::hot_spots(&study, before, after, HOT_SPOTS);
    let hot_spots_after = locate::hot_spots(&study, after, after, HOT_SPOTS);
    let axes = axes::axes(&study, before, after);
    let grounds = Grounds {
        found: &findings,
        unknown: opened.unknown,
        refused: opened.refused,
        ranking: &ranking,
        structured: judged,
    };
    let verdict = verdict::verdict(&grounds);
    let moved = moved(before, after);
    let detail = opened.finer.last().filter(|_| !named).copied();
    let looks_like = opened.unknown.or(detail);
    let silhouettes = Silhouettes::of(&study, &simulation.occluders, after);
    let last = opened.path.last().and_then(|step| place(&rounds, step.fit));
    let finer = opened.finer;
    let (before, after) = ends(&study, first, rounds, base, last)?;
    seconds.insert("all".to_owned(), began.elapsed().as_secs_f64());
    // Of what is not explained there is a map, never a name.
    let (effects, unnamed) = match verdict {
        Verdict::Unexplained => (Vec::new(), findings.len()),
        _ => (findings, 0),
    };
    let mut diagnosis = Diagnosis {
        verdict,
        separate_by: separate_by(&effects),
        effects,
        unnamed,
        shared_exponent: None,
        occluders: silhouettes.as_ref().map(|s| s.told.clone()),
        looks_like,
        finer,
        ranking,
        sealed,
        unexplained_fraction: if judged[0] > 0.0 {
            (judged[1] / judged[0]).min(1.0)
        } else {
            0.0
        },
        hot_spots,
        hot_spots_after,
        sentence: String::new(),
        refits,
        baselines: behind,
        moved,
        command: None,
        assumptions: assumptions(capture, light, &study, ended_by_time, trifle),
        structured: structured.map(Structured::all),
        background: structured.map(|s| s.background),
        structured_sealed: structured_sealed.map(|(before, after)| [before, after]),
        axes,
        seconds,
    };
    diagnosis.sentence = sentence(&diagnosis);
    diagnosis.shared_exponent = shared_exponent(&diagnosis.effects);
    Ok(Outcome {
        diagnosis,
        study,
        before,
        after,
        silhouettes,
    })
}

/// What to say where the time is over before effects were compared once, which is done all the same: a verdict without it would say
/// nothing.
fn beyond(time_limit: Option<f64>, baseline: f64) -> Option<String> {
    let first_round = FIRST_ROUND * baseline;
    (time_limit? < baseline + first_round).then(|| {
        format!(
            "the time limit is too short to compare effects once: that takes about {first_round:.0} s more, and is done all the same"
        )
    })
}

/// Effects that are all in the model are no alternatives to each other.
fn apart(mut findings: Vec<Finding>) -> Vec<Finding> {
    let all: Vec<&str> = findings.iter().map(|finding| finding.id).collect();
    for finding in &mut findings {
        finding.ambiguous_with.retain(|other| !all.contains(other));
    }
    findings
}

/// Round and rank of a model among those that stand.
fn place(rounds: &[Round], fit: &Fit) -> Option<[usize; 2]> {
    let rank = |round: &Round| {
        let mut standing = round.standing.iter();
        standing.position(|(_, other)| std::ptr::eq(other, fit))
    };
    let mut rounds = rounds.iter().enumerate();
    rounds.find_map(|(k, round)| Some([k, rank(round)?]))
}

/// The first model, which is that of round `base` without any effect more, and the last, which is at `last` or the same, out of all
/// that were tried; the others are let go.
fn ends(
    study: &Study<'_>,
    first: Fit,
    rounds: Vec<Round>,
    base: usize,
    last: Option<[usize; 2]>,
) -> Result<(Fit, Fit), FitError> {
    let (mut before, mut after) = (first, None);
    for (k, round) in rounds.into_iter().enumerate() {
        if let Some([_, rank]) = last.filter(|[at, _]| *at == k) {
            after = round.standing.into_iter().nth(rank);
        }
        if k == base {
            before = round.null;
        }
    }
    let after = match after {
        Some((_, fit)) => fit,
        None => before.duplicate(study)?,
    };
    Ok((before, after))
}

/// What is known of a capture's light.
pub fn light_of(capture: &Capture) -> Light {
    match capture.lamps {
        None => Light::Environment,
        Some(_) => Light::Lamps,
    }
}

/// Scores these effects at a fit.
///
/// # Errors
/// A bug of the tape.
pub fn screen_at(
    study: &Study<'_>,
    fit: &Fit,
    effects: impl Iterator<Item = &'static dyn Effect>,
) -> Result<Screen, FitError> {
    let jacobian = Jacobian::new(study, fit)?;
    let candidates = jacobian.candidates(study, fit, effects)?;
    Ok(screen(study, &jacobian, &candidates))
}

/// The effects of these names and the capacity candidates; all that such light lets tell when none is named.
///
/// # Errors
/// A name that is unknown, or of an effect that such light does not let tell.
pub fn chosen(names: &[String], light: Light) -> Result<Vec<&'static dyn Effect>, DiagnoseError> {
    for name in names {
        let effect = effects::by_id(name).ok_or_else(|| DiagnoseError::Unknown(name.clone()))?;
        if !effect.under(light) {
            return Err(DiagnoseError::OtherLight {
                name: name.clone(),
                light,
            });
        }
    }
    Ok(effects::all()
        .into_iter()
        .filter(|e| e.under(light))
        .filter(|e| names.is_empty() || e.is_capacity() || names.iter().any(|n| n == e.id()))
        .collect())
}

/// Why a diagnosis could not be made.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The capture does not show enough.
    #[error(transparent)]
    Study(#[from] StudyError),
    /// The tape failed.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// An effect that such light does not let tell.
    #[error(
        "`{name}` is an effect of captures whose light is {}: leave it out of --effects", match light {
            Light::Environment => "known (`lamp` in transforms.json); this one's is not",
            Light::Lamps => "unknown; this one's lamps are known (`lamp` in transforms.json)",
        }
    )]
    OtherLight {
        /// Its name.
        name: String,
        /// The light of the capture.
        light: Light,
    },
    /// The caller asked for the end.
    #[error("interrupted")]
    Interrupted,
    /// A name that no effect has.
    #[error("there is no effect called `{0}`; `eclipse diagnose --help` lists them")]
    Unknown(String),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_limit_that_ends_before_the_first_comparison_is_told() {
        assert_eq!(beyond(None, 100.0), None);
        assert_eq!(beyond(Some(31.0), 10.0), None);
        let told = beyond(Some(29.0), 10.0).unwrap();
        assert!(told.contains("about 20 s more"), "{told}");
    }

    #[test]
    fn what_is_found_beside_an_effect_is_no_alternative_to_it() {
        let first = Finding::example("lamp_direction", vec!["normal_error", "response_curve"]);
        let second = Finding::example("response_curve", Vec::new());
        let kept = apart(vec![first, second]);
        assert_eq!(kept[0].ambiguous_with, ["normal_error"]);
    }
}
