//! Dense layers on blocks: channels of each lane times a uniform matrix.
//!
//! Channels are contiguous over lanes, so the product runs over tiles of lanes in registers: sums over input channels are in
//! order for every lane, and sums over lanes (the matrix's adjoint) are in the order of lanes, whatever the block.

use std::ops::Range;

use pulp::{Arch, Simd};

use super::rows::PARTIALS;
use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// Rows of a register tile: as many as registers allow, so that each operand loaded serves many products.
const ROWS: usize = 4;
const MANY_ROWS: usize = 8;
/// Registers along a row of a tile.
const TILE: usize = 2;
/// Lanes that an outer product takes at a time: transposed they stay in L1.
const LANES: usize = 32;

/// The height of the register tile of the next rows.
#[inline(always)]
fn height<S: Simd>(rows: usize) -> usize {
    match rows {
        MANY_ROWS.. if S::REGISTER_COUNT >= 32 => MANY_ROWS,
        ROWS.. => ROWS,
        _ => 1,
    }
}

/// A matrix by rows or by columns: element `(row, column)` at `row * rows + column * columns`, of which one is 1.
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
        let mut k = 0;
        // Lanes outside, rows inside: a tile of `x` is in L1 for all rows.
        while k < packs {
            let width = if k + TILE <= packs { TILE } else { 1 };
            let mut row = 0;
            while row < self.out_rows {
                let height = height::<S>(self.out_rows - row);
                match (height, width) {
                    (MANY_ROWS, TILE) => self.tile::<S, MANY_ROWS, TILE>(simd, row, k, padded),
                    (MANY_ROWS, _) => self.tile::<S, MANY_ROWS, 1>(simd, row, k, padded),
                    (ROWS, TILE) => self.tile::<S, ROWS, TILE>(simd, row, k, padded),
                    (ROWS, _) => self.tile::<S, ROWS, 1>(simd, row, k, padded),
                    (_, TILE) => self.tile::<S, 1, TILE>(simd, row, k, padded),
                    _ => self.tile::<S, 1, 1>(simd, row, k, padded),
                }
                row += height;
            }
            k += width;
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
        let width = padded / R::packs::<S>(&self.x[..padded]).0.len();
        let (first, len) = (k * width, T * width);
        // A check of bounds for every element would take as long as the products.
        if self.matrix.columns == 1 {
            let mut w = [&self.matrix.data[..0]; N];
            for n in 0..N {
                w[n] = &self.matrix.data[(row + n) * self.matrix.rows..][..self.inner];
            }
            for i in 0..self.inner {
                let x = &R::packs::<S>(&self.x[i * self.x_pitch + first..][..len]).0[..T];
                for n in 0..N {
                    let w = R::splat(simd, w[n][i]);
                    for t in 0..T {
                        sums[n][t] = R::fma(simd, w, x[t], sums[n][t]);
                    }
                }
            }
        } else {
            for i in 0..self.inner {
                let x = &R::packs::<S>(&self.x[i * self.x_pitch + first..][..len]).0[..T];
                let w = &self.matrix.data[row + i * self.matrix.columns..][..N];
                for n in 0..N {
                    let w = R::splat(simd, w[n]);
                    for t in 0..T {
                        sums[n][t] = R::fma(simd, w, x[t], sums[n][t]);
                    }
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
/// [`LANES`]` * columns` elements at least, or of `lanes * columns` if that is less.
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
        for start in (0..self.lanes).step_by(LANES) {
            self.some_lanes(simd, start..self.lanes.min(start + LANES));
        }
    }
}

impl<R: Real> Outer<'_, R> {
    #[inline(always)]
    fn some_lanes<S: Simd>(&mut self, simd: S, lanes: Range<usize>) {
        for column in 0..self.columns {
            let x = &self.x[column * self.x_pitch..][lanes.clone()];
            for (lane, x) in x.iter().enumerate() {
                self.transposed[lane * self.columns + column] = *x;
            }
        }
        let (packs, rest) = R::packs::<S>(&self.transposed[..self.columns]);
        let (packs, rest) = (packs.len(), rest.len());
        let mut row = 0;
        while row < self.rows {
            let height = height::<S>(self.rows - row);
            let mut k = 0;
            while k < packs {
                let width = if k + TILE <= packs { TILE } else { 1 };
                let lanes = lanes.clone();
                match (height, width) {
                    (MANY_ROWS, TILE) => self.tile::<S, MANY_ROWS, TILE>(simd, row, k, lanes),
                    (MANY_ROWS, _) => self.tile::<S, MANY_ROWS, 1>(simd, row, k, lanes),
                    (ROWS, TILE) => self.tile::<S, ROWS, TILE>(simd, row, k, lanes),
                    (ROWS, _) => self.tile::<S, ROWS, 1>(simd, row, k, lanes),
                    (_, TILE) => self.tile::<S, 1, TILE>(simd, row, k, lanes),
                    _ => self.tile::<S, 1, 1>(simd, row, k, lanes),
                }
                k += width;
            }
            for row in row..row + height {
                for column in self.columns - rest..self.columns {
                    self.element::<S>(row, column, lanes.clone());
                }
            }
            row += height;
        }
    }

    /// `N` rows by packs `k .. k + T` of columns.
    #[inline(always)]
    fn tile<S: Simd, const N: usize, const T: usize>(
        &mut self,
        simd: S,
        row: usize,
        k: usize,
        lanes: Range<usize>,
    ) {
        let columns = self.columns;
        let mut sums = [[R::splat(simd, R::default()); T]; N];
        for n in 0..N {
            let start = (row + n) * columns;
            let all = R::packs::<S>(&self.sums[start..start + columns]).0;
            sums[n].copy_from_slice(&all[k..k + T]);
        }
        let mut g = [&self.g[..0]; N];
        for n in 0..N {
            g[n] = &self.g[(row + n) * self.g_pitch..][lanes.clone()];
        }
        for lane in 0..lanes.len() {
            let x = &self.transposed[lane * columns..(lane + 1) * columns];
            let x = &R::packs::<S>(x).0[k..k + T];
            for n in 0..N {
                let g = R::splat(simd, g[n][lane]);
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
    fn element<F: Fma>(&mut self, row: usize, column: usize, lanes: Range<usize>) {
        let at = row * self.columns + column;
        for (i, lane) in lanes.enumerate() {
            let g = self.g[row * self.g_pitch + lane];
            let x = self.transposed[i * self.columns + column];
            self.sums[at] = g.mul_add::<F>(x, self.sums[at]);
        }
    }
}
