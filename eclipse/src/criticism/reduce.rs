//! A least-squares problem with its nuisance eliminated.
//!
//! Columns come in the order nuisance (each colour its own coefficient), constants (one coefficient for all colours), the
//! residual, then every candidate's own columns.

use std::ops::Range;

use super::{
    linear::Cholesky,
    split::{FOLDS, Role},
    study::Study,
};

/// Columns and rows of the problem.
pub struct Layout {
    /// See the module.
    pub nuisance: usize,
    /// See the module.
    pub always: usize,
    /// See the module.
    pub own: Vec<Range<usize>>,
    /// See the module.
    pub columns: usize,
    /// See the module.
    pub rows: Vec<usize>,
    /// See the module.
    pub starts: Vec<usize>,
}

impl Layout {
    /// Of the development data, fold after fold, with so many nuisance and constant columns and so many of each candidate's own.
    pub fn new(
        study: &Study<'_>,
        nuisance: usize,
        always: usize,
        own: impl Iterator<Item = usize>,
    ) -> Self {
        let mut columns = nuisance + always + 1;
        let mut ranges = Vec::new();
        for count in own {
            ranges.push(columns..columns + count);
            columns += count;
        }
        let (mut rows, mut starts) = (Vec::new(), vec![0]);
        for fold in 0..FOLDS {
            let developed = |i: &usize| study.role[*i] == Role::Development(fold as u8);
            rows.extend((0..study.seen.len()).filter(developed));
            starts.push(rows.len());
        }
        Self {
            nuisance,
            always,
            own: ranges,
            columns,
            rows,
            starts,
        }
    }

    /// The column of the residual.
    pub fn residual(&self) -> usize {
        self.nuisance + self.always
    }
}

/// A training set with the nuisance eliminated.
pub struct Reduced {
    factor: Cholesky,
    /// L⁻¹ of the nuisance's products with all later columns, `[nuisance][column − nuisance]`.
    half: Vec<f64>,
    /// Products of the later columns among themselves after the elimination, `[column][column]` from the first later one.
    pub schur: Vec<f64>,
    /// How many later columns.
    pub later: usize,
}

impl Reduced {
    /// From the Gram matrix of the training rows.
    pub fn new(gram: &[f64], layout: &Layout) -> Self {
        let (n, all) = (layout.nuisance, layout.columns);
        let later = all - n;
        let mut system = vec![0.0; n * n];
        for i in 0..n {
            system[i * n..(i + 1) * n].copy_from_slice(&gram[i * all..i * all + n]);
            // The prior: deviations are units of the coordinates.
            system[i * n + i] += 1.0;
        }
        let factor = Cholesky::new(&system, n, n);
        let mut half = vec![0.0; n * later];
        for i in 0..n {
            half[i * later..(i + 1) * later].copy_from_slice(&gram[i * all + n..(i + 1) * all]);
        }
        factor.forward(&mut half, later);
        let mut schur = vec![0.0; later * later];
        let head = layout.always + 1;
        let mut subtract = |a: Range<usize>, b: Range<usize>| {
            for i in a {
                let row = &mut schur[i * later..(i + 1) * later];
                for j in b.clone() {
                    row[j] = gram[(n + i) * all + n + j];
                }
                for k in 0..n {
                    let factor = half[k * later + i];
                    let source = &half[k * later..(k + 1) * later];
                    for j in b.clone() {
                        row[j] -= factor * source[j];
                    }
                }
            }
        };
        subtract(0..head, 0..later);
        for own in &layout.own {
            let own = own.start - n..own.end - n;
            subtract(own.clone(), own);
        }
        Self {
            factor,
            half,
            schur,
            later,
        }
    }

    /// Weights of nuisance and constant columns that predict a row's residual, for the coefficients `beta` of the constant
    /// columns and those of candidate `k`.
    pub fn predictor(&self, beta: &[f64], layout: &Layout, k: Option<usize>) -> Vec<f64> {
        let n = layout.nuisance;
        let mut theta: Vec<f64> = (0..n)
            .map(|i| {
                let row = &self.half[i * self.later..(i + 1) * self.later];
                let mut sum = row[layout.always];
                for (b, x) in beta[..layout.always].iter().zip(row) {
                    sum -= b * x;
                }
                if let Some(k) = k {
                    let own = layout.own[k].start - n..layout.own[k].end - n;
                    for (b, x) in beta[layout.always..].iter().zip(&row[own]) {
                        sum -= b * x;
                    }
                }
                sum
            })
            .collect();
        self.factor.backward(&mut theta, 1);
        theta.extend(&beta[..layout.always]);
        theta
    }

    /// Solves for nuisance alone: the inverse of its products and prior times `b`, in place.
    pub fn solve(&self, b: &mut [f64]) {
        self.factor.forward(b, 1);
        self.factor.backward(b, 1);
    }
}

/// Normal equations of some of the constant columns and of a candidate's own, the nuisance eliminated, summed over colours.
#[derive(Clone)]
pub struct System {
    /// Products, `[column][column]`.
    pub a: Vec<f64>,
    /// Products with the residual.
    pub b: Vec<f64>,
}

impl System {
    /// The prior alone, of `size` columns: deviations are units of the coefficients.
    pub fn zero(size: usize) -> Self {
        let mut a = vec![0.0; size * size];
        (0..size).for_each(|i| a[i * size + i] = 1.0);
        Self {
            a,
            b: vec![0.0; size],
        }
    }

    /// Adds a colour's; `columns` counts from the first after the nuisance.
    pub fn add(&mut self, reduced: &Reduced, layout: &Layout, columns: &[usize]) {
        let size = columns.len();
        for (i, &ci) in columns.iter().enumerate() {
            for (j, &cj) in columns.iter().enumerate() {
                // Candidates' rows hold their own columns only; the head's rows hold all.
                let (r, c) = if ci < cj { (ci, cj) } else { (cj, ci) };
                self.a[i * size + j] += reduced.schur[r * reduced.later + c];
            }
            self.b[i] += reduced.schur[layout.always * reduced.later + ci];
        }
    }

    /// Standard errors of the coefficients: roots of the inverse's diagonal.
    pub fn errors(&self) -> Vec<f64> {
        let size = self.b.len();
        let mut inverse = vec![0.0; size * size];
        (0..size).for_each(|i| inverse[i * size + i] = 1.0);
        Cholesky::new(&self.a, size, size).forward(&mut inverse, size);
        let variance = |j: usize| {
            (0..size)
                .map(|i| inverse[i * size + j].powi(2))
                .sum::<f64>()
        };
        (0..size).map(|j| variance(j).sqrt()).collect()
    }
}
