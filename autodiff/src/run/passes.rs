//! The three passes over one chunk: values, tangents with them, and adjoints.

use super::adjoint::adjoint;
use super::block::{Env, Lanes, Worker, blocks, into_adjoint, is_constant, store};
use super::chunk::Chunk;
use super::lane::Lane;
use super::sinks::accumulate;
use super::tangent::tangent;
use super::tiles::{self, Known};
use super::value::value;
use crate::buffer::Buffer;
use crate::graph::NodeId;
use crate::program::{PullKind, Step};

/// Runs the blocks of a chunk forward: values, and tangents of moving nodes when `tangents`.
pub(super) fn forward<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    tangents: bool,
) {
    clear(&mut chunk.sink);
    if tangents {
        clear(&mut chunk.sink_tangent);
    }
    fill_constants(env, worker, |_| true);
    if tangents {
        fill_constant_tangents(env, worker);
    }
    let span = chunk.span.clone();
    for lanes in blocks(chunk, env.stride) {
        let by_tiles = R::PACKED && !tangents;
        let steps = if by_tiles { &env.phase.steps[..] } else { &[] };
        for step in steps {
            forward_step(env, worker, chunk, lanes, *step, false);
        }
        // Tangents need the value of every node in the arena; dual numbers gain nothing from tiles.
        let nodes = if by_tiles { &[] } else { &env.phase.nodes[..] };
        for &id in nodes {
            let op = &env.program.nodes[id].op;
            if op.is_sink() {
                let at = sink_position(env, id);
                accumulate(env, worker, chunk, lanes, id, at, false);
                if tangents && env.moving[id] {
                    accumulate(env, worker, chunk, lanes, id, at, true);
                }
            } else if !is_constant(op) {
                value(env, worker, lanes, id);
                if tangents && env.moving[id] {
                    tangent(env, worker, lanes, id);
                }
            }
        }
        store(env, &span, lanes, &worker.values, &mut chunk.store, |_| {
            true
        });
        if tangents {
            let targets = &mut chunk.store_tangent;
            store(env, &span, lanes, &worker.tangents, targets, |id| {
                env.moving[id]
            });
        }
    }
}

/// Runs one step of a phase forward on a block; `keep`s what runs compute for the way back.
pub(super) fn forward_step<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    step: Step,
    keep: bool,
) {
    match step {
        Step::Run(at) => tiles::forward(env, worker, chunk, lanes, at, keep),
        Step::Node(id) => {
            let op = &env.program.nodes[id].op;
            if op.is_sink() {
                let at = sink_position(env, id);
                accumulate(env, worker, chunk, lanes, id, at, false);
            } else if !is_constant(op) {
                value(env, worker, lanes, id);
            }
        }
    }
}

/// Replays the blocks of a chunk and runs them backward.
pub(super) fn reverse<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, chunk: &mut Chunk<R>) {
    clear(&mut chunk.pull);
    fill_constants(env, worker, |id| env.replay[id]);
    for lanes in blocks(chunk, env.stride) {
        if R::PACKED {
            replay(env, worker, lanes);
            reverse_block(env, worker, chunk, lanes, None);
        } else {
            for &id in &env.phase.nodes {
                replay_node(env, worker, lanes, id);
            }
            worker.written[..env.phase.locals.len()].fill(false);
            seed(env, worker, lanes);
            for &id in env.phase.nodes.iter().rev() {
                if env.live[id] {
                    adjoint(env, worker, chunk, lanes, id);
                }
            }
        }
        pull_lanes(env, worker, chunk, lanes);
    }
}

/// Runs a block backward; what it reads outside of runs is in the arena. `known` holds adjoints of sums that are not whole
/// yet; then what runs read has been kept.
pub(super) fn reverse_block<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    known: Option<&Known<R>>,
) {
    worker.written[..env.phase.locals.len()].fill(false);
    seed(env, worker, lanes);
    for step in env.phase.steps.iter().rev() {
        match *step {
            Step::Run(at) => tiles::reverse(env, worker, chunk, lanes, at, known),
            Step::Node(id) if env.live[id] => adjoint(env, worker, chunk, lanes, id),
            Step::Node(_) => {}
        }
    }
}

/// Copies adjoints of whole operands on the same lanes to the chunk.
pub(super) fn pull_lanes<R: Lane>(
    env: &Env<R>,
    worker: &Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
) {
    let span = &chunk.span.lanes;
    for (pull, target) in env.phase.pulls.iter().zip(&mut chunk.pull) {
        if pull.kind != PullKind::Lanes || !env.live[pull.target] {
            continue;
        }
        let (id, slot) = (pull.target, env.slot(pull.target));
        if !worker.written[slot] {
            continue;
        }
        let axis = env.axis(id);
        let source = worker.adjoints[slot].as_slice();
        for c in 0..env.channels(id) {
            let from = c * env.pitch(id);
            let to = (c * span.len() + lanes.start - span.start) * axis;
            target.as_mut_slice()[to..to + lanes.len * axis]
                .copy_from_slice(&source[from..from + lanes.len * axis]);
        }
    }
}

/// Starts accumulations anew.
pub(super) fn clear<R: Lane>(accumulations: &mut [Buffer<R>]) {
    for sums in accumulations {
        sums.as_mut_slice().fill(R::default());
    }
}

/// Computes again what the reverse pass reads outside of runs.
pub(super) fn replay<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes) {
    for step in &env.phase.steps {
        match *step {
            Step::Run(at) => tiles::replay(env, worker, lanes, at),
            Step::Node(id) => replay_node(env, worker, lanes, id),
        }
    }
}

pub(super) fn replay_node<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    let op = &env.program.nodes[id].op;
    if env.replay[id] && !op.is_sink() && !is_constant(op) {
        value(env, worker, lanes, id);
    }
}

/// Starts the adjoints of a block with what later phases left for its stored nodes.
pub(super) fn seed<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes) {
    let all = env.extent.lanes[env.phase.domain];
    for &id in &env.phase.stores {
        if !env.live[id] || !env.seeded[id] {
            continue;
        }
        let axis = env.axis(id);
        let source = env.adjoints[id].as_slice();
        into_adjoint(env, worker, id, |target, _| {
            for c in 0..env.channels(id) {
                let from = (c * all + lanes.start) * axis;
                let to = c * env.pitch(id);
                target[to..to + lanes.len * axis]
                    .copy_from_slice(&source[from..from + lanes.len * axis]);
            }
        });
    }
}

pub(super) fn fill_constants<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    wanted: impl Fn(NodeId) -> bool,
) {
    let lanes = Lanes {
        start: 0,
        len: env.stride,
    };
    for &id in &env.phase.nodes {
        if is_constant(&env.program.nodes[id].op) && wanted(id) {
            value(env, worker, lanes, id);
        }
    }
}

fn fill_constant_tangents<R: Lane>(env: &Env<R>, worker: &mut Worker<R>) {
    let lanes = Lanes {
        start: 0,
        len: env.stride,
    };
    for &id in &env.phase.nodes {
        if is_constant(&env.program.nodes[id].op) && env.moving[id] {
            tangent(env, worker, lanes, id);
        }
    }
}

pub(super) fn sink_position<R>(env: &Env<R>, id: NodeId) -> usize {
    env.phase
        .sinks
        .iter()
        .position(|&sink| sink == id)
        .unwrap_or(0)
}
