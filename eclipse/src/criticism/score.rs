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
    reduce::{Layout, Reduced, System},
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
    /// Share of the effect's signal that light and material cannot imitate.
    pub survival: f64,
    /// Relative size of the effect in the object's image, RMS.
    pub size: f64,
    /// Change of the size by each of the numbers.
    pub size_slopes: Vec<f64>,
    /// The size that would be found: its gain is expected to be three of its standard errors.
    pub minimum_detectable: f64,
    /// Names of the numbers.
    pub names: Vec<String>,
    /// Frames of the numbers that belong to one.
    pub frames: Vec<Option<u32>>,
}

impl Score {
    /// Standard error of the size, where the numbers have these and are independent.
    pub fn size_error(&self, errors: &[f64]) -> f64 {
        let parts = self.size_slopes.iter().zip(errors);
        parts
            .map(|(slope, error)| (slope * error).powi(2))
            .sum::<f64>()
            .sqrt()
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
    /// Gram matrices by fold.
    folds: Vec<Vec<f64>>,
    total: Vec<f64>,
}

/// Scores all candidates at this linearisation.
pub fn screen(study: &Study<'_>, jacobian: &Jacobian, candidates: &[Candidate]) -> Screen {
    let layout = layout(study, jacobian, candidates);
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
            .map(|colour| {
                let training: Vec<f64> = colour
                    .total
                    .iter()
                    .zip(&colour.folds[fold])
                    .map(|(t, f)| t - f)
                    .collect();
                Reduced::new(&training, &layout)
            })
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
    let reduced = whole;
    let mut scores: Vec<Score> = (0..count)
        .filter(|&k| !candidates[k].terms.is_empty())
        .map(|k| {
            let (mut beta, system) = solve(&reduced, &layout, Some(k), jacobian, candidates);
            let own = Own::new(&system, beta.split_off(layout.always));
            let survival = survival(&colours, &reduced, &layout, k, &own.beta);
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
        let size = layout.columns * layout.columns;
        let head = layout.residual() + 1;
        let mut total = vec![0.0; size];
        let folds = (0..FOLDS)
            .map(|fold| {
                let rows = layout.starts[fold]..layout.starts[fold + 1];
                let mut gram = vec![0.0; size];
                matrix.products(rows.clone(), 0..head, 0..layout.columns, &mut gram);
                for own in &layout.own {
                    matrix.products(rows.clone(), own.clone(), own.clone(), &mut gram);
                }
                total.iter_mut().zip(&gram).for_each(|(t, g)| *t += g);
                gram
            })
            .collect();
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
    let n = layout.nuisance;
    let mut columns: Vec<usize> = (0..layout.always).collect();
    let mut bounds = jacobian.always_bounds.clone();
    if let Some(k) = k {
        columns.extend(layout.own[k].start - n..layout.own[k].end - n);
        bounds.extend(candidates[k].bounds());
    }
    let mut system = System::zero(columns.len());
    for part in reduced {
        system.add(part, layout, &columns);
    }
    let beta = bounded(&system.a, &system.b, &bounds);
    (beta, system)
}

/// ‖X̃β‖² / ‖Xβ‖².
fn survival(
    colours: &[Colour],
    reduced: &[Reduced],
    layout: &Layout,
    k: usize,
    beta: &[f64],
) -> f64 {
    let (mut kept, mut all) = (0.0, 0.0);
    for (colour, reduced) in colours.iter().zip(reduced) {
        for (i, bi) in layout.own[k].clone().zip(beta) {
            for (j, bj) in layout.own[k].clone().zip(beta) {
                all += bi * bj * colour.total[i * layout.columns + j];
                let (i, j) = (i - layout.nuisance, j - layout.nuisance);
                kept += bi * bj * reduced.schur[i * reduced.later + j];
            }
        }
    }
    if all > 0.0 { kept / all } else { 0.0 }
}

fn score(candidate: &Candidate, blocks: &[f64], own: &Own, survival: f64) -> Score {
    let (beta, error) = (&own.beta, &own.error);
    let used: Vec<f64> = blocks.iter().copied().filter(|b| *b != 0.0).collect();
    // Numbers that stay at their bound change nothing, for sure.
    let (gain, gain_se) = match used.is_empty() {
        true => (0.0, 0.0),
        false => paired(&used),
    };
    let views = candidate.unit_size.first().map_or(0, Vec::len);
    let changes = |beta: &[f64]| -> Vec<f64> {
        let change = |v: usize| -> f64 {
            let parts = beta.iter().zip(&candidate.unit_size);
            parts.map(|(b, size)| b * f64::from(size[v])).sum()
        };
        (0..views).map(change).collect()
    };
    let rms = |beta: &[f64]| {
        let squares: f64 = changes(beta).iter().map(|change| change * change).sum();
        (squares / views.max(1) as f64).sqrt()
    };
    let scaled = |values: &[f64]| -> Vec<f64> {
        values
            .iter()
            .zip(&candidate.terms)
            .map(|(b, t): (&f64, &Term)| b * t.scale)
            .collect()
    };
    let size = rms(beta);
    let whole = changes(beta);
    let slope = |(unit, term): (&Vec<f32>, &Term)| {
        let along: f64 = whole.iter().zip(unit).map(|(c, u)| c * f64::from(*u)).sum();
        along / (views.max(1) as f64 * size * term.scale).max(1e-300)
    };
    let units = candidate.unit_size.iter().zip(&candidate.terms);
    let size_slopes = units.map(slope).collect();
    Score {
        id: candidate.effect.id(),
        gain,
        gain_se,
        p: sign_flips(&used),
        blocks: blocks.to_vec(),
        beta: scaled(beta),
        standard_error: scaled(error),
        survival,
        size,
        size_slopes,
        minimum_detectable: own.minimum_detectable(rms),
        names: candidate.terms.iter().map(|t| t.name.clone()).collect(),
        frames: candidate.terms.iter().map(|t| t.frame).collect(),
    }
}

fn inner(weights: &[f64], values: &[f32]) -> f64 {
    weights
        .iter()
        .zip(values)
        .map(|(w, v)| w * f64::from(*v))
        .sum()
}
