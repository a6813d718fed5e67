//! Which effect is added next, if any, and which others do as well.

use super::{
    effects,
    score::{Score, Screen},
    statistics::{holm, paired},
};

/// A gain must be this many standard errors.
const LEAST_SIGMA: f64 = 3.0;
/// A gain must be at least this share of the held-out error: smaller ones are within what a model's discretisation does.
const LEAST_SHARE: f64 = 0.004;
/// Corrected probability below which a gain is not chance.
const LEVEL: f64 = 0.01;

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

/// The best physics of a screening that stands up, or `None`.
///
/// Capacity candidates have many numbers for what physics does with few. One of them stops a piece of physics only when it
/// gains more than twice as much: then the physics was a symptom of a model that is too coarse.
pub fn choose(screen: &Screen) -> Option<Choice> {
    let p: Vec<f64> = screen.scores.iter().map(|s| s.p).collect();
    let corrected = holm(&p);
    let capacity = |s: &Score| effects::by_id(s.id).is_some_and(|e| e.is_capacity());
    let interest = |s: &Score| effects::by_id(s.id).map_or(0.0, |e| e.interest());
    let (best, p_holm) = screen
        .scores
        .iter()
        .zip(&corrected)
        .find(|(s, p)| !capacity(s) && stands(s, **p, screen) && s.size > interest(s))
        .map(|(s, p)| (s.clone(), *p))?;
    let rival = screen
        .scores
        .iter()
        .filter(|s| capacity(s))
        .map(|s| s.gain)
        .fold(0.0, f64::max);
    if rival > 2.0 * best.gain {
        return None;
    }
    let ambiguous_with = screen
        .scores
        .iter()
        .filter(|s| s.id != best.id && !capacity(s) && s.gain > 0.0)
        .filter(|s| {
            let differences: Vec<f64> = best
                .blocks
                .iter()
                .zip(&s.blocks)
                .filter(|(a, b)| **a != 0.0 || **b != 0.0)
                .map(|(a, b)| a - b)
                .collect();
            let (difference, error) = paired(&differences);
            difference < 2.0 * error && s.gain > 0.5 * best.gain
        })
        .map(|s| s.id)
        .take(2)
        .collect();
    Some(Choice {
        score: best,
        p_holm,
        ambiguous_with,
    })
}

fn stands(score: &Score, p_holm: f64, screen: &Screen) -> bool {
    score.gain > LEAST_SIGMA * score.gain_se
        && p_holm < LEVEL
        && score.gain > LEAST_SHARE * screen.before
}
