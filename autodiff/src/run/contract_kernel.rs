//! Vector loops of a contraction over segments: rows along the axis, and coefficients without axis in `C` channels.

use pulp::Simd;

use crate::op::kernel::Kernel;
use crate::real::Real;

/// Registers that hold columns of one channel.
const TILE: usize = 3;

/// `sums[c * pitch + k] += sum_lane sum_n factors[n][c][lane] rows[n][lane][k]`, lanes in order, and `N` terms in order within
/// a lane.
pub(super) struct Accumulate<'a, R, const N: usize, const C: usize> {
    pub factors: [[&'a [R]; C]; N],
    pub rows: [&'a [R]; N],
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
        for c in 0..C {
            let sums = &mut self.sums[c * self.pitch..c * self.pitch + self.axis];
            let rest = R::packs_mut::<S>(sums).1;
            if rest.is_empty() {
                continue;
            }
            for lane in 0..lanes {
                for n in 0..N {
                    let row = &self.rows[n][lane * self.axis..(lane + 1) * self.axis];
                    let factor = self.factors[n][c][lane];
                    for (sum, x) in rest.iter_mut().zip(R::packs::<S>(row).1) {
                        *sum = factor.mul_add::<S>(*x, *sum);
                    }
                }
            }
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
        for c in 0..C {
            let all = R::packs_mut::<S>(&mut self.sums[c * pitch..c * pitch + axis]).0;
            all[k..k + T].copy_from_slice(&sums[c]);
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
        for (lane, row) in self.rows.chunks_exact(self.axis).enumerate() {
            let (row, row_rest) = R::packs::<S>(row);
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
                let product = self.g[k] * other[k];
                out[k] = if self.add { out[k] + product } else { product };
            }
        }
    }
}

#[inline(always)]
fn scale<R: Real>(factor: R, x: &[R], out: &mut [R], add: bool) {
    if add {
        for (out, x) in out.iter_mut().zip(x) {
            *out = *out + factor * *x;
        }
    } else {
        for (out, x) in out.iter_mut().zip(x) {
            *out = factor * *x;
        }
    }
}
