//! A least-squares problem with its nuisance eliminated.
//!
//! Columns come in the order nuisance (each colour its own coefficient), constants (one coefficient for all colours), the
//! residual, then every candidate's own columns.

use std::ops::Range;

use nalgebra::DMatrixView;
use rayon::prelude::*;

use super::{
    gram::Matrix,
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

    /// How many columns are no candidate's own.
    fn head(&self) -> usize {
        self.residual() + 1
    }

    /// The column of the residual.
    pub fn residual(&self) -> usize {
        self.nuisance + self.always
    }
}

/// Inner products of the problem's columns over some of its rows: those that are needed, as candidates never meet.
#[derive(Clone)]
pub struct Gram {
    /// Of nuisance, constants and residual with themselves and all later columns, `[column][column]`.
    head: Vec<f64>,
    /// Of each candidate's own columns among themselves. Of both the upper half counts.
    own: Vec<Vec<f64>>,
}

impl Gram {
    /// Over a fold's rows of a matrix that has the columns of `layout`.
    pub fn of_fold(matrix: &Matrix, layout: &Layout, fold: usize) -> Self {
        let rows = layout.starts[fold]..layout.starts[fold + 1];
        let among = |own: &Range<usize>| matrix.products(rows.clone(), own.clone(), own.clone());
        Self {
            head: matrix.products(rows.clone(), 0..layout.head(), 0..layout.columns),
            own: layout.own.iter().map(among).collect(),
        }
    }

    /// The sum over all folds, of which there is one at least.
    pub fn total(folds: &[Self]) -> Self {
        let mut total = folds[0].clone();
        for fold in &folds[1..] {
            total.change(fold, |t, f| t + f);
        }
        total
    }

    /// Of the rows of all folds but this one.
    pub fn without(&self, fold: &Self) -> Self {
        let mut rest = self.clone();
        rest.change(fold, |t, f| t - f);
        rest
    }

    /// Takes the products with the residual to be what is left when those of a fold are taken from a sum that vanishes.
    pub fn residual_without(&mut self, fold: &Self, layout: &Layout) {
        let residual = layout.residual();
        for i in 0..=residual {
            let at = i * layout.columns + residual;
            self.head[at] = -fold.head[at];
        }
    }

    fn change(&mut self, other: &Self, by: impl Fn(f64, f64) -> f64) {
        let all = |values: &mut [f64], others: &[f64]| {
            let pairs = values.iter_mut().zip(others);
            pairs.for_each(|(value, other)| *value = by(*value, *other));
        };
        all(&mut self.head, &other.head);
        for (own, other) in self.own.iter_mut().zip(&other.own) {
            all(own, other);
        }
    }
}

/// A training set with the nuisance eliminated.
pub struct Reduced {
    factor: Cholesky,
    /// L⁻¹ of the nuisance's products with all later columns, `[nuisance][column − nuisance]`.
    half: Vec<f64>,
    /// Products among the later columns after the elimination: of constants and residual with all, `[column][column]` from the first
    /// later one, and of each candidate's own.
    rest: Gram,
    /// How many later columns.
    later: usize,
}

impl Reduced {
    /// From the products of the training rows.
    pub fn new(gram: &Gram, layout: &Layout) -> Self {
        let (n, all) = (layout.nuisance, layout.columns);
        let later = all - n;
        let mut system = vec![0.0; n * n];
        for i in 0..n {
            system[i * n..(i + 1) * n].copy_from_slice(&gram.head[i * all..i * all + n]);
            // The prior: deviations are units of the coordinates.
            system[i * n + i] += 1.0;
        }
        let factor = Cholesky::new(&system, n, n);
        let mut half = vec![0.0; n * later];
        for i in 0..n {
            half[i * later..(i + 1) * later]
                .copy_from_slice(&gram.head[i * all + n..(i + 1) * all]);
        }
        factor.forward_all(&mut half, later);
        // Its rows are columns to those who count by columns.
        let by_column = DMatrixView::from_slice(&half, later, n);
        let less = |products: &mut [f64], a: Range<usize>, b: Range<usize>| {
            let (left, right) = (
                by_column.rows(b.start, b.len()),
                by_column.rows(a.start, a.len()),
            );
            let taken = left * right.transpose();
            let pairs = products.iter_mut().zip(taken.as_slice());
            pairs.for_each(|(product, taken)| *product -= taken);
        };
        let head = layout.head() - n;
        let lines = gram.head[n * all..].chunks_exact(all);
        let mut rest = Gram {
            head: lines.flat_map(|line| &line[n..]).copied().collect(),
            own: gram.own.clone(),
        };
        less(&mut rest.head, 0..head, 0..later);
        let own = rest.own.par_iter_mut().zip(&layout.own);
        own.for_each(|(products, own)| {
            let own = own.start - n..own.end - n;
            less(products, own.clone(), own);
        });
        Self {
            factor,
            half,
            rest,
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
        self.factor.backward(&mut theta);
        theta.extend(&beta[..layout.always]);
        theta
    }

    /// Solves for nuisance alone: the inverse of its products and prior times `b`, in place.
    pub fn solve(&self, b: &mut [f64]) {
        self.factor.forward(b);
        self.factor.backward(b);
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

    /// Adds a colour's products of the constant columns and of candidate `k`'s own, where one is meant.
    pub fn add(&mut self, reduced: &Reduced, layout: &Layout, k: Option<usize>) {
        let (size, constants, later) = (self.b.len(), layout.always, reduced.later);
        let own = k.map_or(0..0, |k| layout.own[k].clone());
        let first = own.start.saturating_sub(layout.nuisance);
        let place = |i: usize| match i < constants {
            true => i,
            false => first + i - constants,
        };
        let Gram { head, own: among } = &reduced.rest;
        for i in 0..size {
            for j in i..size {
                let product = match k {
                    Some(k) if i >= constants => {
                        among[k][(i - constants) * own.len() + j - constants]
                    }
                    _ => head[i * later + place(j)],
                };
                self.a[i * size + j] += product;
                if i != j {
                    self.a[j * size + i] += product;
                }
            }
            // Of the residual with earlier columns their rows tell.
            self.b[i] += match i < constants {
                true => head[i * later + constants],
                false => head[constants * later + place(i)],
            };
        }
    }

    /// Standard errors of the coefficients: roots of the inverse's diagonal.
    pub fn errors(&self) -> Vec<f64> {
        let size = self.b.len();
        let mut inverse = vec![0.0; size * size];
        (0..size).for_each(|i| inverse[i * size + i] = 1.0);
        Cholesky::new(&self.a, size, size).forward_all(&mut inverse, size);
        let variance = |j: usize| {
            (0..size)
                .map(|i| inverse[i * size + j].powi(2))
                .sum::<f64>()
        };
        (0..size).map(|j| variance(j).sqrt()).collect()
    }
}
