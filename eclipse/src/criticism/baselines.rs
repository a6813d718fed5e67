//! The first screening again behind occluders: flexible masks swallow effects, and an occluder that the model lacks passes for
//! others. What is found behind all baselines is no occluder's.

use std::collections::BTreeMap;

use super::{
    compete::LEAST_SIGMA,
    diagnose::screen_at,
    diagnosis::Ranked,
    effects::{self, Effect},
    fit::{Fit, FitError},
    linearise::{Candidate, Jacobian},
    score::{Screen, screen},
    study::Study,
    told::ranked,
};

/// Nobody, where the simulation has occluders already: these may have swallowed what is looked for.
pub const NONE: &str = "without the simulation's occluders";
/// Somebody who turns with the camera, and may step aside.
pub const SPARSE: &str = "with sparse occluders";
/// Besides, light taken away from any part of the sky in any frame.
pub const FULL: &str = "with full occluders";
/// Both, with what each adds to the one before.
const BASELINES: [(&str, &str); 2] = [(SPARSE, "moving_occluder"), (FULL, "finer_occluders")];

/// Scores all `effects` at a fit, and those that gain for sure once more behind occluders, sparse and full.
///
/// Occluders are nuisance there as light and texture are: their opacity, in which photographs are linear, is free between none and
/// all, and projected out.
///
/// # Errors
/// A bug of the tape.
pub fn screened(
    study: &Study<'_>,
    fit: &Fit,
    effects: impl Iterator<Item = &'static dyn Effect>,
) -> Result<(Screen, BTreeMap<String, Vec<Ranked>>), FitError> {
    let mut jacobian = Jacobian::new(study, fit)?;
    let mut candidates = jacobian.candidates(study, fit, effects)?;
    let first = screen(study, &jacobian, &candidates);
    let stands = |id: &str| {
        let own = first.scores.iter().find(|score| score.id == id);
        own.is_some_and(|score| score.gain > LEAST_SIGMA * score.gain_se)
    };
    let is_occluder = |id: &str| BASELINES.iter().any(|(_, occluder)| *occluder == id);
    let mut behind = BTreeMap::new();
    let occluders: Vec<Candidate> = candidates
        .extract_if(.., |candidate| is_occluder(candidate.effect.id()))
        .collect();
    candidates.retain(|other| !other.effect.is_capacity() && stands(other.effect.id()));
    if candidates.is_empty() {
        return Ok((first, behind));
    }
    for (name, id) in BASELINES {
        match occluders.iter().find(|own| own.effect.id() == id) {
            Some(occluder) => jacobian.take_for_granted(occluder),
            // The caller did not ask for it as an effect.
            None => {
                let own = effects::by_id(id).into_iter();
                for occluder in jacobian.candidates(study, fit, own)? {
                    jacobian.take_for_granted(&occluder);
                }
            }
        }
        let again = screen(study, &jacobian, &candidates);
        behind.insert(name.to_owned(), ranked(&again));
    }
    Ok((first, behind))
}

/// Scores all `effects` at a fit of `steps` steps without the occluders that the simulation has; `None` where it has none.
///
/// # Errors
/// A bug of the tape.
pub fn without_given(
    study: &mut Study<'_>,
    steps: usize,
    effects: impl Iterator<Item = &'static dyn Effect>,
) -> Result<Option<Vec<Ranked>>, FitError> {
    let Some(given) = study.given.take() else {
        return Ok(None);
    };
    let mut bare = Fit::start(study)?;
    bare.refine(study, steps)?;
    let scores = screen_at(study, &bare, effects)?;
    study.given = Some(given);
    Ok(Some(ranked(&scores)))
}
