//! Dense layers on blocks: channels of each lane times a uniform matrix.
//!
//! Channels are contiguous over lanes, so the product runs over tiles of lanes in registers: sums over input channels are in
//! order for every lane, and sums over lanes (the matrix's adjoint) are in the order of lanes, whatever the block.

use pulp::{Arch, Simd};

use super::rows::PARTIALS;
use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// Rows of a register tile.
const ROWS: usize = 4;
/// Registers along a row of a tile.
const TILE: usize = 2;

/// A strided matrix: element `(row, column)` at `row * rows + column * columns`.
#[derive(Clone, Copy)]
pub(super) struct Matrix<'a, R> {
    pub data: &'a [R],
    pub rows: usize,
    pub columns: usize,
}

/// `out[row][lane] (+)= sum_column matrix[row][column] x[column][lane] (+ bias[row])` for `out_rows` rows and `inner` columns;
/// `x` and `out` have `pitch` elements between channels.
pub(super) struct Product<'a, R> {
    pub matrix: Matrix<'a, R>,
    pub bias: Option<&'a [R]>,
    pub x: &'a [R],
    pub x_pitch: usize,
    pub out: &'a mut [R],
    pub pitch: usize,
    pub out_rows: usize,
    pub inner: usize,
    pub lanes: usize,
    pub add: bool,
}

pub(super) fn product<R: Real>(arch: Arch, product: Product<R>) {
    dispatch(arch, product);
}

impl<R: Real> Kernel for Product<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        // Blocks are padded to whole tiles, so the last one is computed in full; what is beyond `lanes` is not read.
        let padded = self.lanes.next_multiple_of(PARTIALS);
        let packs = R::packs::<S>(&self.x[..padded]).0.len();
        let mut row = 0;
        while row < self.out_rows {
            let full = row + ROWS <= self.out_rows;
            let mut k = 0;
            while k < packs {
                if full && k + TILE <= packs {
                    self.tile::<S, ROWS, TILE>(simd, row, k, padded);
                    k += TILE;
                } else if full {
                    self.tile::<S, ROWS, 1>(simd, row, k, padded);
                    k += 1;
                } else {
                    self.tile::<S, 1, 1>(simd, row, k, padded);
                    k += 1;
                }
            }
            row += if full { ROWS } else { 1 };
        }
    }
}

impl<R: Real> Product<'_, R> {
    /// `N` rows by packs `k .. k + T` of lanes.
    #[inline(always)]
    fn tile<S: Simd, const N: usize, const T: usize>(
        &mut self,
        simd: S,
        row: usize,
        k: usize,
        padded: usize,
    ) {
        let mut sums = [[R::splat(simd, R::default()); T]; N];
        for n in 0..N {
            if let Some(bias) = self.bias {
                sums[n] = [R::splat(simd, bias[row + n]); T];
            }
            if self.add {
                let start = (row + n) * self.pitch;
                let out = &R::packs::<S>(&self.out[start..start + padded]).0[k..k + T];
                for t in 0..T {
                    sums[n][t] = R::plus(simd, sums[n][t], out[t]);
                }
            }
        }
        for i in 0..self.inner {
            let x = &self.x[i * self.x_pitch..i * self.x_pitch + padded];
            let x = &R::packs::<S>(x).0[k..k + T];
            for n in 0..N {
                let at = (row + n) * self.matrix.rows + i * self.matrix.columns;
                let w = R::splat(simd, self.matrix.data[at]);
                for t in 0..T {
                    sums[n][t] = R::fma(simd, w, x[t], sums[n][t]);
                }
            }
        }
        for n in 0..N {
            let start = (row + n) * self.pitch;
            let out = &mut R::packs_mut::<S>(&mut self.out[start..start + padded]).0[k..k + T];
            out.copy_from_slice(&sums[n]);
        }
    }
}

/// `sums[row][column] += sum_lane g[row][lane] x[column][lane]`, lanes in order. `transposed` is scratch of
/// `lanes * columns` elements.
pub(super) struct Outer<'a, R> {
    pub g: &'a [R],
    pub g_pitch: usize,
    pub x: &'a [R],
    pub x_pitch: usize,
    pub rows: usize,
    pub columns: usize,
    pub lanes: usize,
    pub transposed: &'a mut [R],
    pub sums: &'a mut [R],
}

pub(super) fn outer<R: Real>(arch: Arch, outer: Outer<R>) {
    dispatch(arch, outer);
}

impl<R: Real> Kernel for Outer<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        for column in 0..self.columns {
            let x = &self.x[column * self.x_pitch..][..self.lanes];
            for (lane, x) in x.iter().enumerate() {
                self.transposed[lane * self.columns + column] = *x;
            }
        }
        let (packs, rest) = R::packs::<S>(&self.transposed[..self.columns]);
        let (packs, rest) = (packs.len(), rest.len());
        let mut row = 0;
        while row < self.rows {
            let full = row + ROWS <= self.rows;
            let mut k = 0;
            while k < packs {
                if full && k + TILE <= packs {
                    self.tile::<S, ROWS, TILE>(simd, row, k);
                    k += TILE;
                } else if full {
                    self.tile::<S, ROWS, 1>(simd, row, k);
                    k += 1;
                } else {
                    self.tile::<S, 1, 1>(simd, row, k);
                    k += 1;
                }
            }
            let height = if full { ROWS } else { 1 };
            for row in row..row + height {
                for column in self.columns - rest..self.columns {
                    self.element::<S>(row, column);
                }
            }
            row += height;
        }
    }
}

impl<R: Real> Outer<'_, R> {
    /// `N` rows by packs `k .. k + T` of columns.
    #[inline(always)]
    fn tile<S: Simd, const N: usize, const T: usize>(&mut self, simd: S, row: usize, k: usize) {
        let columns = self.columns;
        let mut sums = [[R::splat(simd, R::default()); T]; N];
        for n in 0..N {
            let start = (row + n) * columns;
            let all = R::packs::<S>(&self.sums[start..start + columns]).0;
            sums[n].copy_from_slice(&all[k..k + T]);
        }
        for lane in 0..self.lanes {
            let x = &self.transposed[lane * columns..(lane + 1) * columns];
            let x = &R::packs::<S>(x).0[k..k + T];
            for n in 0..N {
                let g = R::splat(simd, self.g[(row + n) * self.g_pitch + lane]);
                for t in 0..T {
                    sums[n][t] = R::fma(simd, g, x[t], sums[n][t]);
                }
            }
        }
        for n in 0..N {
            let start = (row + n) * columns;
            let all = R::packs_mut::<S>(&mut self.sums[start..start + columns]).0;
            all[k..k + T].copy_from_slice(&sums[n]);
        }
    }

    #[inline(always)]
    fn element<F: Fma>(&mut self, row: usize, column: usize) {
        let at = row * self.columns + column;
        for lane in 0..self.lanes {
            let g = self.g[row * self.g_pitch + lane];
            let x = self.transposed[lane * self.columns + column];
            self.sums[at] = g.mul_add::<F>(x, self.sums[at]);
        }
    }
}
