//! How sure a solution is: Laplace's approximation at the solve's end, from products with the Jacobian alone.
//!
//! In units of its prior the posterior of z is normal with the covariance (1 + A)⁻¹, where A = JᵀPJ is what the data say, the
//! albedo eliminated. The directions that data determine are few beside those that the prior alone does, so A is taken by its
//! largest eigenvalues θ with vectors v: (1 + A)⁻¹ ≈ 1 − Σ θ/(1 + θ) v vᵀ (Bui-Thanh et al., SIAM J. Sci. Comput. 35, 2013).
//! Lanczos' iteration, which is conjugate gradients without a right-hand side, finds them from a random probe. What it has
//! not found is taken to be as unsure as before the photographs: deviations err to the large side. What is left beside the
//! vectors is sampled by a few more probes, which also tell how much that may be (Hutchinson's estimate of a trace).

use std::borrow::Cow;

use nalgebra::{DMatrix, SymmetricEigen};

use super::least_squares::{Linearisation, Projector, add, dot, orthogonalise};

/// Derived quantities of a direction in z, such as the changes of radiances and albedos that belong to it.
pub type Traits = Vec<f32>;

/// What data say about z.
#[derive(Clone, Debug)]
pub struct Laplace {
    /// How surely each direction is determined: the variance of its prior over that of its data, largest first.
    pub values: Vec<f64>,
    /// The directions, of unit length.
    pub vectors: Vec<Vec<f32>>,
    /// What moves when z moves along each.
    pub traits: Vec<Traits>,
    /// Moves of z that the directions leave free, drawn from the prior, and their traits.
    pub rest: Vec<(Vec<f32>, Traits)>,
    /// At most so many more directions are known: Σ θ over all that was not found, estimated, and no more than there are.
    pub missed: f64,
}

/// How much is computed.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Products JᵀPJv.
    pub products: usize,
    /// Probes of what is left, a product Jv each.
    pub probes: usize,
}

/// Which part of what is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All of it: what noise does, and what the photographs do not show.
    All,
    /// What another draw of the photographs' noise would change; the prior of the albedo counts as if it were data, so that of how dark all
    /// of the albedo is too much is said.
    Noise,
}

impl Laplace {
    /// Looks at the data of `at` along the directions that they determine most.
    ///
    /// `normal` draws from a unit normal. `misfit` is the variance of the residuals, one where their weights are right.
    /// `traits` is called after each product Jv, with the change of the eliminated variables. `go_on` is asked before each
    /// product; when it refuses, what was found so far counts.
    pub fn new<L: Linearisation>(
        at: &mut L,
        parameters: usize,
        projector: &Projector,
        misfit: f64,
        effort: Effort,
        normal: &mut dyn FnMut() -> f32,
        traits: &dyn Fn(&L, &[f32]) -> Traits,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Self {
        let probe: Vec<f32> = (0..at.residual().len()).map(|_| normal()).collect();
        let mut q = at.vjp(&projected(projector, at, probe).0);
        let (mut basis, mut rows): (Vec<Vec<f32>>, Vec<Traits>) = (Vec::new(), Vec::new());
        let (mut diagonal, mut beside): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        let mut largest = 0.0f64;
        while basis.len() < effort.products && go_on() {
            let length = dot(&q, &q).sqrt();
            // In single precision a direction shorter than this is rounding.
            if length <= 1e-6 * largest || length == 0.0 {
                break;
            }
            let scale = (1.0 / length) as f32;
            q.iter_mut().for_each(|q| *q *= scale);
            let u = at.jvp(&q);
            let (weighted, change) = projected(projector, at, u.clone());
            rows.push(traits(at, &change));
            let value = dot(&u, &weighted).max(0.0);
            let mut next = at.vjp(&weighted);
            largest = largest.max(dot(&next, &next).sqrt());
            if !basis.is_empty() {
                beside.push(length);
            }
            diagonal.push(value);
            basis.push(q);
            // Twice is enough (Kahan): each vector stays orthogonal to all before it.
            orthogonalise(&mut next, &basis);
            orthogonalise(&mut next, &basis);
            q = next;
        }
        let mut found = Self::rotated(&basis, &rows, &diagonal, &beside, misfit);
        for _ in 0..effort.probes {
            let mut z: Vec<f32> = (0..parameters).map(|_| normal()).collect();
            orthogonalise(&mut z, &basis);
            let u = at.jvp(&z);
            let (weighted, change) = projected(projector, at, u.clone());
            found.missed += dot(&u, &weighted).max(0.0) / (misfit * effort.probes as f64);
            let row = traits(at, &change);
            found.rest.push((z, row));
        }
        // One a direction at most, however much the data say of it.
        found.missed = found
            .missed
            .min(parameters.saturating_sub(basis.len()) as f64);
        found
    }

    /// From Lanczos' basis to eigenvectors.
    fn rotated(
        basis: &[Vec<f32>],
        rows: &[Traits],
        diagonal: &[f64],
        beside: &[f64],
        misfit: f64,
    ) -> Self {
        let k = basis.len();
        if k == 0 {
            return Self {
                values: Vec::new(),
                vectors: Vec::new(),
                traits: Vec::new(),
                rest: Vec::new(),
                missed: 0.0,
            };
        }
        let tridiagonal = DMatrix::from_fn(k, k, |i, j| match i.abs_diff(j) {
            0 => diagonal[i],
            1 => beside[i.min(j)],
            _ => 0.0,
        });
        let eigen = SymmetricEigen::new(tridiagonal);
        let mut order: Vec<usize> = (0..k).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let turned = |from: &[Vec<f32>], i: usize| {
            let mut sum = vec![0.0; from.first().map_or(0, Vec::len)];
            for (row, weight) in from.iter().zip(eigen.eigenvectors.column(i).iter()) {
                add(&mut sum, *weight as f32, row);
            }
            sum
        };
        Self {
            values: order
                .iter()
                .map(|&i| eigen.eigenvalues[i].max(0.0) / misfit)
                .collect(),
            vectors: order.iter().map(|&i| turned(basis, i)).collect(),
            traits: order.iter().map(|&i| turned(rows, i)).collect(),
            rest: Vec::new(),
            missed: 0.0,
        }
    }

    /// How many directions of z are known from the photographs rather than from the prior: Σ θ/(1 + θ).
    pub fn known(&self) -> f64 {
        self.gained().iter().sum()
    }

    /// At most so many: θ/(1 + θ) is neither above θ nor, for any direction, above one.
    pub fn known_at_most(&self) -> f64 {
        self.known() + self.missed
    }

    /// What the squares of a linear function's values along the directions count in its variance.
    pub fn weights(&self, part: Part) -> Vec<f64> {
        let weight = |value: &f64| match part {
            Part::All => 1.0 / (1.0 + value),
            Part::Noise => value / (1.0 + value).powi(2),
        };
        self.values.iter().map(weight).collect()
    }

    /// The same for what the data have taken from the prior's variance.
    pub fn gained(&self) -> Vec<f64> {
        self.values.iter().map(|v| v / (1.0 + v)).collect()
    }
}

/// Σ weight · row².
pub fn weighted_squares<'a>(rows: impl Iterator<Item = (f64, Cow<'a, [f32]>)>) -> Vec<f64> {
    let mut sums = Vec::new();
    for (weight, row) in rows {
        sums.resize(row.len(), 0.0);
        for (sum, value) in sums.iter_mut().zip(row.iter()) {
            *sum += weight * f64::from(*value).powi(2);
        }
    }
    sums
}

/// P u, and by how much the eliminated variables change.
fn projected<L: Linearisation>(
    projector: &Projector,
    at: &L,
    mut u: Vec<f32>,
) -> (Vec<f32>, Vec<f32>) {
    let change = projector.project(at, &mut u);
    (u, change)
}
