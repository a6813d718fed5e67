//! Expansion to segments and sums over them: each other's adjoint.
//!
//! A segment's sum runs over its lanes in order, so that it does not depend on where blocks end. Single elements are spread
//! over partial sums by their position in the segment; the open ones stay with the chunk between blocks.

use pulp::Simd;

use super::block::{Env, Lanes};
use super::chunk::Span;
use super::rows::{PARTIALS, put, put_value, spread, total};
use super::sizes::{Piece, Segments};
use crate::op::kernel::{Kernel, dispatch};
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
    if axis == 1 {
        let kernel = ExpandLanes {
            segments: segments_of(env),
            lanes,
            parents,
            first_parent,
            target,
            mean,
            add,
        };
        return dispatch(env.arch, kernel);
    }
    for piece in pieces(env, lanes) {
        let p = piece.parent - first_parent;
        let row = &parents[p * axis..(p + 1) * axis];
        let (start, end) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let target = &mut target[start * axis..end * axis];
        let factor = R::from_f64(1.0 / piece.segment.len() as f64);
        if mean {
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
    if axis == 1 {
        let kernel = CollectLanes {
            segments: segments_of(env),
            lanes,
            first_parent: span.parents.start,
            source,
            sums: &mut sums[channel * parents..(channel + 1) * parents],
            partial: &mut partials[channel * PARTIALS..(channel + 1) * PARTIALS],
            mean,
        };
        return dispatch(env.arch, kernel);
    }
    for piece in pieces(env, lanes) {
        let p = channel * parents + piece.parent - span.parents.start;
        let (start, end) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let row = &mut sums[p * axis..(p + 1) * axis];
        for lane in source[start * axis..end * axis].chunks_exact(axis) {
            put(env.arch, row, lane, true);
        }
        if piece.lanes.end == piece.segment.end && mean {
            let factor = R::from_f64(1.0 / piece.segment.len() as f64);
            row.iter_mut().for_each(|x| *x = *x * factor);
        }
    }
}

/// [`expand`] of single elements.
struct ExpandLanes<'a, R> {
    segments: &'a Segments,
    lanes: Lanes,
    parents: &'a [R],
    first_parent: usize,
    target: &'a mut [R],
    mean: bool,
    add: bool,
}

impl<R: Real> Kernel for ExpandLanes<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for piece in self.segments.pieces(self.lanes.start, self.lanes.len) {
            let value = self.parents[piece.parent - self.first_parent];
            let first = piece.lanes.start - self.lanes.start;
            let target = &mut self.target[first..first + piece.lanes.len()];
            let value = match self.mean {
                true => value * R::from_f64(1.0 / piece.segment.len() as f64),
                false => value,
            };
            put_value(target, value, self.add);
        }
    }
}

/// [`collect`] of single elements.
struct CollectLanes<'a, R> {
    segments: &'a Segments,
    lanes: Lanes,
    first_parent: usize,
    source: &'a [R],
    sums: &'a mut [R],
    partial: &'a mut [R],
    mean: bool,
}

impl<R: Real> Kernel for CollectLanes<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for piece in self.segments.pieces(self.lanes.start, self.lanes.len) {
            let first = piece.lanes.start - self.lanes.start;
            let source = &self.source[first..first + piece.lanes.len()];
            let phase = piece.lanes.start - piece.segment.start;
            if phase == 0 {
                self.partial.fill(R::default());
            }
            spread(self.partial, phase, source);
            if piece.lanes.end == piece.segment.end {
                let sum = total(self.partial);
                let mean = R::from_f64(1.0 / piece.segment.len() as f64);
                // A parent is complete once: adding would double nothing, but several uses of an expansion add up.
                let target = &mut self.sums[piece.parent - self.first_parent];
                *target = *target + if self.mean { sum * mean } else { sum };
            }
        }
    }
}
