//! Linear algebra: conjugate gradients for what is known by its products, and small dense systems.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

pub use crate::reconstruct::least_squares::dot;

/// Solves A x = b from `x` for a symmetric positive definite A known by its products; ends after `most` products or when
/// the residual has fallen by `tolerance`.
pub fn conjugate_gradients(
    x: &mut [f32],
    b: &[f32],
    most: usize,
    tolerance: f64,
    product: impl FnMut(&[f32]) -> Vec<f32>,
) {
    preconditioned(x, b, most, tolerance, product, <[f32]>::to_vec);
}

/// The same with about the inverse of A at hand, symmetric and positive definite, known by its products too; the residual is
/// measured by it. Answers whether it has fallen by `tolerance`.
pub fn preconditioned(
    x: &mut [f32],
    b: &[f32],
    most: usize,
    tolerance: f64,
    mut product: impl FnMut(&[f32]) -> Vec<f32>,
    inverse: impl Fn(&[f32]) -> Vec<f32>,
) -> bool {
    let mut r = b.to_vec();
    if x.iter().any(|&v| v != 0.0) {
        let ax = product(x);
        r.iter_mut().zip(ax).for_each(|(r, a)| *r -= a);
    }
    let goal = tolerance * tolerance * dot(b, &inverse(b));
    let mut p = inverse(&r);
    let mut rz = dot(&r, &p);
    for _ in 0..most {
        if rz <= goal || rz == 0.0 {
            return true;
        }
        let ap = product(&p);
        let curvature = dot(&p, &ap);
        if curvature.is_nan() || curvature <= 0.0 {
            return false;
        }
        let step = rz / curvature;
        for i in 0..x.len() {
            x[i] += step as f32 * p[i];
            r[i] -= step as f32 * ap[i];
        }
        let z = inverse(&r);
        let next = dot(&r, &z);
        let ratio = (next / rz) as f32;
        for i in 0..x.len() {
            p[i] = z[i] + ratio * p[i];
        }
        rz = next;
    }
    rz <= goal
}

/// A lower-triangular Cholesky factor, row-major.
pub struct Cholesky {
    n: usize,
    l: Vec<f64>,
}

impl Cholesky {
    /// Of the leading `n` × `n` part of a symmetric matrix of `stride` columns, whose upper half is read; pivots that vanish are
    /// lifted to a trace of the largest, which leaves their direction unmoved.
    pub fn new(a: &[f64], n: usize, stride: usize) -> Self {
        let largest = (0..n).map(|i| a[i * stride + i]).fold(0.0, f64::max);
        let floor = 1e-12 * largest.max(1e-300);
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            let (above, row) = l.split_at_mut(i * n);
            for j in 0..i {
                let other = &above[j * n..j * n + j];
                let s = a[j * stride + i] - inner(&row[..j], other);
                row[j] = s / above[j * n + j];
            }
            let s = a[i * stride + i] - inner(&row[..i], &row[..i]);
            row[i] = s.max(floor).sqrt();
        }
        Self { n, l }
    }

    /// L⁻¹ b.
    pub fn forward(&self, b: &mut [f64]) {
        for (i, row) in self.rows().enumerate() {
            b[i] = (b[i] - inner(&row[..i], &b[..i])) / row[i];
        }
    }

    /// L⁻ᵀ b.
    pub fn backward(&self, b: &mut [f64]) {
        for (i, row) in self.rows().enumerate().rev() {
            let solved = b[i] / row[i];
            b[i] = solved;
            let earlier = b[..i].iter_mut().zip(row);
            earlier.for_each(|(b, l)| *b -= l * solved);
        }
    }

    /// L⁻¹ b for many right-hand sides: `b` is `[row][column]`, `columns` wide.
    pub fn forward_all(&self, b: &mut [f64], columns: usize) {
        // A few columns at a time stay in the cache, and are nobody else's.
        let parts: Vec<(usize, Vec<f64>)> = (0..columns)
            .into_par_iter()
            .step_by(WIDTH)
            .map(|first| {
                let wide = WIDTH.min(columns - first);
                let mut part = vec![0.0; self.n * WIDTH];
                for (part, row) in part.chunks_exact_mut(WIDTH).zip(b.chunks_exact(columns)) {
                    part[..wide].copy_from_slice(&row[first..first + wide]);
                }
                Arch::new().dispatch(Forward {
                    factor: self,
                    part: &mut part,
                });
                (first, part)
            })
            .collect();
        for (first, part) in parts {
            let wide = WIDTH.min(columns - first);
            for (part, row) in part.chunks_exact(WIDTH).zip(b.chunks_exact_mut(columns)) {
                row[first..first + wide].copy_from_slice(&part[..wide]);
            }
        }
    }

    /// The factor's rows, zeros behind the diagonal.
    fn rows(&self) -> std::slice::ChunksExact<'_, f64> {
        self.l.chunks_exact(self.n.max(1))
    }
}

/// Right-hand sides that are solved together: four of the widest vectors.
const WIDTH: usize = 32;

/// L⁻¹ for `WIDTH` right-hand sides, `[row][column]`.
struct Forward<'a> {
    factor: &'a Cholesky,
    part: &'a mut [f64],
}

/// Sums are vectors by name, as those of [`Matrix`](super::gram::Matrix).
impl WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        /// Vectors whose sums are in registers at once.
        const VECTORS: usize = 4;
        let together = VECTORS * S::F64_LANES;
        for (i, row) in self.factor.rows().enumerate() {
            let (done, rest) = self.part.split_at_mut(i * WIDTH);
            let pivot = simd.splat_f64s(1.0 / row[i]);
            for (at, target) in rest[..WIDTH].chunks_exact_mut(together).enumerate() {
                let (target, _) = S::as_mut_simd_f64s(target);
                let mut sums: [S::f64s; VECTORS] = *target.first_chunk().expect("whole vectors");
                for (factor, source) in row.iter().zip(done.chunks_exact(WIDTH)) {
                    let (source, _) = S::as_simd_f64s(&source[at * together..][..together]);
                    let source: &[S::f64s; VECTORS] = source.first_chunk().expect("whole vectors");
                    let factor = simd.splat_f64s(-factor);
                    for v in 0..VECTORS {
                        sums[v] = simd.mul_add_e_f64s(factor, source[v], sums[v]);
                    }
                }
                for (target, sum) in target.iter_mut().zip(sums) {
                    *target = simd.mul_f64s(sum, pivot);
                }
            }
        }
    }
}

/// The inner product of two slices of one length.
pub fn inner(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0f64; 4];
    let (a4, a1) = a.as_chunks::<4>();
    let (b4, b1) = b.as_chunks::<4>();
    for (x, y) in a4.iter().zip(b4) {
        for k in 0..4 {
            lanes[k] += x[k] * y[k];
        }
    }
    lanes.iter().sum::<f64>() + a1.iter().zip(b1).map(|(x, y)| x * y).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems_are_solved() {
        let a = [4.0, 1.0, 1.0, 3.0];
        let mut x = [1.0, 2.0];
        let factor = Cholesky::new(&a, 2, 2);
        factor.forward(&mut x);
        factor.backward(&mut x);
        assert!((x[0] - 1.0 / 11.0).abs() < 1e-12 && (x[1] - 7.0 / 11.0).abs() < 1e-12);
        let mut x = vec![0.0f32; 2];
        conjugate_gradients(&mut x, &[1.0, 2.0], 10, 1e-9, |v| {
            vec![4.0 * v[0] + v[1], v[0] + 3.0 * v[1]]
        });
        assert!((f64::from(x[1]) - 7.0 / 11.0).abs() < 1e-6);
    }

    #[test]
    fn many_right_hand_sides_are_solved_as_one_is() {
        let n = 37;
        let value = |i: usize, j: usize| ((i * 7 + j * 5) % 11) as f64 / 11.0;
        let mut a = vec![f64::NAN; n * n];
        for i in 0..n {
            // The upper half alone is there.
            (i..n).for_each(|j| a[i * n + j] = value(i, j));
            a[i * n + i] += n as f64;
        }
        let factor = Cholesky::new(&a, n, n);
        let columns = 2 * WIDTH + 5;
        let mut all: Vec<f64> = (0..n * columns).map(|k| value(k, k / 3)).collect();
        let single: Vec<Vec<f64>> = (0..columns)
            .map(|c| {
                let mut one: Vec<f64> = all.iter().skip(c).step_by(columns).copied().collect();
                factor.forward(&mut one);
                one
            })
            .collect();
        factor.forward_all(&mut all, columns);
        for (c, one) in single.iter().enumerate() {
            for (i, x) in one.iter().enumerate() {
                assert!((all[i * columns + c] - x).abs() < 1e-12);
            }
        }
        factor.forward_all(&mut [], 0);
    }

    #[test]
    fn a_good_inverse_saves_products() {
        // Curvatures from one to a million.
        let curvature: Vec<f32> = (0..13).map(|i| 10f32.powf(0.5 * i as f32)).collect();
        let product =
            |v: &[f32]| -> Vec<f32> { v.iter().zip(&curvature).map(|(v, c)| c * v).collect() };
        let about = |v: &[f32]| -> Vec<f32> {
            let pairs = v.iter().zip(&curvature).enumerate();
            pairs
                .map(|(i, (v, c))| v / (c * (1.0 + 0.1 * (i % 3) as f32)))
                .collect()
        };
        let b = [1.0f32; 13];
        let error = |x: &[f32]| -> f32 {
            let pairs = product(x).into_iter().zip(b);
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
        };
        let (mut plain, mut quick) = (vec![0.0; 13], vec![0.0; 13]);
        conjugate_gradients(&mut plain, &b, 6, 1e-6, product);
        assert!(preconditioned(&mut quick, &b, 6, 1e-5, product, about));
        assert!(error(&quick) < 1e-3, "{}", error(&quick));
        assert!(error(&plain) > 0.1, "{}", error(&plain));
    }
}
