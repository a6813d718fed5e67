//! What a diagnosis tells of scores and of models.

use std::collections::BTreeMap;

use super::{
    compete::Choice,
    diagnosis::{Finding, Ranked},
    effects,
    fit::Fit,
    score::{Score, Screen},
    sealed::Gain,
};

/// Of a screening, in its order.
pub fn ranked(screen: &Screen) -> Vec<Ranked> {
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

/// Of an effect in the model `fit`.
pub fn finding(choice: &Choice, fit: &Fit, gain: Gain) -> Finding {
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
pub fn moved(before: &Fit, after: &Fit) -> BTreeMap<String, f64> {
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
