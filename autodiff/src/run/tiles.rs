//! Executes the runs of a block.

use std::mem::take;

use super::block::{Env, Lanes, Worker};
use super::lane::Lane;
use super::plan::Values;
use super::value::values;
use crate::buffer::Buffer;
use crate::op::kernel::dispatch;
use crate::op::tile::{Forward, Reverse, TILE};
use crate::program::{LIMIT, Phase, Run};

/// Elements of the tile of a thread: values, and as many adjoints.
pub(super) fn tile_len(phase: &Phase) -> usize {
    let rows = phase.runs.iter().map(Run::rows).max().unwrap_or(0);
    2 * rows * TILE
}

/// Computes values of a run.
pub(super) fn forward<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    run: &Run,
    plan: &Values,
) {
    if plan.exports.is_empty() {
        return;
    }
    let mut taken = take_all(&plan.targets, &mut worker.values);
    let mut tile = take(&mut worker.tile);
    let view = values(env, worker);
    let mut sources: [&[R]; LIMIT] = [&[]; LIMIT];
    for (source, &(id, channel)) in sources.iter_mut().zip(&run.externals) {
        *source = env.channel(view, lanes, id, channel);
    }
    let mut targets: [&mut [R]; LIMIT] = std::array::from_fn(|_| &mut [][..]);
    for (target, buffer) in targets.iter_mut().zip(&mut taken[..plan.targets.len()]) {
        *target = buffer.as_mut_slice();
    }
    let kernel = Forward {
        len: lanes.len * env.axis(run.nodes[0]),
        sources: &sources[..run.externals.len()],
        instructions: &plan.instructions,
        exports: &plan.exports,
        targets: &mut targets,
        rows: tile.as_mut_slice(),
    };
    dispatch(env.arch, kernel);
    worker.tile = tile;
    put_back(taken, &plan.targets, &mut worker.values);
}

/// Passes the adjoints of a run back.
pub(super) fn reverse<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, at: usize) {
    let (run, plan) = (&env.phase.runs[at], &env.plans[at].adjoints);
    if plan.pulls.is_empty() {
        return;
    }
    let mut taken = take_all(&plan.targets, &mut worker.adjoints);
    let mut tile = take(&mut worker.tile);
    let view = values(env, worker);
    let mut sources: [&[R]; LIMIT] = [&[]; LIMIT];
    for (i, (source, &(id, channel))) in sources.iter_mut().zip(&run.externals).enumerate() {
        if plan.reads[i] {
            *source = env.channel(view, lanes, id, channel);
        }
    }
    let mut adjoints: [&[R]; LIMIT] = [&[]; LIMIT];
    for (adjoint, &slot) in adjoints.iter_mut().zip(&plan.sources) {
        debug_assert!(worker.written[slot]);
        *adjoint = worker.adjoints[slot].as_slice();
    }
    let mut targets: [&mut [R]; LIMIT] = std::array::from_fn(|_| &mut [][..]);
    for (target, buffer) in targets.iter_mut().zip(&mut taken[..plan.targets.len()]) {
        *target = buffer.as_mut_slice();
    }
    let rows = 2 * run.rows() * TILE;
    let kernel = Reverse {
        len: lanes.len * env.axis(run.nodes[0]),
        sources: &sources[..run.externals.len()],
        instructions: &plan.instructions,
        imports: &plan.imports,
        adjoints: &adjoints,
        reads: &plan.adds,
        pulls: &plan.pulls,
        exports: &plan.exports,
        targets: &mut targets,
        rows: &mut tile.as_mut_slice()[..rows],
    };
    dispatch(env.arch, kernel);
    worker.tile = tile;
    for &slot in &plan.targets {
        worker.written[slot] = true;
    }
    put_back(taken, &plan.targets, &mut worker.adjoints);
}

fn take_all<R: Lane>(slots: &[usize], arena: &mut [Buffer<R>]) -> [Buffer<R>; LIMIT] {
    let mut taken = std::array::from_fn(|_| Buffer::default());
    for (taken, &slot) in taken.iter_mut().zip(slots) {
        *taken = take(&mut arena[slot]);
    }
    taken
}

fn put_back<R: Lane>(taken: [Buffer<R>; LIMIT], slots: &[usize], arena: &mut [Buffer<R>]) {
    for (buffer, &slot) in taken.into_iter().zip(slots) {
        arena[slot] = buffer;
    }
}
