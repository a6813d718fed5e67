//! Chunks: the fixed division of a phase's lanes that work is shared by.

use std::ops::Range;

use super::bucketing::Bucketing;
use super::lookup::row_width;
use super::rows::PARTIALS;
use super::sizes::Extent;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::program::{Phase, Program, Pull, PullKind};
use crate::real::Real;

/// Elements below which a chunk is not worth sharing.
const SMALLEST: usize = 4096;
/// Products of a matrix and a lane that take as long as the other operations on an element.
const PRODUCTS: usize = 64;
/// Mean lanes of a chunk below which its private copies of the adjoints of matrices take longer than its products.
const FEWEST: usize = 128;
/// Chunks of a phase with private copies: of the adjoints of small tables, or of matrices.
pub(super) const SCATTERING: usize = 16;
/// Chunks of other phases.
const PLAIN: usize = 64;

/// The lanes of one chunk. Boundaries depend on the sizes alone, and never cut a segment.
#[derive(Clone, Debug, Default)]
pub(super) struct Span {
    pub lanes: Range<usize>,
    pub parents: Range<usize>,
}

/// Divides the lanes of a phase.
pub(super) fn spans(program: &Program, extent: &Extent, phase: &Phase) -> Vec<Span> {
    let (lanes, count) = (extent.lanes[phase.domain], chunks(program, extent, phase));
    let mut spans = Vec::with_capacity(count);
    let mut start = Span {
        lanes: 0..0,
        parents: 0..0,
    };
    let parents = program.domains[phase.domain]
        .parent
        .map_or(0, |parent| extent.lanes[parent]);
    for i in 1..=count {
        let target = end(lanes, i, count);
        let (lane, parent) = match &extent.segments[phase.domain] {
            _ if i == count => (lanes, parents),
            None => (target, 0),
            Some(segments) if target < lanes => {
                let parent = segments.parent(target);
                (segments.bounds(parent).0, parent)
            }
            Some(_) => (lanes, parents),
        };
        let span = Span {
            lanes: start.lanes.end..lane,
            parents: start.parents.end..parent,
        };
        start = span.clone();
        spans.push(span);
    }
    spans
}

/// How many chunks a phase has.
pub(super) fn chunks(program: &Program, extent: &Extent, phase: &Phase) -> usize {
    let lanes = extent.lanes[phase.domain];
    let has = |kind: PullKind| phase.pulls.iter().any(|pull| pull.kind == kind);
    let most = match (has(PullKind::Weight), has(PullKind::Table)) {
        (true, _) => SCATTERING.min(lanes / FEWEST),
        (_, true) => SCATTERING,
        _ => PLAIN,
    };
    let products = phase.nodes.iter().map(|&id| products(program, id));
    let weight = products.fold(0, usize::saturating_add) / PRODUCTS;
    let weight = weight.saturating_add(widest(program, extent, phase));
    (lanes.saturating_mul(weight) / SMALLEST).clamp(1, most.max(1))
}

/// Products of a matrix and a lane that a node takes.
fn products(program: &Program, id: NodeId) -> usize {
    let node = &program.nodes[id];
    let channels = |id: NodeId| program.nodes[id].shape.channels;
    match node.op {
        Op::Matmul => channels(id).saturating_mul(channels(node.inputs[0])),
        _ => 0,
    }
}

/// Where the `i`-th of `count` chunks ends, counted from one. Chunks shrink from 8/5 of the mean to 2/5 of it: threads that
/// take them in turn then end at nearly the same time, however fast each of them is.
fn end(lanes: usize, i: usize, count: usize) -> usize {
    let (i, count) = (i as u128, count as u128);
    // The k-th chunk weighs 8 count - 6 k + 3, which is 5 count on average.
    let (before, all) = (i * (8 * count - 3 * i), 5 * count * count);
    (lanes as u128 * before / all) as usize
}

/// Longest inner axis in a phase.
pub(super) fn widest(program: &Program, extent: &Extent, phase: &Phase) -> usize {
    let axis = |id: &NodeId| extent.axis(program.nodes[*id].shape.axis);
    let widest = phase.locals.iter().map(axis).max();
    widest.unwrap_or(1).max(1)
}

/// Private results of one chunk, gathered into whole arrays after the phase.
#[derive(Debug, Default)]
pub(super) struct Chunk<R> {
    pub span: Span,
    pub store: Vec<Buffer<R>>,
    pub store_tangent: Vec<Buffer<R>>,
    pub sink: Vec<Buffer<R>>,
    pub sink_tangent: Vec<Buffer<R>>,
    pub pull: Vec<Buffer<R>>,
    /// Lanes in the order of the rows that they go to, for pulls of large tables; empty for others.
    pub sorted: Vec<Vec<u32>>,
}

impl<R: Real> Chunk<R> {
    pub fn bytes(&self) -> usize {
        let buffers = [
            &self.store,
            &self.store_tangent,
            &self.sink,
            &self.sink_tangent,
            &self.pull,
        ];
        let sorted = self.sorted.iter().map(|sorted| size_of_val(&sorted[..]));
        buffers
            .into_iter()
            .flatten()
            .map(Buffer::bytes)
            .sum::<usize>()
            + sorted.sum::<usize>()
    }
}

/// Elements that a chunk keeps of a stored node.
pub(super) fn store_len(program: &Program, extent: &Extent, span: &Span, id: NodeId) -> usize {
    let shape = program.nodes[id].shape;
    shape.channels * span.lanes.len() * extent.axis(shape.axis)
}

/// Elements that a chunk keeps of a sink: its parents' totals, and the open partial sums.
pub(super) fn sink_len(program: &Program, extent: &Extent, span: &Span, id: NodeId) -> usize {
    let node = &program.nodes[id];
    let (channels, axis) = (node.shape.channels, extent.axis(node.shape.axis));
    let partial = channels * if axis == 1 { PARTIALS } else { 0 };
    match node.op {
        Op::SumLanes if axis == 1 => partial,
        Op::SumLanes => channels * axis,
        _ => channels * span.parents.len() * axis + partial,
    }
}

/// Elements that a chunk keeps of an adjoint.
pub(super) fn pull_len(
    program: &Program,
    extent: &Extent,
    span: &Span,
    pull: &Pull,
    bucketing: Option<Bucketing>,
) -> usize {
    let shape = program.nodes[pull.target].shape;
    let (channels, axis) = (shape.channels, extent.axis(shape.axis));
    let partial = channels * if axis == 1 { PARTIALS } else { 0 };
    match (pull.kind, bucketing) {
        (PullKind::Lanes, _) => channels * span.lanes.len() * axis,
        (PullKind::Parents, _) => channels * span.parents.len() * axis + partial,
        (PullKind::Table, Some(bucketing)) => bucketing.kept_len(span.lanes.len()),
        (PullKind::Table, None) => row_width(channels, axis) * extent.lanes[shape.domain],
        (PullKind::Uniform, _) if axis == 1 => partial,
        (PullKind::Uniform, _) => channels * axis,
        (PullKind::Weight, _) => channels,
    }
}

/// How many numbers sort the lanes of a chunk for an adjoint.
pub(super) fn sorted_len(span: &Span, bucketing: Option<Bucketing>) -> usize {
    bucketing.map_or(0, |bucketing| bucketing.sorted_len(span.lanes.len()))
}

/// Makes `buffers` hold one array of each length.
pub(super) fn ensure<R: Real>(
    buffers: &mut Vec<Buffer<R>>,
    lengths: impl ExactSizeIterator<Item = usize>,
) {
    buffers.resize_with(lengths.len(), || Buffer::zeros(0));
    for (buffer, len) in buffers.iter_mut().zip(lengths) {
        buffer.ensure(len);
    }
}
