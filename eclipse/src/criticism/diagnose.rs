//! The procedure: fit, screen, compete, refit, open the sealed data, judge.

use std::{collections::BTreeMap, time::Instant};

use super::{
    compete::{self, Choice},
    diagnosis::{Diagnosis, Finding, Judged, Ranked, Refitted, Sealed},
    effects::{self, Effect},
    fit::{Fit, FitError},
    light::Light,
    linearise::{Candidate, Jacobian},
    locate, refit,
    score::{Score, Screen, screen},
    sealed,
    study::{Simulation, Study, StudyError},
    verdict,
};
use crate::capture::Capture;

/// Steps that bring the baseline near its best before effects are screened.
const BASELINE_STEPS: usize = 9;
/// Effects that are added at most.
const MOST_EFFECTS: usize = 3;
/// Standard errors that an effect must gain on sealed data. An effect that just stands up on held-out patches, at three, shows 1.3 in a
/// sixth as much data; half of that parts it best from none.
const SEALED_SIGMA: f64 = 0.6;
/// More photographs than these are compared at fewer places each, or memory would grow with their square.
const MANY_FRAMES: usize = 64;
/// Hot spots that are told.
const HOT_SPOTS: usize = 12;

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
    /// Seconds after which no further effect is looked for.
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
    let light = match capture.lamps {
        None => Light::Environment,
        Some(_) => Light::Lamps,
    };
    let candidates = chosen(&options.effects, light)?;
    report("visibility of the surface")?;
    let study = Study::new(
        capture,
        simulation,
        options.sites * MANY_FRAMES / capture.frames.len().max(MANY_FRAMES),
        options.rows,
        options.seed,
    )?;
    report("light and texture at their best without any effect")?;
    let mut first = Fit::start(&study)?;
    first.refine(&study, BASELINE_STEPS)?;
    seconds.insert("baseline".to_owned(), began.elapsed().as_secs_f64());

    let mut fits = vec![first];
    let mut found: Vec<Choice> = Vec::new();
    let mut ranking = Vec::new();
    let mut refits: Vec<Refitted> = Vec::new();
    let mut baselines = BTreeMap::new();
    loop {
        let fit = &fits[fits.len() - 1];
        report("screening effects")?;
        let screened = Instant::now();
        let screened_effects = candidates
            .iter()
            .copied()
            .filter(|e| !fit.active.iter().any(|a| a.effect.id() == e.id()));
        let result = screen_at(&study, fit, screened_effects)?;
        seconds.insert(
            format!("screen {}", found.len() + 1),
            screened.elapsed().as_secs_f64(),
        );
        for score in &result.scores {
            tracing::debug!(
                id = score.id,
                gain = score.gain,
                se = score.gain_se,
                p = score.p,
                size = score.size,
                "score"
            );
        }
        if ranking.is_empty() {
            ranking = ranked(&result);
        } else {
            let inside: Vec<&str> = fit.active.iter().map(|a| a.effect.id()).collect();
            baselines.insert(format!("with {}", inside.join(", ")), ranked(&result));
        }
        let late = options
            .time_limit
            .is_some_and(|limit| began.elapsed().as_secs_f64() > limit);
        if found.len() >= MOST_EFFECTS || (late && !found.is_empty()) {
            break;
        }
        let contenders = compete::contenders(&result);
        if contenders.is_empty() {
            break;
        }
        let refitted = Instant::now();
        let round = refit::round(&study, fit, contenders, &|text| report(text))?;
        seconds.insert(
            format!("refits {}", found.len() + 1),
            refitted.elapsed().as_secs_f64(),
        );
        if found.is_empty() {
            put_first(&mut ranking, &round.evidence);
        }
        refits.extend(round.evidence.iter().map(|&(id, evidence)| Refitted {
            after: found.len(),
            id,
            evidence,
            sealed: None,
        }));
        if let Some(last) = fits.last_mut() {
            *last = round.null;
        }
        let Some((choice, next)) = round.winner else {
            break;
        };
        found.push(choice);
        fits.push(next);
    }

    report("opening the sealed data")?;
    let judge = &fits[0];
    let errors: Vec<sealed::Errors> = fits
        .iter()
        .map(|fit| sealed::errors(&study, fit, judge))
        .collect();
    let mut findings = Vec::new();
    let mut confirmed = 0;
    for (k, choice) in found.iter().enumerate() {
        // Numbers of a sealed frame's own are unknown there, whichever effect they belong to.
        let gain = sealed::gain(&errors[k], &errors[k + 1], is_shared(&fits[k + 1]));
        // Held-out patches have made the case; sealed data may refuse it.
        let stands = gain.gain > SEALED_SIGMA * gain.error;
        let own = |r: &&mut Refitted| r.after == k && r.id == choice.score.id;
        if let Some(refit) = refits.iter_mut().find(own) {
            refit.sealed = Some(Judged {
                gain: gain.gain,
                gain_se: gain.error,
                confirmed: stands,
            });
        }
        if !stands {
            break;
        }
        confirmed = k + 1;
        findings.push(finding(choice, &fits[k + 1], gain));
    }
    fits.truncate(confirmed + 1);
    let all_shared = is_shared(&fits[confirmed]);
    let (first_errors, last_errors) = (&errors[0], &errors[confirmed]);
    let count = (first_errors.counts[0]
        + if all_shared {
            first_errors.counts[1]
        } else {
            0
        })
    .max(1);
    let sealed = Sealed {
        chi2_before: first_errors.chi2(all_shared) / count as f64,
        chi2_after: last_errors.chi2(all_shared) / count as f64,
        rmse_before: first_errors.rmse(),
        rmse_after: last_errors.rmse(),
    };
    let structured = [0, confirmed].map(|k| locate::structured_energy(&study, &fits[k]));
    let hot_spots = locate::hot_spots(&study, &fits[0], HOT_SPOTS);
    let hot_spots_after = locate::hot_spots(&study, &fits[confirmed], HOT_SPOTS);
    let axes = locate::axes(&study, &fits[0], &fits[confirmed]);
    let verdict = verdict::verdict(&findings, &ranking, structured);
    let moved = moved(&fits[0], &fits[confirmed]);
    seconds.insert("all".to_owned(), began.elapsed().as_secs_f64());
    let mut diagnosis = Diagnosis {
        verdict,
        effects: findings,
        ranking,
        sealed,
        unexplained_fraction: if structured[0] > 0.0 {
            (structured[1] / structured[0]).min(1.0)
        } else {
            0.0
        },
        hot_spots,
        hot_spots_after,
        sentence: String::new(),
        refits,
        baselines,
        moved,
        command: None,
        assumptions: assumptions(capture, light, &study),
        structured,
        axes,
        seconds,
    };
    diagnosis.sentence = verdict::sentence(&diagnosis);
    let after = fits.pop();
    let before = if fits.is_empty() {
        None
    } else {
        Some(fits.remove(0))
    };
    let (before, after) = match (before, after) {
        (Some(before), Some(after)) => (before, after),
        (_, Some(only)) => (only.duplicate(&study)?, only),
        _ => return Err(DiagnoseError::Unknown("no model".to_owned())),
    };
    Ok(Outcome {
        diagnosis,
        study,
        before,
        after,
    })
}

/// What was taken for granted.
fn assumptions(capture: &Capture, light: Light, study: &Study<'_>) -> Vec<String> {
    let mut all = Vec::new();
    if light == Light::Lamps {
        all.push("One distant lamp a frame, with the direction and the strength that the capture says, and no other light.".into());
        let ball = capture.lamps.as_ref().is_some_and(|lamps| lamps.ball);
        all.push(format!(
            "A Lambertian surface of the given shape{}. Its albedo is free in every place, smooth but for what the places' scatter \
             says; one scale, by colour, is free for all lamps together.",
            if ball {
                ", a ball, dark where it turns away from the lamp"
            } else {
                ", which casts shadows on itself"
            }
        ));
    }
    if study.seen.eight_bits {
        all.push(
            "The photographs hold 256 levels at most: rounding to them counts as noise. PNG and JPEG files are read as sRGB unless \
             the capture's `color_encoding` says otherwise; where that is wrong, response_curve tells.".into(),
        );
    }
    all
}

/// Whether no effect of the model has numbers of single frames.
fn is_shared(fit: &Fit) -> bool {
    let mut terms = fit.links.iter().flat_map(|link| link.terms.iter());
    terms.all(|term| term.frame.is_none())
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
    let candidates: Vec<Candidate> = effects
        .map(|effect| jacobian.candidate(study, fit, effect))
        .collect::<Result<_, _>>()?;
    Ok(screen(study, &jacobian, &candidates))
}

/// The effects of these names and the capacity candidates; all that such light lets tell when none is named.
fn chosen(names: &[String], light: Light) -> Result<Vec<&'static dyn Effect>, DiagnoseError> {
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

/// Puts what was refitted before the rest, in the order of the refits' evidence.
fn put_first(ranking: &mut [Ranked], evidence: &[(&'static str, f64)]) {
    let place = |id: &str| evidence.iter().position(|(other, _)| *other == id);
    ranking.sort_by_key(|r| place(r.id).unwrap_or(evidence.len()));
}

fn ranked(screen: &Screen) -> Vec<Ranked> {
    screen
        .scores
        .iter()
        .map(|s| Ranked {
            id: s.id,
            gain: s.gain,
            gain_se: s.gain_se,
            p: s.p,
            size: s.size,
            survival: s.survival,
            minimum_detectable: s.minimum_detectable,
            capacity: effects::by_id(s.id).is_some_and(|e| e.is_capacity()),
        })
        .collect()
}

fn finding(choice: &Choice, fit: &Fit, gain: sealed::Gain) -> Finding {
    let score: &Score = &choice.score;
    let beta = fit
        .active
        .iter()
        .find(|a| a.effect.id() == score.id)
        .map_or(&score.beta, |a| &a.beta);
    let named = |values: &[f64]| -> BTreeMap<String, f64> {
        score
            .names
            .iter()
            .cloned()
            .zip(values.iter().copied())
            .collect()
    };
    let mut place = BTreeMap::new();
    let strongest = (0..beta.len()).max_by(|&a, &b| {
        let z = |k: usize| (beta[k] / score.standard_error[k].max(1e-12)).abs();
        z(a).total_cmp(&z(b)).then(b.cmp(&a))
    });
    if let Some(k) = strongest {
        place.insert("strongest".to_owned(), score.names[k].clone().into());
        let mut frames: Vec<u32> = (0..beta.len())
            .filter(|&i| (beta[i] / score.standard_error[i].max(1e-12)).abs() > 4.0)
            .filter_map(|i| score.frames[i])
            .collect();
        frames.dedup();
        if !frames.is_empty() {
            place.insert("frames".to_owned(), frames.into());
        }
    }
    Finding {
        id: score.id,
        parameters: named(beta),
        standard_errors: named(&score.standard_error),
        sealed_gain: gain.gain,
        sealed_gain_se: gain.error,
        p_holm: choice.p_holm,
        survival: score.survival,
        size: score.size,
        minimum_detectable: score.minimum_detectable,
        ambiguous_with: choice.ambiguous_with.clone(),
        place,
    }
}

/// Relative change of light and albedo, RMS.
fn moved(before: &Fit, after: &Fit) -> BTreeMap<String, f64> {
    let change = |a: &[f32], b: &[f32]| {
        let square = |x: f32| f64::from(x).powi(2);
        let top: f64 = a.iter().zip(b).map(|(a, b)| square(a - b)).sum();
        let bottom: f64 = a.iter().map(|a| square(*a)).sum();
        (top / bottom.max(1e-300)).sqrt()
    };
    BTreeMap::from([
        (
            "environment".to_owned(),
            change(&before.radiance, &after.radiance),
        ),
        ("albedo".to_owned(), change(&before.albedo, &after.albedo)),
    ])
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
