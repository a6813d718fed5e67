//! Executes the runs of a block.

use std::mem::take;
use std::ops::Range;

use super::block::{Env, Lanes, Lent, Place, Worker};
use super::chunk::{Chunk, Span};
use super::lane::Lane;
use super::list::list;
use super::passes::sink_position;
use super::plan::{LookupAdjoint, Values};
use super::segments::segments_of;
use super::sizes::Extent;
use super::tile_kernel::{
    Block, Destination, Filled, Forward, Lookup, Reverse, Scattered, Spread, Summed, Tiles,
};
use super::value::values;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::op::kernel::dispatch;
use crate::op::tile::TILE;
use crate::program::{LIMIT, Phase, Program, Run};

/// Elements of the tile of a thread: values, and as many adjoints.
pub(super) fn tile_len(phase: &Phase) -> usize {
    let rows = phase.runs.iter().map(Run::rows).max().unwrap_or(0);
    2 * rows * TILE
}

/// Elements of all rows of all tiles of a block of `stride` lanes.
pub(super) fn kept_len(program: &Program, extent: &Extent, phase: &Phase, stride: usize) -> usize {
    let axis = |run: &Run| extent.axis(program.nodes[run.nodes[0]].shape.axis);
    let lens = phase.runs.iter();
    lens.map(|run| run_len(run, stride * axis(run))).sum()
}

/// Elements of the rows of as many tiles as `len` elements need.
fn run_len(run: &Run, len: usize) -> usize {
    run.rows() * len.next_multiple_of(TILE)
}

/// Where the rows of a run are kept.
fn kept<R: Lane>(env: &Env<R>, at: usize) -> Range<usize> {
    let len = |run: &Run| run_len(run, env.stride * env.axis(run.nodes[0]));
    let start = env.phase.runs[..at].iter().map(len).sum();
    start..start + len(&env.phase.runs[at])
}

/// Adjoints of sums that are not whole yet, in the arena of the phase that reads them.
pub(super) struct Known<'a, R> {
    pub adjoints: &'a [Buffer<R>],
    pub places: &'a [Place],
    pub sums: &'a [NodeId],
    /// The first parent that they are there for.
    pub first: usize,
}

impl<'a, R: Lane> Known<'a, R> {
    /// There are no such sums.
    pub fn nothing() -> Self {
        Known {
            adjoints: &[],
            places: &[],
            sums: &[],
            first: 0,
        }
    }

    /// The adjoints of one channel of a sum.
    fn channel(&self, sum: NodeId, channel: usize) -> Option<&'a [R]> {
        self.sums.contains(&sum).then(|| {
            let place = self.places[sum];
            let all = self.adjoints[place.slot as usize].as_slice();
            &all[channel * place.pitch..(channel + 1) * place.pitch]
        })
    }
}

/// Computes values of a run and accumulates its sums in the chunk; `keep`s its rows.
pub(super) fn forward<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    at: usize,
    keep: bool,
) {
    let sinks = &env.phase.runs[at].sinks;
    let positions = || sinks.iter().map(|&sink| sink_position(env, sink));
    let mut accumulations = take(&mut worker.lent.chunk);
    lend(&mut accumulations, positions(), &mut chunk.sink);
    let plan = &env.plans[at].forward;
    let into = Some((&chunk.span, &mut accumulations[..]));
    compute(env, worker, lanes, at, plan, into, keep);
    give_back(&mut accumulations, positions(), &mut chunk.sink);
    worker.lent.chunk = accumulations;
}

/// Computes again what the reverse pass reads outside of a run.
pub(super) fn replay<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, at: usize) {
    let plan = &env.plans[at].replay;
    compute(env, worker, lanes, at, plan, None, false);
}

fn compute<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    at: usize,
    plan: &Values,
    into: Option<(&Span, &mut [Buffer<R>])>,
    keep: bool,
) {
    if plan.instructions.is_empty() {
        return;
    }
    let run = &env.phase.runs[at];
    let mut targets = take(&mut worker.lent.arena);
    let slots = || plan.targets.iter().copied();
    lend(&mut targets, slots(), &mut worker.values);
    let mut storage = match keep {
        true => take(&mut worker.kept),
        false => take(&mut worker.tile),
    };
    let rows = match keep {
        true => kept(env, at),
        false => 0..run_len(run, TILE),
    };
    let nothing = Span {
        lanes: 0..0,
        parents: 0..0,
    };
    let (span, accumulations) = into.unwrap_or((&nothing, &mut []));
    let summed = &run.sinks[..accumulations.len().min(run.sinks.len())];
    list!(sums, summed.len(), Summed::default(), LIMIT);
    for (sum, &sink) in sums.iter_mut().zip(summed) {
        *sum = summed_rows(env, run, sink);
    }
    list!(sources, run.externals.len(), &[][..], LIMIT);
    list!(lookups, run.lookups.len(), no_lookup(), LIMIT);
    let block = block(
        (env, worker, lanes, run),
        &plan.reads,
        span,
        sources,
        lookups,
        Tiles {
            rows: &mut storage.as_mut_slice()[rows],
            count: run.rows(),
            kept: keep,
        },
    );
    let kernel = Forward {
        block,
        plan,
        targets: &mut targets,
        sums: &sums[..summed.len()],
        accumulations,
    };
    dispatch(env.arch, kernel);
    match keep {
        true => worker.kept = storage,
        false => worker.tile = storage,
    }
    give_back(&mut targets, slots(), &mut worker.values);
    worker.lent.arena = targets;
}

/// Passes the adjoints of a run back. Its values are computed again, unless there are `known` adjoints: then they were kept.
pub(super) fn reverse<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    at: usize,
    known: Option<&Known<R>>,
) {
    let (run, plan) = (&env.phase.runs[at], &env.plans[at].adjoints);
    if plan.pulls.is_empty() {
        return;
    }
    let Lent {
        arena: mut targets,
        chunk: mut pulls,
    } = take(&mut worker.lent);
    let slots = || plan.targets.iter().copied();
    lend(&mut targets, slots(), &mut worker.adjoints);
    let positions = || plan.lookups.iter().map(|lookup| lookup.pull);
    lend(&mut pulls, positions(), &mut chunk.pull);
    let (mut tile, mut storage) = (take(&mut worker.tile), take(&mut worker.kept));
    let (again, adjoint_rows) = tile.as_mut_slice().split_at_mut(run_len(run, TILE));
    let rows = match known {
        Some(_) => &mut storage.as_mut_slice()[kept(env, at)],
        None => again,
    };
    list!(adjoints, plan.sources.len(), &[][..], LIMIT);
    for (adjoint, &slot) in adjoints.iter_mut().zip(&plan.sources) {
        debug_assert!(worker.written[slot]);
        *adjoint = worker.adjoints[slot].as_slice();
    }
    list!(spreads, plan.sums.len(), Spread::default(), LIMIT);
    for (spread, sum) in spreads.iter_mut().zip(&plan.sums) {
        let all = env.all_lanes(sum.sink);
        let summed = summed_rows(env, run, sum.sink);
        let early = known.and_then(|known| known.channel(sum.sink, sum.channel));
        let whole = || {
            let whole = env.adjoints[sum.sink].as_slice();
            &whole[sum.channel * all..(sum.channel + 1) * all]
        };
        *spread = Spread {
            row: sum.row,
            add: sum.add,
            adjoint: early.unwrap_or_else(whole),
            first: known
                .filter(|_| early.is_some())
                .map_or(0, |known| known.first),
            segments: summed.segments,
            mean: summed.mean,
        };
    }
    list!(scatters, plan.lookups.len(), Scattered::default(), LIMIT);
    for (scatter, lookup) in scatters.iter_mut().zip(&plan.lookups) {
        *scatter = scattered(env, &chunk.span, lanes, lookup);
    }
    list!(sources, run.externals.len(), &[][..], LIMIT);
    list!(lookups, run.lookups.len(), no_lookup(), LIMIT);
    let block = block(
        (env, worker, lanes, run),
        &plan.reads,
        &chunk.span,
        sources,
        lookups,
        Tiles {
            rows,
            count: run.rows(),
            kept: known.is_some(),
        },
    );
    let kernel = Reverse {
        block,
        plan,
        adjoint_rows: &mut adjoint_rows[..run_len(run, TILE)],
        adjoints,
        spreads: &spreads[..plan.sums.len()],
        targets: &mut targets,
        scatters: &scatters[..plan.lookups.len()],
        pulls: &mut pulls,
    };
    dispatch(env.arch, kernel);
    (worker.tile, worker.kept) = (tile, storage);
    give_back(&mut pulls, positions(), &mut chunk.pull);
    for &slot in &plan.targets {
        worker.written[slot] = true;
    }
    give_back(&mut targets, slots(), &mut worker.adjoints);
    worker.lent = Lent {
        arena: targets,
        chunk: pulls,
    };
}

/// Fills unused places of a list.
fn no_lookup<'a, R>() -> Filled<'a, R> {
    Filled {
        row: 0,
        channels: 0,
        lookup: Lookup::Parents { all: &[], pitch: 0 },
    }
}

/// What a run reads on a block.
fn block<'a, R: Lane>(
    (env, worker, lanes, run): (&'a Env<'a, R>, &'a Worker<R>, Lanes, &Run),
    reads: &[bool],
    span: &'a Span,
    sources: &'a mut [&'a [R]],
    lookups: &'a mut [Filled<'a, R>],
    tiles: Tiles<'a, R>,
) -> Block<'a, R> {
    let view = values(env, worker);
    let is_lookup = |id: NodeId| run.lookups.iter().any(|&(lookup, _)| lookup == id);
    for (i, &(id, channel)) in run.externals.iter().enumerate() {
        if reads[i] && !is_lookup(id) {
            sources[i] = env.channel(view, lanes, id, channel);
        }
    }
    let mut count = 0;
    for &(id, row) in &run.lookups {
        let channels = env.channels(id);
        if reads[row..row + channels].iter().any(|&read| read) {
            lookups[count] = filled(env, worker, lanes, id, row);
            count += 1;
        }
    }
    let by_segments =
        |id: NodeId| matches!(env.program.nodes[id].op, Op::Expand | Op::SegmentSum { .. });
    Block {
        len: lanes.len * env.axis(run.nodes[0]),
        start: lanes.start,
        segments: segments_of(env),
        by_segments: run.lookups.iter().any(|lookup| by_segments(lookup.0))
            || run.sinks.iter().any(|&sink| by_segments(sink)),
        span,
        sources: &sources[..run.externals.len()],
        lookups: &lookups[..count],
        tiles,
    }
}

/// A lookup of a run on a block.
fn filled<'a, R: Lane>(
    env: &'a Env<'a, R>,
    worker: &'a Worker<R>,
    lanes: Lanes,
    id: NodeId,
    row: usize,
) -> Filled<'a, R> {
    let node = &env.program.nodes[id];
    let view = values(env, worker);
    let input = node.inputs[0];
    let lookup = match node.op {
        Op::Gather(index) => Lookup::Table {
            table: view.table(env, input),
            index: &env.indices[index][lanes.start..lanes.start + lanes.len],
        },
        _ => Lookup::Parents {
            all: view.whole[input].as_slice(),
            pitch: env.all_lanes(input),
        },
    };
    Filled {
        row,
        channels: node.shape.channels,
        lookup,
    }
}

/// Where the adjoints of a lookup's rows go.
fn scattered<'a, R: Lane>(
    env: &'a Env<'a, R>,
    span: &Span,
    lanes: Lanes,
    lookup: &LookupAdjoint,
) -> Scattered<'a> {
    let node = &env.program.nodes[lookup.id];
    let into = match (&node.op, env.bucketings[lookup.pull]) {
        (Op::Gather(_), Some(_)) => Destination::Lanes {
            all: span.lanes.len(),
            first: lanes.start - span.lanes.start,
        },
        (Op::Gather(index), None) => Destination::Table {
            index: &env.indices[*index][lanes.start..lanes.start + lanes.len],
        },
        _ => Destination::Parents,
    };
    Scattered {
        row: lookup.row,
        channels: node.shape.channels,
        into,
    }
}

/// The rows that a sum over lanes adds up.
fn summed_rows<R>(env: &Env<R>, run: &Run, sink: NodeId) -> Summed {
    let node = &env.program.nodes[sink];
    Summed {
        row: run.row(node.inputs[0], 0).unwrap_or(0),
        channels: node.shape.channels,
        segments: matches!(node.op, Op::SegmentSum { .. }),
        mean: matches!(node.op, Op::SegmentSum { mean: true }),
    }
}

/// Moves buffers out of an arena, to be written to while the others are read.
fn lend<R: Lane>(
    lent: &mut Vec<Buffer<R>>,
    slots: impl Iterator<Item = usize>,
    arena: &mut [Buffer<R>],
) {
    lent.clear();
    lent.extend(slots.map(|slot| take(&mut arena[slot])));
}

fn give_back<R: Lane>(
    lent: &mut Vec<Buffer<R>>,
    slots: impl Iterator<Item = usize>,
    arena: &mut [Buffer<R>],
) {
    for (buffer, slot) in lent.drain(..).zip(slots) {
        arena[slot] = buffer;
    }
}
