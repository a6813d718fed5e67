//! Which effects are worth a refit, and which do as well as others.

use super::{
    effects,
    score::{Score, Screen},
    statistics::{holm, paired},
};

/// A gain must be this many standard errors.
pub const LEAST_SIGMA: f64 = 3.0;
/// A gain must be at least this share of the held-out error: smaller ones are within what a model's discretisation does.
const LEAST_SHARE: f64 = 0.004;
/// Corrected probability below which a gain is not chance.
const LEVEL: f64 = 0.01;

/// Refits of physics in a round.
const CONTENDERS: usize = 3;

/// The effect to be added.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Its score.
    pub score: Score,
    /// Probability corrected for all candidates.
    pub p_holm: f64,
    /// Physics within two paired standard errors.
    pub ambiguous_with: Vec<&'static str>,
}

/// Who is refitted.
pub struct Contender {
    /// Its score.
    pub score: Score,
    /// Probability corrected for all candidates.
    pub p_holm: f64,
    /// Physics whose gain lies within two paired standard errors of its own.
    pub rivals: Vec<&'static str>,
}

/// The physics of a screening that stands up, at most three, best first, a capacity candidate that gains far more, and the best
/// stand-in for physics outside the table.
///
/// Capacity candidates have many numbers for what physics does with few. One of them takes part when it gains more than twice
/// as much as the best physics: then the physics may be a symptom of a model that is too coarse; or when it stands up and no physics
/// does: what the model is too coarse for may hide it. A stand-in takes part when it gains at least half as much as physics, or when
/// none stands up.
pub fn contenders(screen: &Screen) -> Vec<Contender> {
    let p: Vec<f64> = screen.scores.iter().map(|s| s.p).collect();
    let corrected = holm(&p);
    let capacity = |s: &Score| effects::by_id(s.id).is_some_and(|e| e.is_capacity());
    let interest = |s: &Score| effects::by_id(s.id).map_or(0.0, |e| e.interest());
    let candidates = || screen.scores.iter().zip(&corrected);
    let standing: Vec<(&Score, &f64)> = candidates()
        .filter(|(s, p)| !capacity(s) && stands(s, **p, screen) && s.size > interest(s))
        .take(CONTENDERS)
        .collect();
    let most = standing.first().map(|(s, _)| s.gain);
    let unknown = |s: &Score| effects::by_id(s.id).is_some_and(|e| e.stands_for_unknown());
    let outdoes = |s: &Score, p: f64| match most {
        Some(most) => s.gain > 2.0 * most,
        None => stands(s, p, screen),
    };
    let finer = candidates().find(|(s, p)| capacity(s) && !unknown(s) && outdoes(s, **p));
    let stand_in = candidates()
        .find(|(s, p)| unknown(s) && stands(s, **p, screen) && s.gain > 0.5 * most.unwrap_or(0.0));
    let contender = |(score, p_holm): (&Score, &f64)| Contender {
        score: score.clone(),
        p_holm: *p_holm,
        rivals: screen
            .scores
            .iter()
            .filter(|s| s.id != score.id && !capacity(s) && within(score, s))
            .map(|s| s.id)
            .collect(),
    };
    let all = standing.into_iter().chain(finer).chain(stand_in);
    all.map(contender).collect()
}

/// Whether the difference of two gains is less than two standard errors of it.
fn within(best: &Score, other: &Score) -> bool {
    let pairs = best.blocks.iter().zip(&other.blocks);
    let differences: Vec<f64> = pairs
        .filter(|(a, b)| **a != 0.0 || **b != 0.0)
        .map(|(a, b)| a - b)
        .collect();
    let (difference, error) = paired(&differences);
    difference < 2.0 * error && other.gain > 0.5 * best.gain
}

fn stands(score: &Score, p_holm: f64, screen: &Screen) -> bool {
    score.gain > LEAST_SIGMA * score.gain_se
        && p_holm < LEVEL
        && score.gain > LEAST_SHARE * screen.before
}
