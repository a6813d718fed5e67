//! Executes the runs of a block.

use std::mem::take;

use super::block::{Env, Lanes, Worker};
use super::chunk::{Chunk, Span};
use super::lane::Lane;
use super::passes::sink_position;
use super::plan::Values;
use super::segments::segments_of;
use super::tile_kernel::{Block, Filled, Forward, Lookup, Reverse, Spread, Summed};
use super::value::values;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::op::kernel::dispatch;
use crate::op::tile::TILE;
use crate::program::{LIMIT, Phase, Run};

/// Elements of the tile of a thread: values, and as many adjoints.
pub(super) fn tile_len(phase: &Phase) -> usize {
    let rows = phase.runs.iter().map(Run::rows).max().unwrap_or(0);
    2 * rows * TILE
}

/// Computes values of a run; accumulates its sums in the chunk, if given.
pub(super) fn forward<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: Option<&mut Chunk<R>>,
    lanes: Lanes,
    run: &Run,
    plan: &Values,
) {
    if plan.instructions.is_empty() {
        return;
    }
    let mut targets = take_all(plan.targets.iter().copied(), &mut worker.values);
    let mut tile = take(&mut worker.tile);
    let mut sums = [Summed::default(); LIMIT];
    let summed = if plan.sums { &run.sinks[..] } else { &[] };
    for (sum, &sink) in sums.iter_mut().zip(summed) {
        *sum = summed_rows(env, run, sink);
    }
    let nothing = Span {
        lanes: 0..0,
        parents: 0..0,
    };
    let positions = || summed.iter().map(|&sink| sink_position(env, sink));
    let (mut accumulations, span, sink) = match chunk {
        Some(chunk) => (
            take_all(positions(), &mut chunk.sink),
            &chunk.span,
            Some(&mut chunk.sink),
        ),
        None => (empty(), &nothing, None),
    };
    let mut sources: [&[R]; LIMIT] = [&[]; LIMIT];
    let mut lookups = [no_lookup(); LIMIT];
    let block = block(
        (env, worker, lanes, run),
        &plan.reads,
        span,
        &mut sources,
        &mut lookups,
        tile.as_mut_slice(),
    );
    let kernel = Forward {
        block,
        plan,
        targets: &mut targets,
        sums: &sums[..summed.len()],
        accumulations: &mut accumulations,
    };
    dispatch(env.arch, kernel);
    if let Some(sink) = sink {
        put_back(accumulations, positions(), sink);
    }
    worker.tile = tile;
    put_back(targets, plan.targets.iter().copied(), &mut worker.values);
}

/// Passes the adjoints of a run back.
pub(super) fn reverse<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    at: usize,
) {
    let (run, plan) = (&env.phase.runs[at], &env.plans[at].adjoints);
    if plan.pulls.is_empty() {
        return;
    }
    let mut targets = take_all(plan.targets.iter().copied(), &mut worker.adjoints);
    let positions = || plan.lookups.iter().map(|lookup| lookup.pull);
    let mut pulls = take_all(positions(), &mut chunk.pull);
    let mut tile = take(&mut worker.tile);
    let mut adjoints: [&[R]; LIMIT] = [&[]; LIMIT];
    for (adjoint, &slot) in adjoints.iter_mut().zip(&plan.sources) {
        debug_assert!(worker.written[slot]);
        *adjoint = worker.adjoints[slot].as_slice();
    }
    let mut spreads = [Spread::default(); LIMIT];
    for (spread, sum) in spreads.iter_mut().zip(&plan.sums) {
        let all = env.all_lanes(sum.sink);
        let summed = summed_rows(env, run, sum.sink);
        *spread = Spread {
            row: sum.row,
            add: sum.add,
            adjoint: &env.adjoints[sum.sink].as_slice()[sum.channel * all..(sum.channel + 1) * all],
            segments: summed.segments,
            mean: summed.mean,
        };
    }
    let mut scatters = [no_lookup(); LIMIT];
    for (scatter, lookup) in scatters.iter_mut().zip(&plan.lookups) {
        *scatter = filled(env, worker, lanes, lookup.id, lookup.row);
    }
    let mut sources: [&[R]; LIMIT] = [&[]; LIMIT];
    let mut lookups = [no_lookup(); LIMIT];
    let rows = 2 * run.rows() * TILE;
    let block = block(
        (env, worker, lanes, run),
        &plan.reads,
        &chunk.span,
        &mut sources,
        &mut lookups,
        &mut tile.as_mut_slice()[..rows],
    );
    let kernel = Reverse {
        block,
        plan,
        adjoints: &adjoints,
        spreads: &spreads[..plan.sums.len()],
        targets: &mut targets,
        scatters: &scatters[..plan.lookups.len()],
        pulls: &mut pulls,
    };
    dispatch(env.arch, kernel);
    worker.tile = tile;
    put_back(pulls, positions(), &mut chunk.pull);
    for &slot in &plan.targets {
        worker.written[slot] = true;
    }
    put_back(targets, plan.targets.iter().copied(), &mut worker.adjoints);
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
    sources: &'a mut [&'a [R]; LIMIT],
    lookups: &'a mut [Filled<'a, R>; LIMIT],
    rows: &'a mut [R],
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
        rows,
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

fn empty<R: Lane>() -> [Buffer<R>; LIMIT] {
    std::array::from_fn(|_| Buffer::default())
}

fn take_all<R: Lane>(
    slots: impl Iterator<Item = usize>,
    arena: &mut [Buffer<R>],
) -> [Buffer<R>; LIMIT] {
    let mut taken = empty();
    for (taken, slot) in taken.iter_mut().zip(slots) {
        *taken = take(&mut arena[slot]);
    }
    taken
}

fn put_back<R: Lane>(
    taken: [Buffer<R>; LIMIT],
    slots: impl Iterator<Item = usize>,
    arena: &mut [Buffer<R>],
) {
    for (buffer, slot) in taken.into_iter().zip(slots) {
        arena[slot] = buffer;
    }
}
