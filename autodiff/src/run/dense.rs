//! Dense layers in a block.

use std::mem::take;

use super::block::{Env, Lanes, View, Worker, into_adjoint, is_computed};
use super::chunk::Chunk;
use super::lane::Lane;
use super::linear::add_lanes;
use super::matmul::{Matrix, Outer, Product, outer, product};
use super::value::values;
use super::zero::Derivative;
use crate::buffer::Buffer;
use crate::graph::NodeId;
use crate::program::PullKind;

/// A dense layer on `xs` and `weights`, of which one may be a derivative; the flags: whether to overwrite, and to add the bias.
pub(super) fn dense<R: Lane>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    xs: View<R>,
    weights: View<R>,
    (first, bias): (bool, bool),
    derivative: Derivative,
    out: &mut Buffer<R>,
    scratch: &mut Buffer<R>,
) {
    let inputs = &env.program.nodes[id].inputs;
    let inner = env.channels(inputs[0]);
    product(
        env.arch,
        Product {
            matrix: Matrix {
                data: weights.whole[inputs[1]].as_slice(),
                rows: inner,
                columns: 1,
            },
            bias: inputs
                .get(2)
                .filter(|_| bias)
                .map(|&bias| weights.whole[bias].as_slice()),
            x: padded(env, xs, lanes, inputs[0], scratch.as_mut_slice()),
            x_pitch: env.stride,
            out: out.as_mut_slice(),
            pitch: env.stride,
            out_rows: env.channels(id),
            inner,
            lanes: lanes.len,
            add: !first,
            derivative,
        },
    );
}

/// The block of an operand of a dense layer: its arena slot, or a padded copy of the whole array's lanes.
pub(super) fn padded<'v, R: Lane>(
    env: &Env<R>,
    view: View<'v, R>,
    lanes: Lanes,
    id: NodeId,
    scratch: &'v mut [R],
) -> &'v [R] {
    if is_computed(env, id) {
        return view.local[env.slot(id)].as_slice();
    }
    for c in 0..env.channels(id) {
        scratch[c * env.stride..c * env.stride + lanes.len]
            .copy_from_slice(env.channel(view, lanes, id, c));
    }
    scratch
}

pub(super) fn dense_adjoint<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let inputs = &env.program.nodes[id].inputs;
    let (x, weight) = (inputs[0], inputs[1]);
    let (rows, inner) = (env.channels(id), env.channels(x));
    if env.live[x] {
        into_adjoint(env, worker, x, |target, add| {
            product(
                env.arch,
                Product {
                    // The transposed matrix.
                    matrix: Matrix {
                        data: env.values[weight].as_slice(),
                        rows: 1,
                        columns: inner,
                    },
                    bias: None,
                    x: g,
                    x_pitch: env.stride,
                    out: target,
                    pitch: env.stride,
                    out_rows: inner,
                    inner: rows,
                    lanes: lanes.len,
                    add,
                    derivative: Derivative::Second,
                },
            );
        });
    }
    if env.live[weight]
        && let Some(at) = env.phase.pull(weight, PullKind::Weight, id)
    {
        let mut scratch = take(&mut worker.scratch);
        let view = values(env, worker);
        let (copy, transposed) = scratch.as_mut_slice().split_at_mut(inner * env.stride);
        let x = padded(env, view, lanes, x, copy);
        outer(
            env.arch,
            Outer {
                g,
                g_pitch: env.stride,
                x,
                x_pitch: env.stride,
                rows,
                columns: inner,
                lanes: lanes.len,
                transposed,
                sums: chunk.pull[at].as_mut_slice(),
            },
        );
        worker.scratch = scratch;
    }
    if let Some(&bias) = inputs.get(2)
        && env.live[bias]
        && let Some(at) = env.phase.pull(bias, PullKind::Uniform, id)
    {
        let first = lanes.start - chunk.span.lanes.start;
        for c in 0..rows {
            let source = &g[c * env.stride..][..lanes.len];
            add_lanes(env, c, 1, first, source, chunk.pull[at].as_mut_slice());
        }
    }
}
