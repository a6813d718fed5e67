//! Expansion to segments and sums over them: each other's adjoint.
//!
//! A segment's sum runs over its lanes in order, so that it does not depend on where blocks end. Single elements are spread
//! over partial sums by their position in the segment; the open ones stay with the chunk between blocks.

use super::block::{Env, Lanes};
use super::chunk::Span;
use super::rows::{PARTIALS, add_partials, put, put_value, total};
use super::sizes::{Piece, Segments};
use crate::real::Real;

/// The segments of the phase's domain. Recording made sure that there are some.
pub(super) fn segments_of<'a, R>(env: &Env<'a, R>) -> &'a Segments {
    const NONE: &Segments = &Segments::Fixed(1);
    env.extent.segments[env.phase.domain]
        .as_ref()
        .unwrap_or(NONE)
}

/// The parts of segments in a block.
pub(super) fn pieces<'a, R>(
    env: &Env<'a, R>,
    lanes: Lanes,
) -> impl Iterator<Item = Piece> + use<'a, R> {
    segments_of(env).pieces(lanes.start, lanes.len)
}

/// Writes each parent's row to all its lanes, or adds it; `factor` is given the length of the segment.
pub(super) fn expand<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    axis: usize,
    parents: &[R],
    first_parent: usize,
    target: &mut [R],
    mean: bool,
    add: bool,
) {
    for piece in pieces(env, lanes) {
        let p = piece.parent - first_parent;
        let row = &parents[p * axis..(p + 1) * axis];
        let (start, end) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let target = &mut target[start * axis..end * axis];
        let factor = R::from_f64(1.0 / piece.segment.len() as f64);
        if axis == 1 {
            let value = if mean { row[0] * factor } else { row[0] };
            put_value(target, value, add);
        } else if mean {
            for lane in target.chunks_exact_mut(axis) {
                for (t, x) in lane.iter_mut().zip(row) {
                    *t = if add { *t + *x * factor } else { *x * factor };
                }
            }
        } else {
            for lane in target.chunks_exact_mut(axis) {
                put(env.arch, lane, row, add);
            }
        }
    }
}

/// Adds one channel of a block to the sums of its segments. `sums` holds `[channel][parent of the chunk][axis]`, then
/// [`PARTIALS`] open partial sums for each channel.
pub(super) fn collect<R: Real>(
    env: &Env<R>,
    span: &Span,
    lanes: Lanes,
    (channel, channels): (usize, usize),
    axis: usize,
    source: &[R],
    sums: &mut [R],
    mean: bool,
) {
    let parents = span.parents.len();
    let (sums, partials) = sums.split_at_mut(channels * parents * axis);
    for piece in pieces(env, lanes) {
        let p = channel * parents + piece.parent - span.parents.start;
        let (start, end) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let source = &source[start * axis..end * axis];
        let ends = piece.lanes.end == piece.segment.end;
        let factor = R::from_f64(1.0 / piece.segment.len() as f64);
        if axis == 1 {
            let partial = &mut partials[channel * PARTIALS..(channel + 1) * PARTIALS];
            let phase = piece.lanes.start - piece.segment.start;
            if phase == 0 {
                partial.fill(R::default());
            }
            add_partials(env.arch, partial, phase, source);
            if ends {
                let sum = total(partial);
                // A parent is complete once: adding would double nothing, but several uses of an expansion add up.
                sums[p] = sums[p] + if mean { sum * factor } else { sum };
            }
        } else {
            let row = &mut sums[p * axis..(p + 1) * axis];
            for lane in source.chunks_exact(axis) {
                put(env.arch, row, lane, true);
            }
            if ends && mean {
                row.iter_mut().for_each(|x| *x = *x * factor);
            }
        }
    }
}
