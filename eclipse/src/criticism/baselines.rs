//! The first screening again behind occluders: flexible masks swallow effects, and an occluder that the model lacks passes for
//! others. What is found behind all baselines is no occluder's.

use std::collections::BTreeMap;

use super::{
    diagnose::{DiagnoseError, screen_at},
    diagnosis::Ranked,
    effects::{self, Effect},
    fit::Fit,
    score::Screen,
    study::Study,
    told::ranked,
};

/// Somebody who turns with the camera, and may step aside.
pub const SPARSE: &str = "with sparse occluders";
/// Besides, light taken away from any part of the sky in any frame.
pub const FULL: &str = "with full occluders";
/// Both, with what each adds to the one before.
const BASELINES: [(&str, &str); 2] = [(SPARSE, "moving_occluder"), (FULL, "finer_occluders")];

/// Steps that bring a baseline near its best.
const STEPS: usize = 8;

/// Screens `candidates` at `null` behind occluders, sparse and full, which begin as `first`, the screening without, has them.
///
/// # Errors
/// A bug of the tape, or whatever `report` answers.
pub fn screened(
    study: &Study<'_>,
    null: &Fit,
    first: &Screen,
    candidates: &[&'static dyn Effect],
    report: &dyn Fn(&str) -> Result<(), DiagnoseError>,
) -> Result<BTreeMap<String, Vec<Ranked>>, DiagnoseError> {
    let mut fit = null.duplicate(study)?;
    let mut all = BTreeMap::new();
    for (name, id) in BASELINES {
        let effect = effects::by_id(id).ok_or_else(|| DiagnoseError::Unknown(id.to_owned()))?;
        report(&format!("screening effects {name}"))?;
        let estimate = first.scores.iter().find(|score| score.id == id);
        fit.add(effect, estimate.map_or(Vec::new(), |s| s.beta.clone()));
        fit.relink(study)?;
        fit.refine(study, STEPS)?;
        let inside = |id: &str| fit.active.iter().any(|a| a.effect.id() == id);
        let outside = candidates.iter().copied().filter(|e| !inside(e.id()));
        all.insert(name.to_owned(), ranked(&screen_at(study, &fit, outside)?));
    }
    Ok(all)
}
