//! Vector loops of a contraction over segments: rows along the axis, and coefficients without axis in `C` channels.

use std::ops::Range;

use pulp::Simd;

use super::zero::{Derivative, add_product, all_finite, are_finite, times};
use crate::op::kernel::Kernel;
use crate::real::{Fma, Real};

/// Registers that hold columns of one channel.
const TILE: usize = 3;

/// `sums[c * pitch + k] += sum_lane sum_n factors[n][c][lane] rows[n][lane][k]`, lanes in order, and `N` terms in order within
/// a lane.
pub(super) struct Accumulate<'a, R, const N: usize, const C: usize> {
    pub factors: [[&'a [R]; C]; N],
    pub rows: [&'a [R]; N],
    /// Of each term's factor and row.
    pub derivatives: [Derivative; N],
    pub axis: usize,
    pub sums: &'a mut [R],
    pub pitch: usize,
}

impl<R: Real, const N: usize, const C: usize> Kernel for Accumulate<'_, R, N, C> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let lanes = self.rows[0].len() / self.axis;
        for n in 0..N {
            self.rows[n] = &self.rows[n][..lanes * self.axis];
            for c in 0..C {
                self.factors[n][c] = &self.factors[n][c][..lanes];
            }
        }
        let packs = R::packs::<S>(&self.sums[..self.axis]).0.len();
        let mut k = 0;
        while k + TILE <= packs {
            self.tile::<S, TILE>(simd, k, lanes);
            k += TILE;
        }
        while k < packs {
            self.tile::<S, 1>(simd, k, lanes);
            k += 1;
        }
        let rest = R::packs::<S>(&self.sums[..self.axis]).1.len();
        if rest > 0 {
            self.one_by_one::<S>(self.axis - rest..self.axis, lanes);
        }
    }
}

impl<R: Real, const N: usize, const C: usize> Accumulate<'_, R, N, C> {
    /// Packs `k .. k + T` of the rows, with their sums in registers over all lanes.
    #[inline(always)]
    fn tile<S: Simd, const T: usize>(&mut self, simd: S, k: usize, lanes: usize) {
        let (axis, pitch) = (self.axis, self.pitch);
        let mut sums = [[R::splat(simd, R::default()); T]; C];
        for c in 0..C {
            let all = R::packs::<S>(&self.sums[c * pitch..c * pitch + axis]).0;
            sums[c].copy_from_slice(&all[k..k + T]);
        }
        let (rows, factors) = (self.rows, self.factors);
        for lane in 0..lanes {
            for n in 0..N {
                let row = &rows[n][lane * axis..(lane + 1) * axis];
                let row = &R::packs::<S>(row).0[k..k + T];
                for c in 0..C {
                    let factor = R::splat(simd, factors[n][c][lane]);
                    for t in 0..T {
                        sums[c][t] = R::fma(simd, factor, row[t], sums[c][t]);
                    }
                }
            }
        }
        let differentiates = self.derivatives.iter().any(|&d| d != Derivative::Neither);
        if differentiates && !are_finite::<R, S, C, T>(simd, &sums) {
            let width = size_of::<R::Pack<S>>() / size_of::<R>();
            return self.one_by_one::<S>(k * width..(k + T) * width, lanes);
        }
        for c in 0..C {
            let all = R::packs_mut::<S>(&mut self.sums[c * pitch..c * pitch + axis]).0;
            all[k..k + T].copy_from_slice(&sums[c]);
        }
    }

    /// Some elements of the sums, without vectors and by the zero rule.
    #[inline(always)]
    fn one_by_one<F: Fma>(&mut self, elements: Range<usize>, lanes: usize) {
        for c in 0..C {
            let sums = &mut self.sums[c * self.pitch..][elements.clone()];
            for lane in 0..lanes {
                for n in 0..N {
                    let row = &self.rows[n][lane * self.axis..][elements.clone()];
                    let (factor, derivative) = (self.factors[n][c][lane], self.derivatives[n]);
                    for (sum, x) in sums.iter_mut().zip(row) {
                        *sum = add_product::<R, F>(factor, *x, *sum, derivative);
                    }
                }
            }
        }
    }
}

/// `out[c * pitch + lane] (+)= <g[c], rows[lane]>`: the adjoint of the coefficients.
pub(super) struct Dots<'a, R, const C: usize> {
    pub g: [&'a [R]; C],
    pub rows: &'a [R],
    pub axis: usize,
    pub out: &'a mut [R],
    pub pitch: usize,
    pub add: bool,
}

impl<R: Real, const C: usize> Kernel for Dots<'_, R, C> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (lane, whole) in self.rows.chunks_exact(self.axis).enumerate() {
            let (row, row_rest) = R::packs::<S>(whole);
            let mut sums = [R::splat(simd, R::default()); C];
            for c in 0..C {
                for (g, x) in R::packs::<S>(self.g[c]).0.iter().zip(row) {
                    sums[c] = R::fma(simd, *g, *x, sums[c]);
                }
            }
            for c in 0..C {
                let mut sum = R::sum(simd, sums[c]);
                for (g, x) in R::packs::<S>(self.g[c]).1.iter().zip(row_rest) {
                    sum = g.mul_add::<S>(*x, sum);
                }
                if !sum.is_finite() {
                    sum = R::default();
                    for (g, x) in self.g[c].iter().zip(whole) {
                        sum = add_product::<R, S>(*g, *x, sum, Derivative::First);
                    }
                }
                let out = &mut self.out[c * self.pitch + lane];
                *out = if self.add { *out + sum } else { sum };
            }
        }
    }
}

/// `rows[lane][k] (+)= sum_c factors[c][lane] g[c][k]`: the adjoint of the rows.
pub(super) struct PullRows<'a, R, const C: usize> {
    pub g: [&'a [R]; C],
    pub factors: [&'a [R]; C],
    pub axis: usize,
    pub rows: &'a mut [R],
    pub add: bool,
}

impl<R: Real, const C: usize> Kernel for PullRows<'_, R, C> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let mut finite = true;
        for c in 0..C {
            finite &= all_finite(simd, self.factors[c]);
        }
        if !finite {
            return self.one_by_one::<S>();
        }
        let packs = R::packs::<S>(self.g[0]).0.len();
        let mut k = 0;
        while k + TILE <= packs {
            self.tile::<S, TILE>(simd, k);
            k += TILE;
        }
        while k < packs {
            self.tile::<S, 1>(simd, k);
            k += 1;
        }
        for (lane, row) in self.rows.chunks_exact_mut(self.axis).enumerate() {
            for (j, out) in R::packs_mut::<S>(row).1.iter_mut().enumerate() {
                let mut sum = if self.add { *out } else { R::default() };
                for c in 0..C {
                    let g = R::packs::<S>(self.g[c]).1[j];
                    sum = self.factors[c][lane].mul_add::<S>(g, sum);
                }
                *out = sum;
            }
        }
    }
}

impl<R: Real, const C: usize> PullRows<'_, R, C> {
    /// All rows, without vectors and by the zero rule.
    #[inline(always)]
    fn one_by_one<F: Fma>(&mut self) {
        for (lane, row) in self.rows.chunks_exact_mut(self.axis).enumerate() {
            for (k, out) in row.iter_mut().enumerate() {
                let mut sum = if self.add { *out } else { R::default() };
                for c in 0..C {
                    let (factor, g) = (self.factors[c][lane], self.g[c][k]);
                    sum = add_product::<R, F>(factor, g, sum, Derivative::Second);
                }
                *out = sum;
            }
        }
    }

    /// Packs `k .. k + T` of the rows, with those of `g` in registers over all lanes.
    #[inline(always)]
    fn tile<S: Simd, const T: usize>(&mut self, simd: S, k: usize) {
        let mut g = [[R::splat(simd, R::default()); T]; C];
        for c in 0..C {
            g[c].copy_from_slice(&R::packs::<S>(self.g[c]).0[k..k + T]);
        }
        let mut factors = self.factors;
        let lanes = self.rows.len() / self.axis;
        for c in 0..C {
            factors[c] = &factors[c][..lanes];
        }
        for (lane, row) in self.rows.chunks_exact_mut(self.axis).enumerate() {
            let row = &mut R::packs_mut::<S>(row).0[k..k + T];
            for t in 0..T {
                let mut sum = if self.add {
                    row[t]
                } else {
                    R::splat(simd, R::default())
                };
                for c in 0..C {
                    sum = R::fma(simd, R::splat(simd, factors[c][lane]), g[c][t], sum);
                }
                row[t] = sum;
            }
        }
    }
}

/// `out (+)= g * other`, with `g` repeated for every row.
pub(super) struct Products<'a, R> {
    pub g: &'a [R],
    pub other: &'a [R],
    pub out: &'a mut [R],
    pub add: bool,
}

impl<R: Real> Kernel for Products<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let axis = self.g.len();
        if axis == 1 {
            scale(self.g[0], self.other, self.out, self.add);
            return;
        }
        for (other, out) in self
            .other
            .chunks_exact(axis)
            .zip(self.out.chunks_exact_mut(axis))
        {
            for k in 0..axis {
                let product = times(self.g[k], other[k]);
                out[k] = if self.add { out[k] + product } else { product };
            }
        }
    }
}

#[inline(always)]
fn scale<R: Real>(factor: R, x: &[R], out: &mut [R], add: bool) {
    if factor.is_zero() {
        if !add {
            out.fill(R::default());
        }
    } else if add {
        for (out, x) in out.iter_mut().zip(x) {
            *out = *out + factor * *x;
        }
    } else {
        for (out, x) in out.iter_mut().zip(x) {
            *out = factor * *x;
        }
    }
}
