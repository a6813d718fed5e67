//! The first screening again behind occluders: flexible masks swallow effects, and an occluder that the model lacks passes for
//! others. What is found behind all baselines is no occluder's.

use std::collections::BTreeMap;

use super::{
    compete::LEAST_SIGMA,
    diagnosis::Ranked,
    effects::{self, Effect},
    fit::{Fit, FitError},
    linearise::{Candidate, Jacobian},
    score::{Screen, screen},
    study::Study,
    told::ranked,
};

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
    effects: &[&'static dyn Effect],
) -> Result<(Screen, BTreeMap<String, Vec<Ranked>>), FitError> {
    let jacobian = Jacobian::new(study, fit)?;
    let all = effects.iter().copied();
    let candidates: Vec<Candidate> = all
        .map(|effect| jacobian.candidate(study, fit, effect))
        .collect::<Result<_, _>>()?;
    let first = screen(study, &jacobian, &candidates);
    let stands = |id: &str| {
        let own = first.scores.iter().find(|score| score.id == id);
        own.is_some_and(|score| score.gain > LEAST_SIGMA * score.gain_se)
    };
    let is_occluder = |id: &str| BASELINES.iter().any(|(_, occluder)| *occluder == id);
    let (occluders, mut others): (Vec<_>, Vec<_>) = candidates
        .into_iter()
        .partition(|candidate| is_occluder(candidate.effect.id()));
    others.retain(|other| !other.effect.is_capacity() && stands(other.effect.id()));
    let mut behind = BTreeMap::new();
    let mut jacobian = jacobian;
    for (name, id) in BASELINES {
        if others.is_empty() {
            break;
        }
        match occluders.iter().find(|own| own.effect.id() == id) {
            Some(occluder) => jacobian.take_for_granted(occluder),
            // The caller did not ask for it as an effect.
            None => match effects::by_id(id) {
                Some(effect) => {
                    let occluder = jacobian.candidate(study, fit, effect)?;
                    jacobian.take_for_granted(&occluder);
                }
                None => break,
            },
        }
        behind.insert(name.to_owned(), ranked(&screen(study, &jacobian, &others)));
    }
    Ok((first, behind))
}
