//! Contenders in the full model: whoever screening puts first is refitted, and the refits decide.
//!
//! Screening predicts gains at a linearisation; what light and texture take up when they are free to follow, only a refit
//! tells. All refits, that of the model as it is among them, take the same steps and are judged by one covariance.

use super::{
    compete::{Choice, Contender},
    diagnose::DiagnoseError,
    effects::{self, Term},
    fit::Fit,
    score::Score,
    study::Study,
};

/// Steps of a refit: with fewer, effects that light can imitate have not parted from it.
pub const STEPS: usize = 12;

/// What refits say.
pub struct Round {
    /// The model without any effect more, refitted just as long.
    pub null: Fit,
    /// The effect to be added with its model; `None` when none stands up.
    pub winner: Option<(Choice, Fit)>,
    /// Every refit's effect and evidence, best first.
    ///
    /// Evidence is twice a logarithm, in units of χ²: the gain over the model without the effect refitted just as long, less what
    /// its numbers cost.
    pub evidence: Vec<(&'static str, f64)>,
}

/// Refits `fit` with every contender; `report` is told which.
///
/// # Errors
/// A bug of the tape, or whatever `report` answers.
pub fn round(
    study: &Study<'_>,
    fit: &Fit,
    contenders: Vec<Contender>,
    report: &dyn Fn(&str) -> Result<(), DiagnoseError>,
) -> Result<Round, DiagnoseError> {
    report("refit without any further effect")?;
    let mut null = fit.duplicate(study)?;
    null.refine(study, STEPS)?;
    let before = null.cost_by(study, &null);
    let mut refits = Vec::new();
    for contender in contenders {
        let score = &contender.score;
        report(&format!("refit with {}", score.id))?;
        let effect =
            effects::by_id(score.id).ok_or_else(|| DiagnoseError::Unknown(score.id.to_owned()))?;
        let mut with = fit.duplicate(study)?;
        with.forget_frames();
        with.add(effect, score.beta.clone());
        with.refine(study, STEPS)?;
        let gain = 2.0 * (before - with.cost_by(study, &null)) + unusual(&null) - unusual(&with);
        let evidence = gain - price(&with, score);
        tracing::debug!(id = score.id, gain, evidence, "refit");
        refits.push((contender, with, evidence));
    }
    refits.sort_by(|a, b| b.2.total_cmp(&a.2));
    let evidence: Vec<(&'static str, f64)> =
        refits.iter().map(|(c, _, e)| (c.score.id, *e)).collect();
    let best = refits.into_iter().next().filter(|(best, _, evidence)| {
        // More freedom for what the model has already explains it best: no physics is needed.
        *evidence > 0.0 && !effects::by_id(best.score.id).is_some_and(|e| e.is_capacity())
    });
    let winner = best.map(|(best, fit, most)| {
        let as_good = |id: &&'static str| {
            let other = evidence.iter().find(|(other, _)| other == id);
            other.is_some_and(|(_, e)| *e > 0.5 * most)
        };
        let choice = Choice {
            p_holm: best.p_holm,
            ambiguous_with: best.rivals.into_iter().filter(as_good).collect(),
            score: best.score,
        };
        (choice, fit)
    });
    Ok(Round {
        null,
        winner,
        evidence,
    })
}

/// How far the effects' numbers are from what is usual, in standard deviations, squared.
fn unusual(fit: &Fit) -> f64 {
    let numbers = fit.active.iter().filter_map(|active| {
        let link = fit.link(active.effect.id())?;
        Some(link.terms.iter().zip(&active.beta))
    });
    numbers
        .flatten()
        .map(|(term, beta)| (beta / term.scale).powi(2))
        .sum()
}

/// What an effect's numbers cost beyond that: how much of their range the data rule out (the logarithm of Occam's factor in
/// Laplace's approximation, number by number; MacKay, Neural Computation 4, 1992).
fn price(fit: &Fit, score: &Score) -> f64 {
    let Some(link) = fit.link(score.id) else {
        return f64::INFINITY;
    };
    let price = |(k, term): (usize, &Term)| {
        let error = score.standard_error.get(k).copied().unwrap_or(term.scale);
        2.0 * (term.scale / error.max(1e-12)).max(1.0).ln()
    };
    link.terms.iter().enumerate().map(price).sum()
}
