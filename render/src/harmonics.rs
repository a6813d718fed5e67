//! Real orthonormal spherical harmonics on the equirectangular grid, by a separable transform.
//!
//! Synthesis first sums over the degree l for every row and order m (Legendre), then over m for every column (Fourier):
//! P·H'·(P + 1) + H'·W'·P multiplications a frame instead of H'·W'·(P + 1)² (Driscoll & Healy 1994). All frames are
//! transformed at once, with the frame innermost so that SIMD runs over it.
//!
//! The harmonics: Y_lm = √2 K_lm cos(mφ) P_lm(cos θ) for m > 0, √2 K_l|m| sin(|m|φ) P_l|m| for m < 0, K_l0 P_l0 for
//! m = 0, with K normalising to ∫Y² dω = 1 and without the Condon–Shortley phase. Coefficient (l, m) has index l² + l + m.

mod legendre;

use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

use self::legendre::normalised_legendre;

use crate::lat_long::LatLong;
use crate::math::Float;

/// The index of coefficient (l, m), −l ≤ m ≤ l.
pub const fn coefficient(l: usize, m: isize) -> usize {
    (l * l + l).wrapping_add_signed(m)
}

/// Synthesis of spherical functions of degree P on a grid's texel centres, and its transpose.
#[derive(Clone, Debug)]
pub struct Harmonics<T> {
    degree: usize,
    grid: LatLong,
    /// `[row][|m|][l − |m|]` packed: K P_lm(cos θ_row), including the √2 of m ≠ 0.
    legendre: Vec<T>,
    /// `[column < ⌈W/2⌉][m ≤ P]`: cos(mφ).
    cosine: Vec<T>,
    /// The same for sin(mφ).
    sine: Vec<T>,
}

/// Frames are processed in blocks of this many, held in registers while a sum runs.
const BLOCK: usize = 16;
/// Coefficients that a task of a transpose sums at least.
const COEFFICIENTS: usize = 16;

impl<T: Float> Harmonics<T> {
    /// Harmonics up to and including `degree` on `grid`.
    pub fn new(degree: usize, grid: LatLong) -> Self {
        let mut legendre = Vec::new();
        for row in 0..grid.rows {
            let theta = (row as f64 + 0.5) / grid.rows as f64 * std::f64::consts::PI;
            for m in 0..=degree {
                legendre.extend(
                    normalised_legendre(degree, m, theta)
                        .into_iter()
                        .map(T::from_f64),
                );
            }
        }
        let half = grid.columns.div_ceil(2);
        let (mut cosine, mut sine) = (Vec::new(), Vec::new());
        for column in 0..half {
            let phi = (0.5 - (column as f64 + 0.5) / grid.columns as f64) * std::f64::consts::TAU;
            for m in 0..=degree {
                let (s, c) = (m as f64 * phi).sin_cos();
                cosine.push(T::from_f64(c));
                sine.push(T::from_f64(s));
            }
        }
        Self {
            degree,
            grid,
            legendre,
            cosine,
            sine,
        }
    }

    /// The highest degree P.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The number of coefficients, (P + 1)².
    pub fn coefficients(&self) -> usize {
        (self.degree + 1).pow(2)
    }

    /// The grid of texels.
    pub fn grid(&self) -> LatLong {
        self.grid
    }

    /// values = Σ_lm a_lm Y_lm at the texel centres.
    ///
    /// `coefficients` is `[coefficient][frame]`, `values` is `[texel][frame]` and is overwritten.
    pub fn synthesize(&self, coefficients: &[T], values: &mut [T], frames: usize) {
        self.check(coefficients.len(), values.len(), frames);
        let orders = || vec![T::ZERO; (2 * self.degree + 1) * frames];
        values
            .par_chunks_exact_mut((self.grid.columns * frames).max(1))
            .enumerate()
            .for_each_init(orders, |orders, (row, values)| {
                Arch::new().dispatch(SynthesisRow {
                    harmonics: self,
                    coefficients,
                    row,
                    orders,
                    values,
                    frames,
                });
            });
    }

    /// The transpose of [`synthesize`](Self::synthesize): `coefficients` is overwritten.
    pub fn transpose(&self, values: &[T], coefficients: &mut [T], frames: usize) {
        self.check(coefficients.len(), values.len(), frames);
        let (p, columns) = (self.degree, self.grid.columns);
        // `[row][order][frame]`: rows are summed afterwards, in their order, by each coefficient.
        let mut orders = vec![T::ZERO; self.grid.rows * (2 * p + 1) * frames];
        let folded = || vec![T::ZERO; 2 * columns.div_ceil(2) * frames];
        orders
            .par_chunks_exact_mut(((2 * p + 1) * frames).max(1))
            .zip(values.par_chunks_exact((columns * frames).max(1)))
            .for_each_init(folded, |folded, (orders, values)| {
                Arch::new().dispatch(TransposeRow {
                    harmonics: self,
                    values,
                    folded,
                    orders,
                    frames,
                });
            });
        coefficients
            .par_chunks_exact_mut(frames.max(1))
            .with_min_len(COEFFICIENTS)
            .enumerate()
            .for_each(|(index, out)| {
                Arch::new().dispatch(TransposeCoefficient {
                    harmonics: self,
                    orders: &orders,
                    index,
                    out,
                });
            });
    }

    fn check(&self, coefficients: usize, values: usize, frames: usize) {
        assert_eq!(
            coefficients,
            self.coefficients() * frames,
            "harmonic coefficients"
        );
        assert_eq!(values, self.grid.len() * frames, "harmonic texels");
    }

    /// The packed Legendre values of a row and order: of l = m, m + 1, ... P.
    #[inline(always)]
    fn legendre_of(&self, row: usize, m: usize) -> &[T] {
        let p = self.degree;
        let stride = (p + 1) * (p + 2) / 2;
        let start = row * stride + m * (p + 1) - m * m.saturating_sub(1) / 2;
        &self.legendre[start..start + p + 1 - m]
    }

    /// orders[m] = Σ_l K P_lm a_lm, for m = −P..P at index m + P.
    #[inline(always)]
    fn legendre_row(&self, row: usize, coefficients: &[T], orders: &mut [T], frames: usize) {
        let p = self.degree as isize;
        for m in -p..=p {
            let out = &mut orders[(m + p) as usize * frames..][..frames];
            let n = m.unsigned_abs();
            let terms = self.legendre_of(row, n);
            let source = |k: usize| &coefficients[coefficient(n + k, m) * frames..][..frames];
            combine(out, terms.len(), frames, |k| terms[k], source);
        }
    }

    /// a_lm = Σ_row K P_lm orders[row][m].
    #[inline(always)]
    fn legendre_transpose(&self, index: usize, orders: &[T], out: &mut [T]) {
        let (p, frames) = (self.degree, out.len());
        let l = index.isqrt();
        // The place of m among −P..P.
        let m = index + p - l * l - l;
        let n = m.abs_diff(p);
        let weight = |row: usize| self.legendre_of(row, n)[l - n];
        let source = |row: usize| &orders[(row * (2 * p + 1) + m) * frames..][..frames];
        combine(out, self.grid.rows, frames, weight, source);
    }

    /// Sums the orders at every column: even (cosine) and odd (sine) parts once for a column and its mirror image.
    #[inline(always)]
    fn fourier_row(&self, orders: &[T], out: &mut [T], frames: usize) {
        let (p, columns) = (self.degree, self.grid.columns);
        let mut even = vec![T::ZERO; frames];
        let mut odd = vec![T::ZERO; frames];
        for c in 0..columns.div_ceil(2) {
            let cosine = &self.cosine[c * (p + 1)..][..p + 1];
            let sine = &self.sine[c * (p + 1)..][..p + 1];
            combine(
                &mut even,
                p + 1,
                frames,
                |m| cosine[m],
                |m| &orders[(p + m) * frames..][..frames],
            );
            combine(
                &mut odd,
                p,
                frames,
                |m| sine[m + 1],
                |m| &orders[(p - m - 1) * frames..][..frames],
            );
            let mirror = columns - 1 - c;
            for f in 0..frames {
                out[c * frames + f] = even[f] + odd[f];
            }
            if mirror != c {
                for f in 0..frames {
                    out[mirror * frames + f] = even[f] - odd[f];
                }
            }
        }
    }

    #[inline(always)]
    fn fourier_row_transpose(
        &self,
        source: &[T],
        folded: &mut [T],
        orders: &mut [T],
        frames: usize,
    ) {
        let (p, columns) = (self.degree, self.grid.columns);
        let half = columns.div_ceil(2);
        let (even, odd) = folded.split_at_mut(half * frames);
        for c in 0..half {
            let mirror = columns - 1 - c;
            for f in 0..frames {
                let a = source[c * frames + f];
                let b = if mirror == c {
                    T::ZERO
                } else {
                    source[mirror * frames + f]
                };
                even[c * frames + f] = a + b;
                odd[c * frames + f] = a - b;
            }
        }
        for m in 0..=p {
            let out = &mut orders[(p + m) * frames..][..frames];
            combine(
                out,
                half,
                frames,
                |c| self.cosine[c * (p + 1) + m],
                |c| &even[c * frames..][..frames],
            );
            if m > 0 {
                let out = &mut orders[(p - m) * frames..][..frames];
                combine(
                    out,
                    half,
                    frames,
                    |c| self.sine[c * (p + 1) + m],
                    |c| &odd[c * frames..][..frames],
                );
            }
        }
    }
}

/// out = Σ_k weight(k) · source(k) over `terms` terms, blocks of frames held in registers.
#[inline(always)]
fn combine<'a, T: Float>(
    out: &mut [T],
    terms: usize,
    frames: usize,
    weight: impl Fn(usize) -> T,
    source: impl Fn(usize) -> &'a [T],
) {
    let mut start = 0;
    while start + BLOCK <= frames {
        let mut sum = [T::ZERO; BLOCK];
        for k in 0..terms {
            let w = weight(k);
            for (total, value) in sum.iter_mut().zip(&source(k)[start..start + BLOCK]) {
                *total += w * *value;
            }
        }
        out[start..start + BLOCK].copy_from_slice(&sum);
        start += BLOCK;
    }
    for f in start..frames {
        let mut sum = T::ZERO;
        for k in 0..terms {
            sum += weight(k) * source(k)[f];
        }
        out[f] = sum;
    }
}

/// A row of [`Harmonics::synthesize`]; a closure would be compiled on its own, for the least of all processors.
struct SynthesisRow<'a, T> {
    harmonics: &'a Harmonics<T>,
    coefficients: &'a [T],
    row: usize,
    orders: &'a mut [T],
    values: &'a mut [T],
    frames: usize,
}

impl<T: Float> NullaryFnOnce for SynthesisRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (harmonics, frames) = (self.harmonics, self.frames);
        harmonics.legendre_row(self.row, self.coefficients, self.orders, frames);
        harmonics.fourier_row(self.orders, self.values, frames);
    }
}

/// The orders of a row, for [`Harmonics::transpose`].
struct TransposeRow<'a, T> {
    harmonics: &'a Harmonics<T>,
    values: &'a [T],
    folded: &'a mut [T],
    orders: &'a mut [T],
    frames: usize,
}

impl<T: Float> NullaryFnOnce for TransposeRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.harmonics
            .fourier_row_transpose(self.values, self.folded, self.orders, self.frames);
    }
}

/// A coefficient of [`Harmonics::transpose`].
struct TransposeCoefficient<'a, T> {
    harmonics: &'a Harmonics<T>,
    orders: &'a [T],
    index: usize,
    out: &'a mut [T],
}

impl<T: Float> NullaryFnOnce for TransposeCoefficient<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.harmonics
            .legendre_transpose(self.index, self.orders, self.out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Y_lm of a unit vector for l ≤ 2, as polynomials (Sloan, "Stupid Spherical Harmonics Tricks", without the phase).
    fn reference(l: usize, m: isize, d: glam::DVec3) -> f64 {
        use std::f64::consts::PI;
        let (x, y, z) = (d.x, d.y, d.z);
        match (l, m) {
            (0, 0) => 0.5 / PI.sqrt(),
            (1, -1) => (3.0 / (4.0 * PI)).sqrt() * y,
            (1, 0) => (3.0 / (4.0 * PI)).sqrt() * z,
            (1, 1) => (3.0 / (4.0 * PI)).sqrt() * x,
            (2, -2) => 0.5 * (15.0 / PI).sqrt() * x * y,
            (2, -1) => 0.5 * (15.0 / PI).sqrt() * y * z,
            (2, 0) => 0.25 * (5.0 / PI).sqrt() * (3.0 * z * z - 1.0),
            (2, 1) => 0.5 * (15.0 / PI).sqrt() * x * z,
            _ => 0.25 * (15.0 / PI).sqrt() * (x * x - y * y),
        }
    }

    #[test]
    fn the_first_degrees_are_the_textbook_polynomials() {
        for grid in [LatLong::new(10, 20), LatLong::new(7, 13)] {
            let harmonics = Harmonics::<f64>::new(2, grid);
            for l in 0..=2_usize {
                for m in -(l as isize)..=l as isize {
                    let mut a = vec![0.0; 9];
                    a[coefficient(l, m)] = 1.0;
                    let mut values = vec![0.0; grid.len()];
                    harmonics.synthesize(&a, &mut values, 1);
                    for (t, v) in values.iter().enumerate() {
                        let d = grid
                            .texel_direction(t / grid.columns, t % grid.columns)
                            .as_dvec3();
                        assert!((v - reference(l, m, d)).abs() < 1e-5, "{l} {m}");
                    }
                }
            }
        }
    }

    #[test]
    fn they_are_orthonormal_by_quadrature() {
        let (degree, grid) = (6, LatLong::new(400, 32));
        let harmonics = Harmonics::<f64>::new(degree, grid);
        let n = harmonics.coefficients();
        // All coefficients at once: frame j is the j-th unit vector.
        let mut identity = vec![0.0; n * n];
        (0..n).for_each(|i| identity[i * n + i] = 1.0);
        let mut values = vec![0.0; grid.len() * n];
        harmonics.synthesize(&identity, &mut values, n);
        let mut gram = vec![0.0; n * n];
        for (t, y) in values.chunks_exact(n).enumerate() {
            let w = f64::from(grid.solid_angle(t / grid.columns));
            for i in 0..n {
                for j in 0..n {
                    gram[i * n + j] += w * y[i] * y[j];
                }
            }
        }
        for i in 0..n {
            for j in 0..n {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!(
                    (gram[i * n + j] - expected).abs() < 2e-4,
                    "{i} {j} {}",
                    gram[i * n + j]
                );
            }
        }
    }

    #[test]
    fn the_transpose_is_the_adjoint() {
        for (grid, frames) in [(LatLong::new(11, 20), 1), (LatLong::new(6, 13), 37)] {
            let harmonics = Harmonics::<f64>::new(5, grid);
            let wave = |n: usize, f: f64| (0..n).map(|i| (f * i as f64).sin()).collect::<Vec<_>>();
            let x = wave(harmonics.coefficients() * frames, 1.3);
            let y = wave(grid.len() * frames, 0.7);
            let (mut ax, mut aty) = (vec![0.0; y.len()], vec![0.0; x.len()]);
            harmonics.synthesize(&x, &mut ax, frames);
            harmonics.transpose(&y, &mut aty, frames);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(p, q)| p * q).sum::<f64>();
            assert!((dot(&ax, &y) - dot(&x, &aty)).abs() < 1e-9);
        }
    }

    #[test]
    fn single_precision_agrees_with_double() {
        let grid = LatLong::new(50, 100);
        let (single, double) = (
            Harmonics::<f32>::new(24, grid),
            Harmonics::<f64>::new(24, grid),
        );
        let a: Vec<f64> = (0..625 * 3).map(|i| (0.31 * i as f64).sin()).collect();
        let a32: Vec<f32> = a.iter().map(|&v| v as f32).collect();
        let (mut v, mut v32) = (vec![0.0; 15_000], vec![0.0; 15_000]);
        double.synthesize(&a, &mut v, 3);
        single.synthesize(&a32, &mut v32, 3);
        assert!(
            v.iter()
                .zip(&v32)
                .all(|(a, b)| (a - f64::from(*b)).abs() < 2e-4)
        );
    }
}
