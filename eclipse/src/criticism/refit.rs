//! Contenders in the full model: whoever screening puts first is refitted, and the refits decide.
//!
//! Screening predicts gains at a linearisation; what light and texture take up when they are free to follow, only a refit
//! tells. All refits, that of the model as it is among them, take the same steps and are judged by one covariance.

use std::sync::Arc;

use super::{
    compete::{Choice, Contender},
    diagnose::{DiagnoseError, screen_at},
    effects::{self, Effect, Term},
    fit::Fit,
    nuisance::Nuisance,
    precision::Precision,
    score::Score,
    study::Study,
};

/// Steps of a refit: with fewer, effects that light can imitate have not parted from it.
pub const STEPS: usize = 12;

/// A stand-in's evidence over that of the best physics, from which on no physics of the table is named: it has a number for
/// everything that physics says with few, and comes close to any truth. A third of it must be left unsaid.
const FAR_BETTER: f64 = 1.5;

/// Evidence of a later effect, as a share of that of the strongest before it, below which it is not named: no effect's few numbers are the
/// truth's own, and where the first one's errs by a seventh of its amplitude, a fiftieth of what it gains is left for others to take.
/// More cannot be asked: a black level that shows in all of the background has twenty times the evidence of a true vignette.
const TRIFLE: f64 = 0.02;

/// What refits say.
pub struct Round {
    /// The model without any effect more, refitted just as long.
    pub null: Fit,
    /// Physics whose evidence speaks for it, best first, with its model; none where more freedom does better.
    pub standing: Vec<(Choice, Fit)>,
    /// A capacity candidate that does better than all physics, with its model: the search goes on from there, since what physics
    /// seemed to do may have been a symptom of a model that is too coarse.
    pub finer: Option<(&'static str, Fit)>,
    /// A stand-in for physics outside the table that does far better than any within, with its model: it comes before those, which
    /// are asked only where sealed data refuse it.
    pub unknown: Option<(&'static str, Fit)>,
    /// Every refit's effect and evidence, best first; stand-ins that do not far better than physics come after it.
    ///
    /// Evidence is twice a logarithm, in units of χ²: the gain over the model without the effect refitted just as long, how usual
    /// light, texture, lobe and effects are included, less what the effect's numbers cost.
    pub evidence: Vec<(&'static str, f64)>,
}

impl Round {
    /// The physics that does best, where it does no more than make up for what the models of physics in `former` rounds may leave.
    pub fn trifle(&self, former: &[Self]) -> Option<&'static str> {
        let own = |round: &Self| {
            let (best, _) = round.standing.first()?;
            let mut all = round.evidence.iter().copied();
            all.find(|(id, _)| *id == best.score.id)
        };
        let former = former.iter().filter_map(own).map(|(_, evidence)| evidence);
        let (id, evidence) = own(self).filter(|_| self.unknown.is_none())?;
        is_trifle(evidence, former).then_some(id)
    }

    /// The model from which the search goes on, unless there is nothing left to look for: nothing is looked for beside what no name
    /// is known for.
    pub fn best(&self) -> Option<&Fit> {
        if self.unknown.is_some() {
            return None;
        }
        let physics = self.standing.first().map(|(_, fit)| fit);
        physics.or(self.finer.as_ref().map(|(_, fit)| fit))
    }
}

/// Refits `fit`, at which `nuisance` was linearised, with every contender; `report` is told which.
///
/// # Errors
/// A bug of the tape, or whatever `report` answers.
pub fn round(
    study: &Study<'_>,
    fit: &Fit,
    nuisance: &Arc<Nuisance>,
    contenders: Vec<Contender>,
    report: &dyn Fn(&str) -> Result<(), DiagnoseError>,
) -> Result<Round, DiagnoseError> {
    report("refit without any further effect")?;
    // All begin alike.
    let begin = || beginning(study, fit, nuisance);
    let mut null = begin()?;
    null.refine(study, STEPS)?;
    let precision = fit.precision(study, &|i| study.develops(i));
    let mut refits = Vec::new();
    for contender in contenders {
        let score = &contender.score;
        report(&format!("refit with {}", score.id))?;
        let mut with = started(study, &begin, &precision, score)?;
        with.refine(study, STEPS)?;
        let evidence = gain(study, &null, &with) - price(&with, score);
        tracing::debug!(id = score.id, evidence, "refit");
        refits.push((contender, with, evidence));
    }
    refits.sort_by(|a, b| b.2.total_cmp(&a.2));
    let evidence: Vec<(&'static str, f64)> =
        refits.iter().map(|(c, _, e)| (c.score.id, *e)).collect();
    let as_good = |id: &str, most: f64| {
        let other = evidence.iter().find(|(other, _)| *other == id);
        other.is_some_and(|(_, e)| *e > 0.5 * most)
    };
    let is_physics = |id: &str| effects::by_id(id).is_some_and(|e| !e.is_capacity());
    let best = evidence.iter().find(|(id, _)| is_physics(id));
    let physics = best.map_or(0.0, |(_, evidence)| evidence.max(0.0));
    let (mut standing, mut finer, mut unknown) = (Vec::new(), None, None);
    for (contender, fit, own) in refits {
        if own <= 0.0 {
            break;
        }
        let known = effect(contender.score.id)?;
        if known.stands_for_unknown() {
            if own > FAR_BETTER * physics {
                unknown = Some((known.id(), fit));
            }
            continue;
        }
        if known.is_capacity() {
            // More freedom for what the model has already explains it better than whatever follows.
            if standing.is_empty() && unknown.is_none() {
                finer = Some((known.id(), fit));
            }
            break;
        }
        let rivals = contender.rivals.into_iter();
        let choice = Choice {
            p_holm: contender.p_holm,
            ambiguous_with: rivals.filter(|id| as_good(id, own)).collect(),
            score: contender.score,
        };
        standing.push((choice, fit));
    }
    let mut evidence = evidence;
    let leads = |id: &str| unknown.as_ref().is_some_and(|(best, _)| *best == id);
    let stands_in = |id: &str| effects::by_id(id).is_some_and(|e| e.stands_for_unknown());
    evidence.sort_by_key(|(id, _)| stands_in(id) && !leads(id));
    Ok(Round {
        null,
        standing,
        finer,
        unknown,
        evidence,
    })
}

/// What `begin` makes with one effect more, from the linear estimate or from the null, whichever is closer to the photographs: where
/// light does most of what screening saw, the estimate without the light's part is far off.
fn started(
    study: &Study<'_>,
    begin: &dyn Fn() -> Result<Fit, DiagnoseError>,
    precision: &Precision,
    score: &Score,
) -> Result<Fit, DiagnoseError> {
    let at = |beta: Vec<f64>| -> Result<(Fit, f64), DiagnoseError> {
        let mut with = begin()?;
        with.add(effect(score.id)?, beta);
        with.relink(study)?;
        let cost = with.cost_under(study, precision);
        Ok((with, cost))
    };
    let (estimated, null) = (at(score.beta.clone())?, at(Vec::new())?);
    let closer = if estimated.1 < null.1 {
        estimated
    } else {
        null
    };
    Ok(closer.0)
}

/// `fit` refitted with an effect that is known to be true, as a round refits a contender.
///
/// # Errors
/// A bug of the tape.
pub fn told(
    study: &Study<'_>,
    fit: &Fit,
    effect: &'static dyn Effect,
) -> Result<Fit, DiagnoseError> {
    let screen = screen_at(study, fit, std::iter::once(effect))?;
    let begin = || beginning(study, fit, &screen.nuisance);
    let precision = fit.precision(study, &|i| study.develops(i));
    let mut with = match screen.scores.first() {
        Some(score) => started(study, &begin, &precision, score)?,
        // It has nothing to say of these photographs.
        None => begin()?,
    };
    with.refine(study, STEPS)?;
    Ok(with)
}

/// `fit` with nothing kept of what numbers of single frames took up for want of a better explanation.
fn beginning(study: &Study<'_>, fit: &Fit, nuisance: &Arc<Nuisance>) -> Result<Fit, DiagnoseError> {
    let mut fit = fit.duplicate(study)?;
    fit.forget_frames();
    fit.precondition(nuisance.clone());
    Ok(fit)
}

fn is_trifle(evidence: f64, former: impl Iterator<Item = f64>) -> bool {
    evidence < TRIFLE * former.fold(0.0, f64::max)
}

fn effect(id: &str) -> Result<&'static dyn effects::Effect, DiagnoseError> {
    effects::by_id(id).ok_or_else(|| DiagnoseError::Unknown(id.to_owned()))
}

/// Twice the difference of the logarithms of both models' probabilities, by one noise; how much sites' albedos scatter is each
/// model's own, so that its determinant counts.
fn gain(study: &Study<'_>, null: &Fit, with: &Fit) -> f64 {
    let unlikely = |fit: &Fit| {
        let precision = fit.precision_beside(study, [null, with], &|i| study.develops(i));
        let misfit = 2.0 * fit.cost_under(study, &precision) + precision.log_determinant();
        let (unusual, effects) = (fit.unusual(), effects_unusual(fit));
        let (inflation, tau, lobe) = (fit.inflation, fit.tau, fit.lobe);
        tracing::debug!(misfit, unusual, effects, inflation, ?tau, ?lobe, "compared");
        misfit + unusual + effects
    };
    unlikely(null) - unlikely(with)
}

/// How far the effects' numbers are from what is usual, in standard deviations, squared.
fn effects_unusual(fit: &Fit) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_first_effect_may_leave_is_no_second_one() {
        assert!(!is_trifle(5.0, [].into_iter()));
        assert!(is_trifle(70.0, [4000.0, 90.0].into_iter()));
        assert!(!is_trifle(100.0, [4000.0, 90.0].into_iter()));
    }
}
