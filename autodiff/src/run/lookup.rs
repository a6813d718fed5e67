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
    pub fn width(self) -> usize {
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
const GROUP: usize = 64;

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

/// Rows first, side by side, then one channel after another: that way both loops are of vectors.
#[inline(always)]
fn gather_colors<R: Real>(table: &[R], pitch: usize, index: &[u32], block: &mut [R]) {
    let (red, rest) = block.split_at_mut(pitch);
    let (green, blue) = rest.split_at_mut(pitch);
    let (rows, _) = table.as_chunks::<PADDED>();
    let (groups, rest) = index.as_chunks::<GROUP>();
    let whole = groups.len() * GROUP;
    let mut found = [[R::default(); PADDED]; GROUP];
    for (k, group) in groups.iter().enumerate() {
        for (row, &i) in found.iter_mut().zip(group) {
            *row = rows[i as usize];
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
    for (i, &at) in (whole..).zip(rest) {
        let row = rows[at as usize];
        (red[i], green[i], blue[i]) = (row[0], row[1], row[2]);
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

/// Shares side by side first, which is a loop of vectors, then one row after another.
#[inline(always)]
fn scatter_colors<R: Real>(table: &mut [R], pitch: usize, index: &[u32], block: &[R]) {
    let n = index.len();
    let (red, green) = (&block[..n], &block[pitch..pitch + n]);
    let blue = &block[2 * pitch..2 * pitch + n];
    let (rows, _) = table.as_chunks_mut::<PADDED>();
    let (groups, rest) = index.as_chunks::<GROUP>();
    let whole = groups.len() * GROUP;
    let mut shares = [[R::default(); PADDED]; GROUP];
    for (k, group) in groups.iter().enumerate() {
        let at = k * GROUP..(k + 1) * GROUP;
        let (red, green) = (&red[at.clone()], &green[at.clone()]);
        let blue = &blue[at];
        for i in 0..GROUP {
            shares[i] = [red[i], green[i], blue[i], R::default()];
        }
        for (share, &i) in shares.iter().zip(group) {
            add_share(&mut rows[i as usize], share);
        }
    }
    for (i, &at) in (whole..).zip(rest) {
        let share = [red[i], green[i], blue[i], R::default()];
        add_share(&mut rows[at as usize], &share);
    }
}

#[inline(always)]
fn add_share<R: Real>(row: &mut [R; PADDED], share: &[R; PADDED]) {
    for c in 0..PADDED {
        row[c] = row[c] + share[c];
    }
}
