//! Accumulations over lanes: of values, of tangents, and their adjoint.

use std::mem::take;

use super::block::{Env, Lanes, Worker, into_adjoint};
use super::chunk::Chunk;
use super::contract::{self, Term};
use super::lane::Lane;
use super::linear::add_lanes;
use super::rows::{put, put_value};
use super::segments::{collect, expand};
use super::value::{tangents_of, values};
use super::zero::Derivative;
use crate::graph::{NodeId, Op};

/// Adds a block to an accumulation over lanes, of values or of tangents.
pub(super) fn accumulate<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    at: usize,
    tangents: bool,
) {
    let node = &env.program.nodes[id];
    let mut scratch = take(&mut worker.scratch);
    let values = values(env, worker);
    let moving = tangents_of(env, worker);
    let view = if tangents { moving } else { values };
    let sums = if tangents {
        chunk.sink_tangent[at].as_mut_slice()
    } else {
        chunk.sink[at].as_mut_slice()
    };
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    match node.op {
        Op::SumLanes => {
            let first = lanes.start - chunk.span.lanes.start;
            for c in 0..channels {
                let source = env.channel(view, lanes, input, c);
                add_lanes(env, c, axis, first, source, sums);
            }
        }
        Op::SegmentSum { mean } => {
            for c in 0..channels {
                let source = env.channel(view, lanes, input, c);
                let span = &chunk.span;
                collect(env, span, lanes, (c, channels), axis, source, sums, mean);
            }
        }
        Op::SegmentDot => {
            let (a, b) = (node.inputs[0], node.inputs[1]);
            let term = |x, y, derivative| Term {
                a: (a, x),
                b: (b, y),
                derivative,
            };
            let by_a = term(view, values, Derivative::First);
            let by_b = term(values, view, Derivative::Second);
            let plain = term(view, values, Derivative::Neither);
            let terms = match (tangents, env.moving[a], env.moving[b]) {
                (true, true, true) => &[by_a, by_b][..],
                (true, false, true) => &[by_b],
                (true, _, _) => &[by_a],
                (false, _, _) => &[plain],
            };
            let scratch = scratch.as_mut_slice();
            contract::push(env, &chunk.span, lanes, id, terms, sums, scratch);
        }
        _ => {}
    }
    worker.scratch = scratch;
}

pub(super) fn sink_adjoint<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    id: NodeId,
) {
    if !env.seeded[id] {
        return;
    }
    let node = &env.program.nodes[id];
    let g = env.adjoints[id].as_slice();
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    let (pitch, len) = (env.stride * axis, lanes.len * axis);
    match node.op {
        Op::SumLanes => into_adjoint(env, worker, input, |target, add| {
            for c in 0..channels {
                let row = &g[c * axis..(c + 1) * axis];
                let target = &mut target[c * pitch..c * pitch + len];
                if axis == 1 {
                    put_value(target, row[0], add);
                } else {
                    for lane in target.chunks_exact_mut(axis) {
                        put(env.arch, lane, row, add);
                    }
                }
            }
        }),
        Op::SegmentSum { mean } => into_adjoint(env, worker, input, |target, add| {
            let all = env.all_lanes(id) * axis;
            for c in 0..channels {
                let parents = &g[c * all..(c + 1) * all];
                let target = &mut target[c * pitch..c * pitch + len];
                expand(env, lanes, axis, parents, 0, target, mean, add);
            }
        }),
        Op::SegmentDot => {
            let (a, b) = (node.inputs[0], node.inputs[1]);
            if env.live[a] {
                contract::pull(env, worker, lanes, id, (a, b), g);
            }
            if env.live[b] {
                contract::pull(env, worker, lanes, id, (b, a), g);
            }
        }
        _ => {}
    }
}
