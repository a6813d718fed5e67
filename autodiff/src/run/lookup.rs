//! Gathers from whole tables and their adjoint, scatter-add into a chunk's private table.
//!
//! A lookup needs all channels of a row at once, so tables of several channels are read from, and scattered into, a copy in
//! the order `[lane][channel][axis]`: one cache line instead of one for each channel.

use pulp::{Arch, Simd};

use crate::buffer::Buffer;
use crate::op::kernel::{Kernel, dispatch};
use crate::real::Real;

/// Rows of a table, and of the block looked up.
#[derive(Clone, Copy)]
pub(super) struct Rows {
    pub channels: usize,
    pub axis: usize,
    /// Elements between channels in the block.
    pub pitch: usize,
}

impl Rows {
    /// Elements of a row of the table.
    fn width(self) -> usize {
        row_width(self.channels, self.axis)
    }
}

/// Elements of a row of a table: three channels are padded to four, so that a lookup is one vector load.
pub(super) fn row_width(channels: usize, axis: usize) -> usize {
    match (channels, axis) {
        (3, 1) => PADDED,
        _ => channels * axis,
    }
}

const PADDED: usize = 4;
/// Lanes looked up together.
const GROUP: usize = 16;

/// Brings a whole array into the order of a table.
pub(super) fn interleave<R: Real>(
    whole: &[R],
    channels: usize,
    axis: usize,
    table: &mut Buffer<R>,
) {
    let lanes = whole.len() / (channels * axis).max(1);
    let width = row_width(channels, axis);
    table.ensure(lanes * width);
    let table = table.as_mut_slice();
    for c in 0..channels {
        for lane in 0..lanes {
            let (from, to) = ((c * lanes + lane) * axis, lane * width + c * axis);
            table[to..to + axis].copy_from_slice(&whole[from..from + axis]);
        }
    }
}

/// Adds a table to a whole array, or replaces it.
pub(super) fn deinterleave<R: Real>(
    table: &[R],
    channels: usize,
    axis: usize,
    whole: &mut [R],
    add: bool,
) {
    let lanes = whole.len() / (channels * axis).max(1);
    let width = row_width(channels, axis);
    for c in 0..channels {
        for lane in 0..lanes {
            let (to, from) = ((c * lanes + lane) * axis, lane * width + c * axis);
            for k in 0..axis {
                let x = table[from + k];
                whole[to + k] = if add { whole[to + k] + x } else { x };
            }
        }
    }
}

/// `block[lane] = table[index[lane]]`.
pub(super) fn gather<R: Real>(arch: Arch, table: &[R], rows: Rows, index: &[u32], block: &mut [R]) {
    let Rows {
        channels,
        axis,
        pitch,
    } = rows;
    if axis == 1 {
        let kernel = GatherRows {
            table,
            rows,
            index,
            block,
        };
        return dispatch(arch, kernel);
    }
    for (lane, &i) in index.iter().enumerate() {
        let row = &table[i as usize * rows.width()..];
        for c in 0..channels {
            let start = c * pitch + lane * axis;
            block[start..start + axis].copy_from_slice(&row[c * axis..(c + 1) * axis]);
        }
    }
}

/// `table[index[lane]] += block[lane]`, lanes in order.
pub(super) fn scatter<R: Real>(
    arch: Arch,
    table: &mut [R],
    rows: Rows,
    index: &[u32],
    block: &[R],
) {
    let Rows {
        channels,
        axis,
        pitch,
    } = rows;
    if axis == 1 {
        let kernel = ScatterRows {
            table,
            rows,
            index,
            block,
        };
        return dispatch(arch, kernel);
    }
    for (lane, &i) in index.iter().enumerate() {
        for c in 0..channels {
            let (to, from) = (
                i as usize * rows.width() + c * axis,
                c * pitch + lane * axis,
            );
            let target = &mut table[to..to + axis];
            super::rows::put(arch, target, &block[from..from + axis], true);
        }
    }
}

/// [`gather`] without an axis, to be compiled for every instruction set.
struct GatherRows<'a, R> {
    table: &'a [R],
    rows: Rows,
    index: &'a [u32],
    block: &'a mut [R],
}

impl<R: Real> Kernel for GatherRows<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        gather_rows(self.table, self.rows, self.index, self.block);
    }
}

/// [`gather`] without an axis, within a kernel.
#[inline(always)]
pub(super) fn gather_rows<R: Real>(table: &[R], rows: Rows, index: &[u32], block: &mut [R]) {
    let Rows {
        channels, pitch, ..
    } = rows;
    match channels {
        1 => {
            for (t, &i) in block.iter_mut().zip(index) {
                *t = table[i as usize];
            }
        }
        3 => gather_colors(table, pitch, index, block),
        _ => {
            for (lane, &i) in index.iter().enumerate() {
                let row = &table[i as usize * channels..(i as usize + 1) * channels];
                for (c, x) in row.iter().enumerate() {
                    block[c * pitch + lane] = *x;
                }
            }
        }
    }
}

#[inline(always)]
fn gather_colors<R: Real>(table: &[R], pitch: usize, index: &[u32], block: &mut [R]) {
    let n = index.len();
    let (red, rest) = block.split_at_mut(pitch);
    let (green, blue) = rest.split_at_mut(pitch);
    let (rows, _) = table.as_chunks::<PADDED>();
    let (groups, rest) = index.as_chunks::<GROUP>();
    for (k, group) in groups.iter().enumerate() {
        let mut found = [[R::default(); PADDED]; GROUP];
        for i in 0..GROUP {
            found[i] = rows[group[i] as usize];
        }
        let at = k * GROUP..(k + 1) * GROUP;
        let (red, green) = (&mut red[at.clone()], &mut green[at.clone()]);
        let blue = &mut blue[at];
        for i in 0..GROUP {
            red[i] = found[i][0];
            green[i] = found[i][1];
            blue[i] = found[i][2];
        }
    }
    for (i, &row) in (n - rest.len()..n).zip(rest) {
        [red[i], green[i], blue[i], _] = rows[row as usize];
    }
}

/// [`scatter`] without an axis, to be compiled for every instruction set.
struct ScatterRows<'a, R> {
    table: &'a mut [R],
    rows: Rows,
    index: &'a [u32],
    block: &'a [R],
}

impl<R: Real> Kernel for ScatterRows<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        scatter_rows(self.table, self.rows, self.index, self.block);
    }
}

/// [`scatter`] without an axis, within a kernel.
#[inline(always)]
pub(super) fn scatter_rows<R: Real>(table: &mut [R], rows: Rows, index: &[u32], block: &[R]) {
    let Rows {
        channels, pitch, ..
    } = rows;
    match channels {
        1 => {
            for (s, &i) in block.iter().zip(index) {
                let t = &mut table[i as usize];
                *t = *t + *s;
            }
        }
        3 => scatter_colors(table, pitch, index, block),
        _ => {
            for (lane, &i) in index.iter().enumerate() {
                let row = &mut table[i as usize * channels..(i as usize + 1) * channels];
                for (c, x) in row.iter_mut().enumerate() {
                    *x = *x + block[c * pitch + lane];
                }
            }
        }
    }
}

#[inline(always)]
fn scatter_colors<R: Real>(table: &mut [R], pitch: usize, index: &[u32], block: &[R]) {
    let n = index.len();
    let (red, green) = (&block[..n], &block[pitch..pitch + n]);
    let blue = &block[2 * pitch..2 * pitch + n];
    let (rows, _) = table.as_chunks_mut::<PADDED>();
    for (i, &at) in index.iter().enumerate() {
        let row = &mut rows[at as usize];
        let share = [red[i], green[i], blue[i], R::default()];
        for c in 0..PADDED {
            row[c] = row[c] + share[c];
        }
    }
}

/// An index array and the weights of its rows.
pub(super) type Corner<'a, R> = (&'a [u32], &'a [R]);

/// Corners looked up together by one call; more corners take several.
const CORNERS: usize = 4;

/// `block[lane] (+)= sum_k weight_k[lane] table[index_k[lane]]`.
pub(super) fn gather_weighted<R: Real>(
    arch: Arch,
    table: &[R],
    rows: Rows,
    lanes: usize,
    corners: &[Corner<R>],
    block: &mut [R],
    first: bool,
) {
    for channel in 0..rows.channels {
        let start = channel * rows.pitch;
        let target = &mut block[start..start + lanes * rows.axis];
        let mut add = !first;
        let mut groups = corners.chunks_exact(CORNERS);
        for group in groups.by_ref() {
            let corners: [_; CORNERS] = std::array::from_fn(|k| group[k]);
            let target = &mut *target;
            dispatch(
                arch,
                Interpolate {
                    table,
                    rows,
                    channel,
                    corners,
                    target,
                    add,
                },
            );
            add = true;
        }
        for &corner in groups.remainder() {
            let (corners, target) = ([corner], &mut *target);
            dispatch(
                arch,
                Interpolate {
                    table,
                    rows,
                    channel,
                    corners,
                    target,
                    add,
                },
            );
            add = true;
        }
    }
}

struct Interpolate<'a, R, const N: usize> {
    table: &'a [R],
    rows: Rows,
    channel: usize,
    corners: [Corner<'a, R>; N],
    target: &'a mut [R],
    add: bool,
}

impl<R: Real, const N: usize> Kernel for Interpolate<'_, R, N> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (axis, width) = (self.rows.axis, self.rows.width());
        let offset = self.channel * axis;
        let mut corners = self.corners;
        let lanes = self.target.len() / axis;
        for k in 0..N {
            corners[k] = (&corners[k].0[..lanes], &corners[k].1[..lanes]);
        }
        if axis == 1 {
            for (lane, target) in self.target.iter_mut().enumerate() {
                let mut sum = if self.add { *target } else { R::default() };
                for (index, weight) in corners {
                    let x = self.table[index[lane] as usize * width + offset];
                    sum = weight[lane].mul_add::<S>(x, sum);
                }
                *target = sum;
            }
            return;
        }
        for (lane, target) in self.target.chunks_exact_mut(axis).enumerate() {
            let mut rows = [(&self.table[..0], R::default()); N];
            for k in 0..N {
                let i = corners[k].0[lane] as usize * width + offset;
                rows[k] = (&self.table[i..i + axis], corners[k].1[lane]);
            }
            let (packs, rest) = R::packs_mut::<S>(target);
            let first = axis - rest.len();
            for (j, target) in packs.iter_mut().enumerate() {
                let mut sum = if self.add {
                    *target
                } else {
                    R::splat(simd, R::default())
                };
                for (row, weight) in rows {
                    let row = R::packs::<S>(row).0;
                    sum = R::fma(simd, R::splat(simd, weight), row[j], sum);
                }
                *target = sum;
            }
            for (j, target) in rest.iter_mut().enumerate() {
                let mut sum = if self.add { *target } else { R::default() };
                for (row, weight) in rows {
                    sum = weight.mul_add::<S>(row[first + j], sum);
                }
                *target = sum;
            }
        }
    }
}

/// `table[index_k[lane]] += weight_k[lane] block[lane]`: lanes in order, corners in order within a lane.
pub(super) fn scatter_weighted<R: Real>(
    arch: Arch,
    table: &mut [R],
    rows: Rows,
    lanes: usize,
    corners: &[Corner<R>],
    block: &[R],
) {
    for channel in 0..rows.channels {
        let start = channel * rows.pitch;
        let source = &block[start..start + lanes * rows.axis];
        let table = &mut *table;
        dispatch(
            arch,
            ScatterWeighted {
                table,
                rows,
                channel,
                corners,
                source,
            },
        );
    }
}

struct ScatterWeighted<'a, R> {
    table: &'a mut [R],
    rows: Rows,
    channel: usize,
    corners: &'a [Corner<'a, R>],
    source: &'a [R],
}

impl<R: Real> Kernel for ScatterWeighted<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (axis, width) = (self.rows.axis, self.rows.width());
        let offset = self.channel * axis;
        for (lane, row) in self.source.chunks_exact(axis).enumerate() {
            let (source, source_rest) = R::packs::<S>(row);
            for (index, weight) in self.corners {
                let (i, weight) = (index[lane] as usize * width + offset, weight[lane]);
                let (target, rest) = R::packs_mut::<S>(&mut self.table[i..i + axis]);
                let factor = R::splat(simd, weight);
                for (t, x) in target.iter_mut().zip(source) {
                    *t = R::fma(simd, factor, *x, *t);
                }
                for (t, x) in rest.iter_mut().zip(source_rest) {
                    *t = weight.mul_add::<S>(*x, *t);
                }
            }
        }
    }
}

/// `target[lane] (+)= <table[index[lane]], block[lane]>`: the adjoint of a weight.
pub(super) fn pull_weight<R: Real>(
    table: &[R],
    rows: Rows,
    index: &[u32],
    block: &[R],
    target: &mut [R],
    add: bool,
) {
    for (lane, (&i, target)) in index.iter().zip(target).enumerate() {
        let start = i as usize * rows.width();
        let row = &table[start..start + rows.channels * rows.axis];
        let mut sum = R::default();
        for (c, row) in row.chunks_exact(rows.axis).enumerate() {
            let start = c * rows.pitch + lane * rows.axis;
            for (x, g) in row.iter().zip(&block[start..start + rows.axis]) {
                if !g.is_zero() {
                    sum = sum + *x * *g;
                }
            }
        }
        *target = if add { *target + sum } else { sum };
    }
}
