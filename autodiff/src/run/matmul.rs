//! Dense layers on blocks: channels of each lane times a uniform matrix.
//!
//! Channels are contiguous over lanes, so the product runs over tiles of lanes in registers: sums over input channels are in
//! order for every lane, and sums over lanes (the matrix's adjoint) are in the order of lanes, whatever the block.

use pulp::Arch;

use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// Lanes of a register tile.
const TILE: usize = 16;
/// Rows of a register tile.
const ROWS: usize = 4;

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
    #[inline(always)]
    fn run<F: Fma>(mut self) {
        let mut row = 0;
        while row < self.out_rows {
            let mut lane = 0;
            let full = row + ROWS <= self.out_rows;
            while lane < self.lanes {
                if full && lane + 2 * TILE <= self.lanes {
                    self.tile::<F, ROWS, 2>(row, lane, 2 * TILE);
                    lane += 2 * TILE;
                } else if full {
                    let width = TILE.min(self.lanes - lane);
                    self.tile::<F, ROWS, 1>(row, lane, width);
                    lane += width;
                } else {
                    let width = TILE.min(self.lanes - lane);
                    self.tile::<F, 1, 1>(row, lane, width);
                    lane += width;
                }
            }
            row += if full { ROWS } else { 1 };
        }
    }
}

impl<R: Real> Product<'_, R> {
    /// `N` rows by `T` tiles of lanes, of which `width` count.
    #[inline(always)]
    fn tile<F: Fma, const N: usize, const T: usize>(
        &mut self,
        row: usize,
        lane: usize,
        width: usize,
    ) {
        let mut sums = [[[R::default(); TILE]; T]; N];
        if let Some(bias) = self.bias {
            for n in 0..N {
                sums[n] = [[bias[row + n]; TILE]; T];
            }
        }
        for k in 0..self.inner {
            // Rows of a block are padded to whole tiles, so a tail may be computed in full and dropped.
            let x = &self.x[k * self.x_pitch + lane..][..T * TILE];
            for n in 0..N {
                let at = (row + n) * self.matrix.rows + k * self.matrix.columns;
                let w = self.matrix.data[at];
                for t in 0..T {
                    for j in 0..TILE {
                        sums[n][t][j] = w.mul_add::<F>(x[t * TILE + j], sums[n][t][j]);
                    }
                }
            }
        }
        for n in 0..N {
            let start = (row + n) * self.pitch + lane;
            let out = &mut self.out[start..start + width];
            for (j, out) in out.iter_mut().enumerate() {
                let sum = sums[n][j / TILE][j % TILE];
                *out = if self.add { *out + sum } else { sum };
            }
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
    #[inline(always)]
    fn run<F: Fma>(mut self) {
        for column in 0..self.columns {
            let x = &self.x[column * self.x_pitch..][..self.lanes];
            for (lane, x) in x.iter().enumerate() {
                self.transposed[lane * self.columns + column] = *x;
            }
        }
        let mut row = 0;
        while row < self.rows {
            let full = row + ROWS <= self.rows;
            let mut column = 0;
            while column < self.columns {
                let rest = self.columns - column;
                match (full, rest >= 2 * TILE, rest >= TILE) {
                    (true, true, _) => {
                        self.tile::<F, ROWS, 2>(row, column);
                        column += 2 * TILE;
                    }
                    (true, false, true) => {
                        self.tile::<F, ROWS, 1>(row, column);
                        column += TILE;
                    }
                    (false, _, true) => {
                        self.tile::<F, 1, 1>(row, column);
                        column += TILE;
                    }
                    _ => {
                        for n in row..(row + if full { ROWS } else { 1 }) {
                            self.element::<F>(n, column);
                        }
                        column += 1;
                    }
                }
            }
            row += if full { ROWS } else { 1 };
        }
    }
}

impl<R: Real> Outer<'_, R> {
    #[inline(always)]
    fn tile<F: Fma, const N: usize, const T: usize>(&mut self, row: usize, column: usize) {
        let mut sums = [[[R::default(); TILE]; T]; N];
        for n in 0..N {
            for t in 0..T {
                let start = (row + n) * self.columns + column + t * TILE;
                sums[n][t].copy_from_slice(&self.sums[start..start + TILE]);
            }
        }
        for lane in 0..self.lanes {
            let x = &self.transposed[lane * self.columns + column..][..T * TILE];
            for n in 0..N {
                let g = self.g[(row + n) * self.g_pitch + lane];
                for t in 0..T {
                    for j in 0..TILE {
                        sums[n][t][j] = g.mul_add::<F>(x[t * TILE + j], sums[n][t][j]);
                    }
                }
            }
        }
        for n in 0..N {
            for t in 0..T {
                let start = (row + n) * self.columns + column + t * TILE;
                self.sums[start..start + TILE].copy_from_slice(&sums[n][t]);
            }
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
