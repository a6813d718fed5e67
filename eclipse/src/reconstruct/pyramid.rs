//! Priors over the levels of a pyramid.

use render::pyramid::Pyramid;

/// The standard deviation of every value of a pyramid whose levels, finest first, have these; the pyramid's own weight
/// aᵏ of a level is divided out.
pub fn level_deviations(pyramid: &Pyramid, finest_first: &[f32]) -> Vec<f32> {
    let mut deviations = vec![0.0; pyramid.len()];
    let count = pyramid.levels().len();
    for k in 0..count {
        let deviation = finest_first[(count - 1 - k).min(finest_first.len() - 1)];
        deviations[pyramid.range(k)].fill(deviation / pyramid.level_weight(k) as f32);
    }
    deviations
}
