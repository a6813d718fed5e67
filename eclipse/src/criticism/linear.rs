//! Linear algebra: conjugate gradients for what is known by its products, and small dense systems.

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
    /// Of the leading `n` × `n` part of a symmetric matrix of `stride` columns; pivots that vanish are lifted to a trace of
    /// the largest, which leaves their direction unmoved.
    pub fn new(a: &[f64], n: usize, stride: usize) -> Self {
        let largest = (0..n).map(|i| a[i * stride + i]).fold(0.0, f64::max);
        let floor = 1e-12 * largest.max(1e-300);
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            let (above, row) = l.split_at_mut(i * n);
            for j in 0..i {
                let other = &above[j * n..j * n + j];
                let s = a[i * stride + j] - inner(&row[..j], other);
                row[j] = s / above[j * n + j];
            }
            let s = a[i * stride + i] - inner(&row[..i], &row[..i]);
            row[i] = s.max(floor).sqrt();
        }
        Self { n, l }
    }

    /// L⁻¹ b for many right-hand sides: `b` is `[row][column]`, `columns` wide.
    pub fn forward(&self, b: &mut [f64], columns: usize) {
        for i in 0..self.n {
            let (done, rest) = b.split_at_mut(i * columns);
            let row = &mut rest[..columns];
            for j in 0..i {
                let factor = self.l[i * self.n + j];
                if factor != 0.0 {
                    let source = &done[j * columns..(j + 1) * columns];
                    row.iter_mut()
                        .zip(source)
                        .for_each(|(r, s)| *r -= factor * s);
                }
            }
            let pivot = 1.0 / self.l[i * self.n + i];
            row.iter_mut().for_each(|r| *r *= pivot);
        }
    }

    /// L⁻ᵀ b, likewise.
    pub fn backward(&self, b: &mut [f64], columns: usize) {
        for i in (0..self.n).rev() {
            let (head, rest) = b.split_at_mut((i + 1) * columns);
            let row = &mut head[i * columns..];
            for j in i + 1..self.n {
                let factor = self.l[j * self.n + i];
                if factor != 0.0 {
                    let source = &rest[(j - i - 1) * columns..(j - i) * columns];
                    row.iter_mut()
                        .zip(source)
                        .for_each(|(r, s)| *r -= factor * s);
                }
            }
            let pivot = 1.0 / self.l[i * self.n + i];
            row.iter_mut().for_each(|r| *r *= pivot);
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
        factor.forward(&mut x, 1);
        factor.backward(&mut x, 1);
        assert!((x[0] - 1.0 / 11.0).abs() < 1e-12 && (x[1] - 7.0 / 11.0).abs() < 1e-12);
        let mut x = vec![0.0f32; 2];
        conjugate_gradients(&mut x, &[1.0, 2.0], 10, 1e-9, |v| {
            vec![4.0 * v[0] + v[1], v[0] + 3.0 * v[1]]
        });
        assert!((f64::from(x[1]) - 7.0 / 11.0).abs() < 1e-6);
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
