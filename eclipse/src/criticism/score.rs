//! Scores: how much better held-out patches are explained with an effect than without, nothing refitted.
//!
//! The nuisance is projected out (Neyman's C(α)) in each fold's training data, the effect is estimated there, and both
//! models predict the patches left out. Gains are sums of squares in units of the noise.

use std::sync::Arc;

use rayon::prelude::*;

use super::{
    bounded::bounded,
    detectable::Own,
    effects::Term,
    gram::Matrix,
    linearise::{Candidate, Jacobian},
    nuisance::Nuisance,
    reduce::{Gram, Layout, Reduced, System},
    split::FOLDS,
    statistics::{paired, sign_flips},
    study::Study,
};

/// What screening says of an effect.
#[derive(Clone, Debug)]
pub struct Score {
    /// The effect.
    pub id: &'static str,
    /// Reduction of the squared error on held-out patches, in units of the noise.
    pub gain: f64,
    /// Its standard error from the differences between blocks.
    pub gain_se: f64,
    /// Probability of such a gain without the effect, by signs of blocks.
    pub p: f64,
    /// Gain of each block.
    pub blocks: Vec<f64>,
    /// One-step estimate of the effect's numbers.
    pub beta: Vec<f64>,
    /// Their standard errors.
    pub standard_error: Vec<f64>,
    /// Share of the effect's signal that light, material and the model's other effects cannot imitate.
    pub survival: f64,
    /// Relative size of the effect in the object's image, RMS.
    pub size: f64,
    /// The size's square is a quadratic form of the numbers, of this matrix.
    size_form: Vec<f64>,
    /// The size that would be found: its gain is expected to be three of its standard errors.
    pub minimum_detectable: f64,
    /// Names of the numbers.
    pub names: Vec<String>,
    /// Frames of the numbers that belong to one.
    pub frames: Vec<Option<u32>>,
}

impl Score {
    /// Relative size in the object's image that the effect has with the numbers `beta`, RMS, and its standard error, where the
    /// numbers have these and are independent.
    pub fn size_of(&self, beta: &[f64], errors: &[f64]) -> (f64, f64) {
        size_of(&self.size_form, beta, errors)
    }
}

/// All candidates' scores, best first, and the squared error before.
pub struct Screen {
    /// Scores.
    pub scores: Vec<Score>,
    /// Squared error of the held-out patches without any of them.
    pub before: f64,
    /// How many values that is.
    pub count: usize,
    /// What was projected out.
    pub nuisance: Arc<Nuisance>,
}

/// One colour's whitened columns on the rows of development, fold after fold.
struct Colour {
    matrix: Matrix,
    folds: Vec<Gram>,
    total: Gram,
}

/// Scores all candidates at this linearisation.
pub fn screen(study: &Study<'_>, jacobian: &Jacobian, candidates: &[Candidate]) -> Screen {
    let layout = layout(study, jacobian, candidates);
    tracing::debug!(
        nuisance = layout.nuisance,
        always = layout.always,
        columns = layout.columns,
        rows = layout.rows.len(),
        "screen"
    );
    let colours: Vec<Colour> = (0..3)
        .map(|c| Colour::new(&layout, jacobian, candidates, c))
        .collect();
    let blocks = study.blocks();
    let count = candidates.len();
    let mut gains = vec![vec![0.0; blocks]; count];
    let mut before = 0.0;
    let whole: Vec<Reduced> = colours
        .par_iter()
        .map(|colour| Reduced::new(&colour.total, &layout))
        .collect();
    for fold in 0..FOLDS {
        let reduced: Vec<Reduced> = colours
            .par_iter()
            .map(|colour| Reduced::new(&colour.total.without(&colour.folds[fold]), &layout))
            .collect();
        let plain = solve(&reduced, &layout, None, jacobian, candidates).0;
        let models: Vec<Vec<f64>> = (0..count)
            .into_par_iter()
            .map(|k| solve(&reduced, &layout, Some(k), jacobian, candidates).0)
            .collect();
        let test = layout.starts[fold]..layout.starts[fold + 1];
        let errors = |beta: &[f64], k: Option<usize>| -> Vec<f64> {
            let mut squares = vec![0.0; test.len()];
            for ((colour, reduced), whole) in colours.iter().zip(&reduced).zip(&whole) {
                let weights = reduced.predictor(beta, &layout, k);
                let mut along = vec![0.0; layout.nuisance];
                let errors: Vec<f64> = test
                    .clone()
                    .map(|row| {
                        let line = colour.matrix.row(row);
                        let mut e = f64::from(line[layout.residual()]);
                        e -= inner(&weights, &line[..layout.residual()]);
                        if let Some(k) = k {
                            e -= inner(&beta[layout.always..], &line[layout.own[k].clone()]);
                        }
                        let nuisance = along.iter_mut().zip(line);
                        nuisance.for_each(|(a, x)| *a += e * f64::from(*x));
                        e
                    })
                    .collect();
                // What training left open about light and texture is no error of the effect's: prediction errors are measured
                // by their own covariance, 1 + J A⁻¹ Jᵀ, whose inverse is 1 − J (A + JᵀJ)⁻¹ Jᵀ.
                whole.solve(&mut along);
                for ((square, row), e) in squares.iter_mut().zip(test.clone()).zip(&errors) {
                    let line = colour.matrix.row(row);
                    *square += e * (e - inner(&along, &line[..layout.nuisance]));
                }
            }
            squares
        };
        let without = errors(&plain, None);
        before += without.iter().sum::<f64>();
        let with: Vec<Vec<f64>> = (0..count)
            .into_par_iter()
            .map(|k| errors(&models[k], Some(k)))
            .collect();
        for (gains, with) in gains.iter_mut().zip(with) {
            for ((row, w), o) in test.clone().zip(with).zip(&without) {
                gains[study.block(layout.rows[row])] += o - w;
            }
        }
    }
    let mut scores: Vec<Score> = (0..count)
        .filter(|&k| !candidates[k].terms.is_empty())
        .map(|k| {
            let (mut beta, system) = solve(&whole, &layout, Some(k), jacobian, candidates);
            let own = Own::new(&system, beta.split_off(layout.always));
            let survival = survival(jacobian, &candidates[k], &own);
            score(&candidates[k], &gains[k], &own, survival)
        })
        .collect();
    scores.sort_by(|a, b| b.gain.total_cmp(&a.gain).then(a.id.cmp(b.id)));
    Screen {
        scores,
        before,
        count: 3 * layout.rows.len(),
        nuisance: jacobian.nuisance.clone(),
    }
}

fn layout(study: &Study<'_>, jacobian: &Jacobian, candidates: &[Candidate]) -> Layout {
    let (nuisance, always) = (jacobian.nuisance.columns.len(), jacobian.always.len());
    let own = candidates.iter().map(|candidate| candidate.columns.len());
    Layout::new(study, nuisance, always, own)
}

impl Colour {
    fn new(layout: &Layout, jacobian: &Jacobian, candidates: &[Candidate], c: usize) -> Self {
        let columns: Vec<&Vec<f32>> = jacobian
            .nuisance
            .columns
            .iter()
            .chain(&jacobian.always)
            .chain(std::iter::once(&jacobian.residual))
            .chain(candidates.iter().flat_map(|k| &k.columns))
            .collect();
        let matrix = Matrix::of_colour(&columns, &layout.rows, c);
        let folds: Vec<Gram> = (0..FOLDS)
            .map(|fold| Gram::of_fold(&matrix, layout, fold))
            .collect();
        let total = Gram::total(&folds);
        Self {
            matrix,
            folds,
            total,
        }
    }
}

/// Coefficients of the constant columns and of candidate `k` together, and the system that they solve.
fn solve(
    reduced: &[Reduced],
    layout: &Layout,
    k: Option<usize>,
    jacobian: &Jacobian,
    candidates: &[Candidate],
) -> (Vec<f64>, System) {
    let mut bounds = jacobian.always_bounds.clone();
    bounds.extend(k.into_iter().flat_map(|k| candidates[k].bounds()));
    let mut system = System::zero(bounds.len());
    for part in reduced {
        system.add(part, layout, k);
    }
    let beta = bounded(&system.a, &system.b, &bounds);
    (beta, system)
}

/// ‖X̃β‖² / ‖Xβ‖² in units of the noise: X̃ is what no light, texture, albedo of a place or effect in the model can imitate.
fn survival(jacobian: &Jacobian, candidate: &Candidate, own: &Own) -> f64 {
    let mut change = vec![0.0f32; jacobian.residual.len()];
    for (column, beta) in candidate.columns.iter().zip(&own.beta) {
        let moved = change.iter_mut().zip(column);
        moved.for_each(|(sum, x)| *sum += *beta as f32 * x);
    }
    let all = jacobian.precision.square_of_noise(&change);
    if all > 0.0 { own.signal / all } else { 0.0 }
}

fn score(candidate: &Candidate, blocks: &[f64], own: &Own, survival: f64) -> Score {
    let (beta, error) = (&own.beta, &own.error);
    let used: Vec<f64> = blocks.iter().copied().filter(|b| *b != 0.0).collect();
    // Numbers that stay at their bound change nothing, for sure.
    let (gain, gain_se) = match used.is_empty() {
        true => (0.0, 0.0),
        false => paired(&used),
    };
    let scaled = |values: &[f64]| -> Vec<f64> {
        values
            .iter()
            .zip(&candidate.terms)
            .map(|(b, t): (&f64, &Term)| b * t.scale)
            .collect()
    };
    let size_form = size_form(candidate);
    let size = |beta: &[f64]| size_of(&size_form, &scaled(beta), &[]).0;
    Score {
        id: candidate.effect.id(),
        gain,
        gain_se,
        p: sign_flips(&used),
        blocks: blocks.to_vec(),
        beta: scaled(beta),
        standard_error: scaled(error),
        survival,
        size: size(beta),
        minimum_detectable: own.minimum_detectable(size),
        names: candidate.terms.iter().map(|t| t.name.clone()).collect(),
        frames: candidate.terms.iter().map(|t| t.frame).collect(),
        size_form,
    }
}

/// Mean products of the relative changes that the numbers make. Numbers of different frames change different views, so that most
/// products need not be made where an effect has numbers of every frame.
fn size_form(candidate: &Candidate) -> Vec<f64> {
    let (units, terms) = (&candidate.unit_size, &candidate.terms);
    let product = |i: usize, j: usize| -> f64 {
        let apart = terms[i].frame.zip(terms[j].frame);
        if apart.is_some_and(|(a, b)| a != b) {
            return 0.0;
        }
        let pairs = units[i].iter().zip(&units[j]);
        let sum: f64 = pairs.map(|(a, b)| f64::from(a * b)).sum();
        sum / (units[i].len().max(1) as f64 * terms[i].scale * terms[j].scale)
    };
    let count = terms.len();
    let halves: Vec<Vec<f64>> = (0..count)
        .into_par_iter()
        .map(|i| (0..=i).map(|j| product(i, j)).collect())
        .collect();
    let whole = (0..count * count).map(|k| (k / count, k % count));
    whole.map(|(i, j)| halves[i.max(j)][i.min(j)]).collect()
}

/// The root of a quadratic form of `beta`, and its standard error.
fn size_of(form: &[f64], beta: &[f64], errors: &[f64]) -> (f64, f64) {
    let count = beta.len().max(1);
    let slopes: Vec<f64> = form
        .chunks_exact(count)
        .map(|line| line.iter().zip(beta).map(|(x, b)| x * b).sum())
        .collect();
    let square: f64 = slopes.iter().zip(beta).map(|(s, b)| s * b).sum();
    let size = square.max(0.0).sqrt();
    let parts = slopes.iter().zip(errors);
    let error: f64 = parts.map(|(s, e)| (s * e).powi(2)).sum();
    (size, error.sqrt() / size.max(1e-150))
}

/// Summed in eight parts, which need not wait for each other.
fn inner(weights: &[f64], values: &[f32]) -> f64 {
    let mut parts = [0.0f64; 8];
    let (weights, last_weights) = weights.as_chunks::<8>();
    let (values, last_values) = values.as_chunks::<8>();
    for (weights, values) in weights.iter().zip(values) {
        for ((part, weight), value) in parts.iter_mut().zip(weights).zip(values) {
            *part += weight * f64::from(*value);
        }
    }
    let last = last_weights.iter().zip(last_values);
    let last: f64 = last.map(|(w, v)| w * f64::from(*v)).sum();
    parts.iter().sum::<f64>() + last
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_size_is_that_of_the_numbers_it_is_asked_for() {
        // Changes of (1, 0) and (1, 2) in two views.
        let form = [0.5, 0.5, 0.5, 2.5];
        let (size, error) = size_of(&form, &[1.0, -0.5], &[0.1, 0.0]);
        // (½, −1): a mean square of ⅝.
        assert!((size - 0.625f64.sqrt()).abs() < 1e-12);
        assert!((error - 0.1 * 0.25 / size).abs() < 1e-12);
        assert_eq!(size_of(&form, &[0.0, 0.0], &[1.0, 1.0]), (0.0, 0.0));
        assert_eq!(size_of(&[], &[], &[]), (0.0, 0.0));
    }
}
