//! A least-squares problem with its nuisance eliminated.
//!
//! Columns come in the order nuisance (each colour its own coefficient), constants (one coefficient for all colours), the
//! residual, then every candidate's own columns.

use super::linear::Cholesky;

/// Columns and rows of the problem.
pub struct Layout {
    /// See the module.
    pub nuisance: usize,
    /// See the module.
    pub always: usize,
    /// See the module.
    pub own: Vec<std::ops::Range<usize>>,
    /// See the module.
    pub columns: usize,
    /// See the module.
    pub rows: Vec<usize>,
    /// See the module.
    pub starts: Vec<usize>,
}

impl Layout {
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
        let mut subtract = |a: std::ops::Range<usize>, b: std::ops::Range<usize>| {
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
