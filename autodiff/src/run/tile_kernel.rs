//! The loops over the tiles of a block.

use pulp::Simd;

use super::chunk::Span;
use super::list::list;
use super::lookup::{Rows, gather_rows, scatter_rows};
use super::plan::{Adjoints, Values};
use super::rows::{PARTIALS, spread, total, whole_sum};
use super::sizes::{Piece, Pieces, Segments};
use crate::buffer::Buffer;
use crate::op::kernel::Kernel;
use crate::op::tile::{Row, TILE, evaluate, load, pass, store};
use crate::real::Real;

/// What fills rows of a tile.
#[derive(Clone, Copy)]
pub(super) enum Lookup<'a, R> {
    /// The values of parents; as many to a channel as there are parents.
    Parents { all: &'a [R], pitch: usize },
    /// Rows of a table.
    Table { table: &'a [R], index: &'a [u32] },
}

/// A lookup and the rows that it fills.
#[derive(Clone, Copy)]
pub(super) struct Filled<'a, R> {
    pub row: usize,
    pub channels: usize,
    pub lookup: Lookup<'a, R>,
}

/// Where the adjoints of a lookup's rows go.
#[derive(Clone, Copy, Default)]
pub(super) enum Destination<'a> {
    /// To their parents.
    #[default]
    Parents,
    /// To the rows of the chunk's own table.
    Table { index: &'a [u32] },
    /// To what the chunk keeps of `all` lanes, from the `first` on.
    Lanes { all: usize, first: usize },
}

/// The rows of a lookup, on the way back.
#[derive(Clone, Copy, Default)]
pub(super) struct Scattered<'a> {
    pub row: usize,
    pub channels: usize,
    pub into: Destination<'a>,
}

/// A sum over the lanes of rows: which accumulation, and of what.
#[derive(Clone, Copy, Default)]
pub(super) struct Summed {
    pub row: usize,
    pub channels: usize,
    /// Over the lanes of a segment rather than over all.
    pub segments: bool,
    pub mean: bool,
}

/// The adjoint of one channel of a sum.
#[derive(Clone, Copy, Default)]
pub(super) struct Spread<'a, R> {
    pub row: usize,
    pub add: bool,
    /// The parents' adjoints, or the only one.
    pub adjoint: &'a [R],
    /// The parent that the first of them belongs to.
    pub first: usize,
    pub segments: bool,
    pub mean: bool,
}

/// Rows of values.
pub(super) struct Tiles<'a, R> {
    pub rows: &'a mut [R],
    /// Rows of one tile.
    pub count: usize,
    /// Whether every tile has its own rows; else all use the same.
    pub kept: bool,
}

impl<R: Real> Tiles<'_, R> {
    /// The rows of the tile that starts at lane `at`.
    #[inline(always)]
    fn rows(&mut self, at: usize) -> &mut [Row<R>] {
        let (rows, _) = self.rows.as_chunks_mut::<TILE>();
        let first = if self.kept { at / TILE * self.count } else { 0 };
        &mut rows[first..first + self.count]
    }
}

/// What both directions share.
pub(super) struct Block<'a, R> {
    pub len: usize,
    /// First lane of the block, over the whole domain.
    pub start: usize,
    pub segments: &'a Segments,
    /// Whether the run has to know of segments.
    pub by_segments: bool,
    pub span: &'a Span,
    /// What is read, row by row; rows that are not read are empty.
    pub sources: &'a [&'a [R]],
    pub lookups: &'a [Filled<'a, R>],
    pub tiles: Tiles<'a, R>,
}

/// The forward direction of a run.
pub(super) struct Forward<'a, R> {
    pub block: Block<'a, R>,
    pub plan: &'a Values,
    pub targets: &'a mut [Buffer<R>],
    pub sums: &'a [Summed],
    pub accumulations: &'a mut [Buffer<R>],
}

impl<R: Real> Kernel for Forward<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let mut block = self.block;
        list!(found, parts_of(&block), Part::default(), TILE);
        let mut parts = Parts::new(block.segments, block.start, found);
        for at in (0..block.len).step_by(TILE) {
            let len = TILE.min(block.len - at);
            if block.by_segments {
                parts.advance(len);
            }
            let rows = block.tiles.rows(at);
            fill(rows, block.sources, block.lookups, &parts, at, len);
            for instruction in &self.plan.instructions {
                evaluate::<R, S>(instruction, rows);
            }
            for export in &self.plan.exports {
                let start = export.offset + at;
                let target = self.targets[export.array as usize].as_mut_slice();
                store(&mut target[start..start + len], &rows[export.row as usize]);
            }
            for (sum, target) in self.sums.iter().zip(&mut *self.accumulations) {
                let first = block.start + at - block.span.lanes.start;
                let rows = &rows[sum.row..sum.row + sum.channels];
                accumulate(*sum, rows, len, first, &parts, block.span, target);
            }
        }
    }
}

/// The reverse direction of a run: values are computed again in the tile, unless they were kept, then adjoints passed back.
pub(super) struct Reverse<'a, R> {
    pub block: Block<'a, R>,
    pub plan: &'a Adjoints,
    /// As many rows of adjoints as of values.
    pub adjoint_rows: &'a mut [R],
    pub adjoints: &'a [&'a [R]],
    pub spreads: &'a [Spread<'a, R>],
    pub targets: &'a mut [Buffer<R>],
    /// Where adjoints of lookups go, one accumulation each.
    pub scatters: &'a [Scattered<'a>],
    pub pulls: &'a mut [Buffer<R>],
}

impl<R: Real> Kernel for Reverse<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let (mut block, plan) = (self.block, self.plan);
        let (adjoints, _) = self.adjoint_rows.as_chunks_mut::<TILE>();
        list!(found, parts_of(&block), Part::default(), TILE);
        let mut parts = Parts::new(block.segments, block.start, found);
        for at in (0..block.len).step_by(TILE) {
            let len = TILE.min(block.len - at);
            if block.by_segments {
                parts.advance(len);
            }
            let kept = block.tiles.kept;
            let values = block.tiles.rows(at);
            if !kept {
                fill(values, block.sources, block.lookups, &parts, at, len);
                for instruction in &plan.instructions {
                    evaluate::<R, S>(instruction, values);
                }
            }
            for import in &plan.imports {
                let start = import.offset + at;
                let source = &self.adjoints[import.array as usize][start..start + len];
                load(&mut adjoints[import.row as usize], source);
            }
            for add in &plan.adds {
                let start = add.offset + at;
                let source = self.targets[add.array as usize].as_slice();
                load(&mut adjoints[add.row as usize], &source[start..start + len]);
            }
            for spread in self.spreads {
                expand(spread, &mut adjoints[spread.row], &parts);
            }
            for pull in &plan.pulls {
                pass::<R, S>(pull, values, adjoints);
            }
            for export in &plan.exports {
                let start = export.offset + at;
                let target = self.targets[export.array as usize].as_mut_slice();
                store(
                    &mut target[start..start + len],
                    &adjoints[export.row as usize],
                );
            }
            for (scatter, target) in self.scatters.iter().zip(&mut *self.pulls) {
                let rows = &adjoints[scatter.row..scatter.row + scatter.channels];
                match scatter.into {
                    Destination::Parents => {
                        let sum = Summed {
                            row: 0,
                            channels: scatter.channels,
                            segments: true,
                            mean: false,
                        };
                        accumulate(sum, rows, len, 0, &parts, block.span, target);
                    }
                    Destination::Lanes { all, first } => {
                        for (c, row) in rows.iter().enumerate() {
                            let start = c * all + first + at;
                            store(&mut target.as_mut_slice()[start..start + len], row);
                        }
                    }
                    Destination::Table { index } => {
                        let shape = table_rows(scatter.channels);
                        let index = &index[at..at + len];
                        scatter_rows(target.as_mut_slice(), shape, index, rows.as_flattened());
                    }
                }
            }
        }
    }
}

fn table_rows(channels: usize) -> Rows {
    Rows {
        channels,
        axis: 1,
        pitch: TILE,
    }
}

/// The most parts that a tile has.
#[inline(always)]
fn parts_of<R>(block: &Block<R>) -> usize {
    match (block.by_segments, block.segments) {
        (false, _) => 0,
        (true, Segments::Fixed(lanes)) => TILE / lanes.max(&1) + 2,
        (true, Segments::Offsets(_)) => TILE,
    }
}

/// The parts of segments in a tile.
struct Parts<'a> {
    pieces: Pieces<'a>,
    found: &'a mut [Part],
    count: usize,
    first: usize,
}

/// A part of a segment: lanes of the tile, and where they lie in the segment.
#[derive(Clone, Copy, Default)]
struct Part {
    parent: usize,
    start: usize,
    end: usize,
    /// Lanes of the segment before this part.
    phase: usize,
    /// Lanes of the segment.
    len: usize,
}

impl Part {
    /// One over the lanes of the segment.
    #[inline(always)]
    fn share(&self) -> f64 {
        1.0 / self.len as f64
    }

    /// Whether this is all of a tile.
    #[inline(always)]
    fn is_tile(&self) -> bool {
        self.end - self.start == TILE
    }
}

impl<'a> Parts<'a> {
    #[inline(always)]
    fn new(segments: &'a Segments, start: usize, found: &'a mut [Part]) -> Self {
        Parts {
            pieces: segments.pieces(start, 1),
            found,
            count: 0,
            first: start,
        }
    }

    /// Goes on to the next tile, of `len` lanes.
    #[inline(always)]
    fn advance(&mut self, len: usize) {
        self.pieces.advance(len);
        self.count = 0;
        for Piece {
            parent,
            lanes,
            segment,
        } in self.pieces.by_ref()
        {
            self.found[self.count] = Part {
                parent,
                start: lanes.start - self.first,
                end: lanes.end - self.first,
                phase: lanes.start - segment.start,
                len: segment.len(),
            };
            self.count += 1;
        }
        self.first += len;
    }

    #[inline(always)]
    fn all(&self) -> &[Part] {
        &self.found[..self.count]
    }
}

/// Fills the rows that a tile reads.
#[inline(always)]
fn fill<R: Real>(
    rows: &mut [Row<R>],
    sources: &[&[R]],
    lookups: &[Filled<R>],
    parts: &Parts,
    at: usize,
    len: usize,
) {
    for (row, source) in rows.iter_mut().zip(sources) {
        if !source.is_empty() {
            load(row, &source[at..at + len]);
        }
    }
    for filled in lookups {
        let rows = &mut rows[filled.row..filled.row + filled.channels];
        match filled.lookup {
            Lookup::Parents { all, pitch } => {
                for (c, row) in rows.iter_mut().enumerate() {
                    let parents = &all[c * pitch..(c + 1) * pitch];
                    for part in parts.all() {
                        put(row, part, parents[part.parent], false);
                    }
                }
            }
            Lookup::Table { table, index } => {
                let shape = table_rows(filled.channels);
                let index = &index[at..at + len];
                gather_rows(table, shape, index, rows.as_flattened_mut());
            }
        }
    }
}

/// Writes a value to the lanes of a part.
#[inline(always)]
fn put<R: Real>(row: &mut Row<R>, part: &Part, value: R, add: bool) {
    if part.is_tile() {
        for x in row.iter_mut() {
            *x = if add { *x + value } else { value };
        }
    } else {
        for x in &mut row[part.start..part.end] {
            *x = if add { *x + value } else { value };
        }
    }
}

/// The adjoint of a sum over lanes.
#[inline(always)]
fn expand<R: Real>(spread: &Spread<R>, row: &mut Row<R>, parts: &Parts) {
    if !spread.segments {
        let whole = Part {
            end: TILE,
            ..Part::default()
        };
        return put(row, &whole, spread.adjoint[0], spread.add);
    }
    for part in parts.all() {
        let value = spread.adjoint[part.parent - spread.first];
        let value = match spread.mean {
            true => value * R::from_f64(part.share()),
            false => value,
        };
        put(row, part, value, spread.add);
    }
}

/// Adds lanes of rows, one for each channel, to running sums. `target` holds a sum for each parent of the chunk and channel, if
/// by segments, then open partial sums for each channel; `first` is the position of the tile in the chunk.
#[inline(always)]
fn accumulate<R: Real>(
    sum: Summed,
    rows: &[Row<R>],
    len: usize,
    first: usize,
    parts: &Parts,
    span: &Span,
    target: &mut Buffer<R>,
) {
    let parents = if sum.segments { span.parents.len() } else { 0 };
    let (sums, partials) = target.as_mut_slice().split_at_mut(sum.channels * parents);
    if !sum.segments {
        for (row, partial) in rows.iter().zip(partials.chunks_exact_mut(PARTIALS)) {
            spread(partial, first, &row[..len]);
        }
        return;
    }
    for part in parts.all() {
        let mean = sum.mean.then(|| R::from_f64(part.share()));
        let at = part.parent - span.parents.start;
        if part.len == TILE && part.is_tile() {
            // The tile is a segment: loops of known length, and sums that stay in registers.
            for (c, row) in rows.iter().enumerate() {
                add_total(&mut sums[c * parents + at], whole_sum(row), mean);
            }
            continue;
        }
        for (c, row) in rows.iter().enumerate() {
            let lanes = &row[part.start..part.end];
            let total = if lanes.len() == part.len {
                // The whole segment: its sum stays in registers.
                whole_sum(lanes)
            } else {
                let partial = &mut partials[c * PARTIALS..(c + 1) * PARTIALS];
                if part.phase == 0 {
                    partial.fill(R::default());
                }
                spread(partial, part.phase, lanes);
                if part.phase + lanes.len() < part.len {
                    continue;
                }
                total(partial)
            };
            add_total(&mut sums[c * parents + at], total, mean);
        }
    }
}

/// Adds the sum of a segment, times its `mean` if that is wanted.
#[inline(always)]
fn add_total<R: Real>(target: &mut R, total: R, mean: Option<R>) {
    *target = *target
        + match mean {
            Some(mean) => total * mean,
            None => total,
        };
}
