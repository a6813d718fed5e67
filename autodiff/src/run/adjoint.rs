//! Adjoints of a block: each node passes its own on to its operands.

use std::mem::take;

use super::block::{Env, Lanes, View, Worker, into_adjoint};
use super::chunk::{Chunk, Span};
use super::corners::{rows, with_corners};
use super::dense::dense_adjoint;
use super::interpolation;
use super::lane::{Function, Lane};
use super::linear::{self, add_lanes};
use super::lookup;
use super::segments::collect;
use super::sinks::sink_adjoint;
use super::value::{operands, values};
use crate::graph::{NodeId, Op};
use crate::program::PullKind;

/// Passes the adjoint of a node on to its operands.
pub(super) fn adjoint<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
) {
    let node = &env.program.nodes[id];
    if node.op.is_sink() {
        return sink_adjoint(env, worker, lanes, id);
    }
    let slot = env.slot(id);
    if !worker.written[slot] {
        return;
    }
    let g = take(&mut worker.adjoints[slot]);
    match &node.op {
        Op::Element(_) | Op::Custom(_) => element_adjoint(env, worker, lanes, id, g.as_slice()),
        Op::Splat | Op::Expand | Op::Gather(_) | Op::GatherWeighted(_) | Op::Matmul => {
            whole_adjoint(env, worker, chunk, lanes, id, g.as_slice())
        }
        _ => linear::pull(env, worker, lanes, id, g.as_slice()),
    }
    worker.adjoints[slot] = g;
}

pub(super) fn element_adjoint<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let node = &env.program.nodes[id];
    let Some(function) = Function::of(node) else {
        return;
    };
    let (pitch, len) = (env.pitch(id), lanes.len * env.axis(id));
    for (i, &input) in node.inputs.iter().enumerate() {
        if !env.live[input] {
            continue;
        }
        let slot = env.slot(input);
        let add = std::mem::replace(&mut worker.written[slot], true);
        let mut target = take(&mut worker.adjoints[slot]);
        let view = values(env, worker);
        let single = env.channels(input) == 1;
        for c in 0..node.shape.channels {
            let x = operands(env, view, lanes, &node.inputs, c);
            let start = c * pitch;
            let y = &worker.values[env.slot(id)].as_slice()[start..start + len];
            let to = if single { 0 } else { start };
            let target = &mut target.as_mut_slice()[to..to + len];
            let add = add || (single && c > 0);
            let x = &x[..node.inputs.len()];
            function.pass(env.arch, i, x, y, &g[start..start + len], target, add);
        }
        worker.adjoints[slot] = target;
    }
}

/// How many lanes a chunk has, which of them is the first of a block, and how many the block has.
fn within(span: &Span, lanes: Lanes) -> (usize, usize, usize) {
    (span.lanes.len(), lanes.start - span.lanes.start, lanes.len)
}

/// Adjoints of operands that are whole: accumulated by the chunk.
pub(super) fn whole_adjoint<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let node = &env.program.nodes[id];
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    let (pitch, len) = (env.pitch(id), lanes.len * axis);
    let pull = |target: NodeId, kind: PullKind| {
        env.live[target]
            .then(|| env.phase.pull(target, kind, id))
            .flatten()
    };
    match &node.op {
        Op::Splat => {
            if let Some(at) = pull(input, PullKind::Uniform) {
                let first = lanes.start - chunk.span.lanes.start;
                for c in 0..channels {
                    let source = &g[c * pitch..c * pitch + len];
                    let sums = chunk.pull[at].as_mut_slice();
                    add_lanes(env, c, axis, first, source, sums);
                }
            }
        }
        Op::Expand => {
            if let Some(at) = pull(input, PullKind::Parents) {
                for c in 0..channels {
                    let source = &g[c * pitch..c * pitch + len];
                    let sums = chunk.pull[at].as_mut_slice();
                    let span = &chunk.span;
                    collect(env, span, lanes, (c, channels), axis, source, sums, false);
                }
            }
        }
        Op::Gather(index) => {
            if let Some(at) = pull(input, PullKind::Table) {
                let table = chunk.pull[at].as_mut_slice();
                let index = &env.indices[*index][lanes.start..lanes.start + lanes.len];
                match env.bucketings[at] {
                    Some(bucketing) => {
                        let lanes = within(&chunk.span, lanes);
                        bucketing.keep(table, lanes, (g, pitch), &[]);
                    }
                    None => lookup::scatter(env.arch, table, rows(env, id), index, g),
                }
            }
        }
        Op::GatherWeighted(indices) => {
            let view = values(env, worker);
            if let Some(at) = pull(input, PullKind::Table) {
                let table = chunk.pull[at].as_mut_slice();
                with_corners(
                    env,
                    lanes,
                    id,
                    view,
                    |_| true,
                    |corners| match env.bucketings[at] {
                        Some(bucketing) => {
                            let lanes = within(&chunk.span, lanes);
                            bucketing.keep(table, lanes, (g, pitch), corners);
                        }
                        None => interpolation::scatter_weighted(
                            env.arch,
                            table,
                            rows(env, id),
                            lanes.len,
                            corners,
                            g,
                        ),
                    },
                );
            }
            let whole = View {
                local: &[],
                whole: env.values,
                tables: env.tables,
            };
            let table = whole.table(env, input);
            for (&index, &weight) in indices.iter().zip(&node.inputs[1..]) {
                if !env.live[weight] {
                    continue;
                }
                let index = &env.indices[index][lanes.start..lanes.start + lanes.len];
                into_adjoint(env, worker, weight, |target, add| {
                    let target = &mut target[..lanes.len];
                    interpolation::pull_weight(table, rows(env, id), index, g, target, add);
                });
            }
        }
        Op::Matmul => dense_adjoint(env, worker, chunk, lanes, id, g),
        _ => {}
    }
}
