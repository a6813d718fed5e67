//! How sure the numbers of effects in a model are, at that model.
//!
//! Two answers. The linearisation at the fit says what noise does while light, texture and lobe are free to follow. A block
//! jackknife says how much the numbers differ from one part of the surface to another, for whatever reason: each fold of patches is
//! left out once, and one Newton step from the fit, where all gradients together vanish, goes against the fold's own gradient
//! (Efron & Stein, Annals of Statistics 9, 1981). The larger counts: noise alone is too sure where the model is not quite right, and
//! six folds alone may agree by chance.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::{
    bounded::bounded,
    chain::Link,
    fit::{Fit, FitError},
    gram::Matrix,
    linearise::Jacobian,
    reduce::{Gram, Layout, Reduced, System},
    split::FOLDS,
    study::Study,
};

/// Standard errors of the numbers of every effect in the model.
///
/// # Errors
/// A bug of the tape.
pub fn standard_errors(
    study: &Study<'_>,
    fit: &Fit,
) -> Result<BTreeMap<&'static str, Vec<f64>>, FitError> {
    let jacobian = Jacobian::new(study, fit)?;
    let (nuisance, always) = (jacobian.nuisance.columns.len(), jacobian.always.len());
    let layout = Layout::new(study, nuisance, always, std::iter::empty());
    let columns = jacobian.nuisance.columns.iter().chain(&jacobian.always);
    let columns: Vec<&Vec<f32>> = columns.chain([&jacobian.residual]).collect();
    let matrix = |c: usize| Matrix::of_colour(&columns, &layout.rows, c);
    let errors = errors(matrix, &layout, &jacobian.always_bounds);
    // The columns of effects come last, in the order light meets them.
    let mut links: Vec<&Link> = fit.links.iter().collect();
    links.sort_by_key(|link| link.effect.stage());
    let numbers: usize = links.iter().map(|link| link.terms.len()).sum();
    let mut next = errors.len() - numbers;
    let own = |link: &Link| {
        let errors = errors[next..].iter().zip(link.terms.iter());
        next += link.terms.len();
        let scaled = errors.map(|(error, term)| error * term.scale);
        (link.effect.id(), scaled.collect())
    };
    Ok(links.into_iter().map(own).collect())
}

/// Standard errors of the constant columns' coefficients, `matrix(colour)` having the columns of `layout` fold after fold.
fn errors(matrix: impl Fn(usize) -> Matrix, layout: &Layout, bounds: &[[f64; 2]]) -> Vec<f64> {
    let size = layout.always;
    let mut whole = System::zero(size);
    let mut without = vec![System::zero(size); FOLDS];
    // A colour at a time: its columns are all the memory that this takes.
    for c in 0..3 {
        let matrix = matrix(c);
        let folds: Vec<Gram> = (0..FOLDS)
            .map(|fold| Gram::of_fold(&matrix, layout, fold))
            .collect();
        let total = Gram::total(&folds);
        whole.add(&Reduced::new(&total, layout), layout, None);
        let reduced: Vec<Reduced> = folds
            .par_iter()
            .map(|fold| Reduced::new(&left_out(&total, fold, layout), layout))
            .collect();
        for (system, reduced) in without.iter_mut().zip(&reduced) {
            system.add(reduced, layout, None);
        }
    }
    let held: Vec<[f64; 2]> = bounds.iter().map(|bounds| free(*bounds)).collect();
    let steps: Vec<Vec<f64>> = without
        .iter()
        .map(|system| bounded(&system.a, &system.b, &held))
        .collect();
    let by_noise = whole.errors();
    let by_folds = jackknife(&steps, size);
    by_noise
        .into_iter()
        .zip(by_folds)
        .map(|(noise, folds)| noise.max(folds))
        .collect()
}

/// What a number may move by: nothing where it lies at a bound, which more of the data than a fold keeps it at.
fn free([least, most]: [f64; 2]) -> [f64; 2] {
    if least >= 0.0 || most <= 0.0 {
        [0.0; 2]
    } else {
        [least, most]
    }
}

/// The products of all folds but one, with the gradient that is left when that one is taken from a vanishing sum.
fn left_out(total: &Gram, fold: &Gram, layout: &Layout) -> Gram {
    let mut rest = total.without(fold);
    rest.residual_without(fold, layout);
    rest
}

/// The jackknife's standard errors of `size` numbers from the steps that leaving out each fold makes.
fn jackknife(steps: &[Vec<f64>], size: usize) -> Vec<f64> {
    let count = steps.len() as f64;
    (0..size)
        .map(|k| {
            let mean = steps.iter().map(|step| step[k]).sum::<f64>() / count;
            let squares: f64 = steps.iter().map(|step| (step[k] - mean).powi(2)).sum();
            ((count - 1.0) / count * squares).sqrt()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
    const EACH: usize = 10;

    /// A mean of residuals that differ from fold to fold, with or without a nuisance column that has nothing to do with it.
    fn of(nuisance: usize, own: &[f32; FOLDS], bounds: [f64; 2]) -> f64 {
        let rows = FOLDS * EACH;
        let layout = Layout {
            nuisance,
            always: 1,
            own: Vec::new(),
            columns: nuisance + 2,
            rows: (0..rows).collect(),
            starts: (0..=FOLDS).map(|fold| fold * EACH).collect(),
        };
        let mut columns: Vec<Vec<f32>> = (0..nuisance)
            .map(|_| (0..rows).map(|r| [1.0, -1.0][r % 2]).collect())
            .collect();
        columns.push(vec![1.0; rows]);
        columns.push((0..rows).map(|r| own[r / EACH]).collect());
        let matrix = |_| Matrix::from_columns(&columns, &layout.rows);
        errors(matrix, &layout, &[bounds])[0]
    }

    #[test]
    fn noise_alone_is_the_linearisation() {
        // Three colours of sixty values, and the prior's one.
        for nuisance in [0, 1] {
            let error = of(nuisance, &[0.0; FOLDS], OPEN);
            assert!((error - 1.0 / 181f64.sqrt()).abs() < 1e-9, "{error}");
        }
    }

    #[test]
    fn folds_that_differ_count_once_each() {
        // Six means, ± 2 in turn: their own mean has an error of √(6·4/5)/√6.
        let own = [2.0, -2.0, 2.0, -2.0, 2.0, -2.0];
        for nuisance in [0, 1] {
            let error = of(nuisance, &own, OPEN);
            assert!((error / 0.8f64.sqrt() - 1.0).abs() < 0.02, "{error}");
        }
        // A number at its bound does not move; noise says how far it could be off.
        let held = of(0, &own, [0.0, 1.0]);
        assert!((held - 1.0 / 181f64.sqrt()).abs() < 1e-9, "{held}");
    }
}
