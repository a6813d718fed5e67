//! Dense layers on blocks: channels of each lane times a uniform matrix.
//!
//! Channels are contiguous over lanes, so the product runs over tiles of lanes in registers: sums over input channels are in
//! order for every lane, and sums over lanes (the matrix's adjoint) are in the order of lanes, whatever the block.

use std::ops::Range;

use pulp::{Arch, Simd};

use super::rows::PARTIALS;
use super::zero::{Derivative, add_product, all_finite};
use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// Rows of a register tile, and registers along each: as many as there are registers for, so that each operand loaded serves
/// many products, and addresses are computed for few rows.
const ROWS: usize = 4;
const TILE: usize = 2;
/// The same with 32 registers.
const MANY_ROWS: usize = 6;
const WIDE_TILE: usize = 4;
/// Lanes that an outer product takes at a time: a panel of them, transposed, stays in L1.
const LANES: usize = 128;
/// Input channels that a product takes at a time, and most lanes of a tile: a copy of them side by side stays in L1, where
/// channels as they are lie on more pages than a core translates without waiting.
const DEPTH: usize = 64;
const PANEL: usize = 64;

/// A panel on a cache line, so that no vector load straddles two.
#[repr(align(64))]
struct Panel<R>([R; DEPTH * PANEL]);

/// The height of the register tile of the next rows.
#[inline(always)]
fn height<S: Simd>(rows: usize) -> usize {
    match rows {
        MANY_ROWS.. if S::REGISTER_COUNT >= 32 => MANY_ROWS,
        ROWS.. => ROWS,
        _ => 1,
    }
}

/// The registers along a row of the next tile.
#[inline(always)]
fn width<S: Simd>(packs: usize) -> usize {
    match packs {
        WIDE_TILE.. if S::REGISTER_COUNT >= 32 => WIDE_TILE,
        TILE.. => TILE,
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
    /// Of the matrix and `x`.
    pub derivative: Derivative,
}

pub(super) fn product<R: Real>(arch: Arch, product: Product<R>) {
    dispatch(arch, product);
}

impl<R: Real> Kernel for Product<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        if !self.is_safe(simd) {
            return self.one_by_one::<S>();
        }
        // Blocks are padded to whole tiles, so the last one is computed in full; what is beyond `lanes` is not read.
        let padded = self.lanes.next_multiple_of(PARTIALS);
        let packs = R::packs::<S>(&self.x[..padded]).0.len();
        let mut panel = Panel([R::default(); DEPTH * PANEL]);
        let mut k = 0;
        // Lanes outside, rows inside: a tile of `x` is in L1 for all rows.
        while k < packs {
            let width = width::<S>(packs - k);
            // Without channels there is still a bias.
            for start in (0..self.inner.max(1)).step_by(DEPTH) {
                let inner = start..self.inner.min(start + DEPTH);
                self.copy(
                    k * padded / packs,
                    width * padded / packs,
                    &inner,
                    &mut panel.0,
                );
                self.rows(simd, (k, width), padded, inner, &panel.0);
            }
            k += width;
        }
    }
}

impl<R: Real> Product<'_, R> {
    /// Whether a derivative of 0 times the other factor is 0 everywhere.
    #[inline(always)]
    fn is_safe<S: Simd>(&self, simd: S) -> bool {
        match self.derivative {
            Derivative::Neither => true,
            Derivative::First => {
                let mut finite = true;
                for i in 0..self.inner {
                    finite &= all_finite(simd, &self.x[i * self.x_pitch..][..self.lanes]);
                }
                finite
            }
            Derivative::Second => all_finite(simd, self.matrix.data),
        }
    }

    /// Everything, without tiles and by the zero rule; sums are in the same order.
    #[inline(always)]
    fn one_by_one<F: Fma>(&mut self) {
        for row in 0..self.out_rows {
            let out = &mut self.out[row * self.pitch..][..self.lanes];
            let bias = self.bias.map_or(R::default(), |bias| bias[row]);
            for out in out.iter_mut() {
                *out = if self.add { bias + *out } else { bias };
            }
            for i in 0..self.inner {
                let w = self.matrix.data[row * self.matrix.rows + i * self.matrix.columns];
                let x = &self.x[i * self.x_pitch..][..self.lanes];
                for (out, x) in out.iter_mut().zip(x) {
                    *out = add_product::<R, F>(w, *x, *out, self.derivative);
                }
            }
        }
    }

    /// Lanes `first .. first + len` of some channels, one channel after the other.
    #[inline(always)]
    fn copy(&self, first: usize, len: usize, inner: &Range<usize>, panel: &mut [R]) {
        for (i, row) in inner.clone().zip(panel.chunks_exact_mut(len)) {
            row.copy_from_slice(&self.x[i * self.x_pitch + first..][..len]);
        }
    }

    /// What some channels add to all rows of a tile.
    #[inline(always)]
    fn rows<S: Simd>(
        &mut self,
        simd: S,
        (k, width): (usize, usize),
        padded: usize,
        inner: Range<usize>,
        panel: &[R],
    ) {
        let mut row = 0;
        while row < self.out_rows {
            let height = height::<S>(self.out_rows - row);
            let (at, inner) = ((row, k), inner.clone());
            match (height, width) {
                (MANY_ROWS, WIDE_TILE) => {
                    self.tile::<S, MANY_ROWS, WIDE_TILE>(simd, at, padded, inner, panel)
                }
                (MANY_ROWS, TILE) => {
                    self.tile::<S, MANY_ROWS, TILE>(simd, at, padded, inner, panel)
                }
                (MANY_ROWS, _) => self.tile::<S, MANY_ROWS, 1>(simd, at, padded, inner, panel),
                (ROWS, WIDE_TILE) => {
                    self.tile::<S, ROWS, WIDE_TILE>(simd, at, padded, inner, panel)
                }
                (ROWS, TILE) => self.tile::<S, ROWS, TILE>(simd, at, padded, inner, panel),
                (ROWS, _) => self.tile::<S, ROWS, 1>(simd, at, padded, inner, panel),
                (_, WIDE_TILE) => self.tile::<S, 1, WIDE_TILE>(simd, at, padded, inner, panel),
                (_, TILE) => self.tile::<S, 1, TILE>(simd, at, padded, inner, panel),
                _ => self.tile::<S, 1, 1>(simd, at, padded, inner, panel),
            }
            row += height;
        }
    }

    /// `N` rows by packs `k .. k + T` of lanes.
    #[inline(always)]
    fn tile<S: Simd, const N: usize, const T: usize>(
        &mut self,
        simd: S,
        (row, k): (usize, usize),
        padded: usize,
        inner: Range<usize>,
        panel: &[R],
    ) {
        let begun = inner.start > 0;
        let mut sums = [[R::splat(simd, R::default()); T]; N];
        for n in 0..N {
            if let Some(bias) = self.bias.filter(|_| !begun) {
                sums[n] = [R::splat(simd, bias[row + n]); T];
            }
            if self.add || begun {
                let start = (row + n) * self.pitch;
                let out = &R::packs::<S>(&self.out[start..start + padded]).0[k..k + T];
                for t in 0..T {
                    sums[n][t] = if begun {
                        out[t]
                    } else {
                        R::plus(simd, sums[n][t], out[t])
                    };
                }
            }
        }
        let len = T * (padded / R::packs::<S>(&self.x[..padded]).0.len());
        let panel = panel[..inner.len() * len].chunks_exact(len);
        // A check of bounds for every element would take as long as the products.
        if self.matrix.columns == 1 {
            let mut w = [&self.matrix.data[..0]; N];
            for n in 0..N {
                w[n] = &self.matrix.data[(row + n) * self.matrix.rows..][inner.clone()];
            }
            for (i, x) in panel.enumerate() {
                let x = &R::packs::<S>(x).0[..T];
                for n in 0..N {
                    let w = R::splat(simd, w[n][i]);
                    for t in 0..T {
                        sums[n][t] = R::fma(simd, w, x[t], sums[n][t]);
                    }
                }
            }
        } else {
            for (i, x) in inner.zip(panel) {
                let x = &R::packs::<S>(x).0[..T];
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

/// `sums[row][column] += sum_lane g[row][lane] x[column][lane]`, lanes in order; `g` is a derivative. `transposed` is scratch of
/// `lanes * columns` elements at least.
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
        let (packs, rest) = R::packs::<S>(&self.sums[..self.columns]);
        let (packs, whole) = (packs.len(), self.columns - rest.len());
        let mut k = 0;
        // Columns outside, rows inside: a panel of `x` is in L1 for all rows.
        while k < packs {
            let width = width::<S>(packs - k);
            let size = whole / packs;
            let columns = k * size..(k + width) * size;
            self.transpose(lanes.clone(), columns.clone());
            if all_finite(simd, &self.transposed[..lanes.len() * columns.len()]) {
                self.rows(simd, (k, width), lanes.clone());
            } else {
                self.one_by_one::<S>(lanes.clone(), columns);
            }
            k += width;
        }
        for column in whole..self.columns {
            if all_finite(simd, &self.x[column * self.x_pitch..][lanes.clone()]) {
                self.column::<S>(column, lanes.clone());
            } else {
                self.one_by_one::<S>(lanes.clone(), column..column + 1);
            }
        }
    }

    /// Some columns of some lanes, lane after lane.
    #[inline(always)]
    fn transpose(&mut self, lanes: Range<usize>, columns: Range<usize>) {
        const SIDE: usize = 4;
        let width = columns.len();
        let column = |i: usize| &self.x[(columns.start + i) * self.x_pitch..][lanes.clone()];
        let mut first = 0;
        // Four at a time: they interleave in vectors, and then make a quarter of the stores.
        let mut quads = [[R::default(); SIDE]; LANES];
        while first + SIDE <= width {
            let x: [&[R]; SIDE] = std::array::from_fn(|i| column(first + i));
            let quads = &mut quads[..lanes.len()];
            for (lane, quad) in quads.iter_mut().enumerate() {
                *quad = [x[0][lane], x[1][lane], x[2][lane], x[3][lane]];
            }
            let to = self.transposed.chunks_exact_mut(width);
            for (to, quad) in to.zip(quads) {
                to[first..first + SIDE].copy_from_slice(quad);
            }
            first += SIDE;
        }
        for i in first..width {
            let to = self.transposed.chunks_exact_mut(width);
            for (to, x) in to.zip(column(i)) {
                to[i] = *x;
            }
        }
    }

    /// All rows by packs `k .. k + width` of columns.
    #[inline(always)]
    fn rows<S: Simd>(&mut self, simd: S, (k, width): (usize, usize), lanes: Range<usize>) {
        let mut row = 0;
        while row < self.rows {
            let height = height::<S>(self.rows - row);
            let lanes = lanes.clone();
            match (height, width) {
                (MANY_ROWS, WIDE_TILE) => self.tile::<S, MANY_ROWS, WIDE_TILE>(simd, row, k, lanes),
                (MANY_ROWS, TILE) => self.tile::<S, MANY_ROWS, TILE>(simd, row, k, lanes),
                (MANY_ROWS, _) => self.tile::<S, MANY_ROWS, 1>(simd, row, k, lanes),
                (ROWS, WIDE_TILE) => self.tile::<S, ROWS, WIDE_TILE>(simd, row, k, lanes),
                (ROWS, TILE) => self.tile::<S, ROWS, TILE>(simd, row, k, lanes),
                (ROWS, _) => self.tile::<S, ROWS, 1>(simd, row, k, lanes),
                (_, WIDE_TILE) => self.tile::<S, 1, WIDE_TILE>(simd, row, k, lanes),
                (_, TILE) => self.tile::<S, 1, TILE>(simd, row, k, lanes),
                _ => self.tile::<S, 1, 1>(simd, row, k, lanes),
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
        let mut width = 0;
        for n in 0..N {
            let start = (row + n) * columns;
            let (all, rest) = R::packs::<S>(&self.sums[start..start + columns]);
            sums[n].copy_from_slice(&all[k..k + T]);
            width = T * ((columns - rest.len()) / all.len());
        }
        let mut g = [&self.g[..0]; N];
        for n in 0..N {
            g[n] = &self.g[(row + n) * self.g_pitch..][lanes.clone()];
        }
        let panel = self.transposed[..lanes.len() * width].chunks_exact(width);
        for (lane, x) in panel.enumerate() {
            let x = &R::packs::<S>(x).0[..T];
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

    /// All rows of a column that fills no register.
    #[inline(always)]
    fn column<S: Simd>(&mut self, column: usize, lanes: Range<usize>) {
        let mut row = 0;
        while row < self.rows {
            let height = height::<S>(self.rows - row);
            match height {
                MANY_ROWS => self.column_rows::<S, MANY_ROWS>(row, column, lanes.clone()),
                ROWS => self.column_rows::<S, ROWS>(row, column, lanes.clone()),
                _ => self.column_rows::<S, 1>(row, column, lanes.clone()),
            }
            row += height;
        }
    }

    /// `N` rows of a column: sums side by side, since each waits for its own last addition only.
    #[inline(always)]
    fn column_rows<F: Fma, const N: usize>(
        &mut self,
        row: usize,
        column: usize,
        lanes: Range<usize>,
    ) {
        let mut g = [&self.g[..0]; N];
        for n in 0..N {
            g[n] = &self.g[(row + n) * self.g_pitch..][lanes.clone()];
        }
        let at = |n: usize| (row + n) * self.columns + column;
        let mut sums: [R; N] = std::array::from_fn(|n| self.sums[at(n)]);
        let x = &self.x[column * self.x_pitch..][lanes];
        for (lane, x) in x.iter().enumerate() {
            for n in 0..N {
                sums[n] = g[n][lane].mul_add::<F>(*x, sums[n]);
            }
        }
        for n in 0..N {
            self.sums[(row + n) * self.columns + column] = sums[n];
        }
    }

    /// Some columns of some lanes, without tiles and by the zero rule.
    #[inline(always)]
    fn one_by_one<F: Fma>(&mut self, lanes: Range<usize>, columns: Range<usize>) {
        for row in 0..self.rows {
            let g = &self.g[row * self.g_pitch..][lanes.clone()];
            for column in columns.clone() {
                let x = &self.x[column * self.x_pitch..][lanes.clone()];
                let sum = &mut self.sums[row * self.columns + column];
                for (g, x) in g.iter().zip(x) {
                    *sum = add_product::<R, F>(*g, *x, *sum, Derivative::First);
                }
            }
        }
    }
}
