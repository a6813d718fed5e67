//! Values of a block.

use std::mem::take;

use super::block::{Env, Lanes, View, Worker};
use super::corners::{interpolate, rows};
use super::dense::dense;
use super::lane::{Function, Lane};
use super::linear;
use super::lookup;
use super::segments::expand;
use super::zero::Derivative;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};

/// Most operands of an elementwise operation.
pub(crate) const OPERANDS: usize = 8;

pub(super) fn value<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    let slot = env.slot(id);
    let mut out = take(&mut worker.values[slot]);
    let view = values(env, worker);
    let node = &env.program.nodes[id];
    if let Some(function) = Function::of(node) {
        let len = lanes.len * env.axis(id);
        for c in 0..node.shape.channels {
            let start = c * env.pitch(id);
            let x = operands(env, view, lanes, &node.inputs, c);
            let y = &mut out.as_mut_slice()[start..start + len];
            function.evaluate(env.arch, &x[..node.inputs.len()], y);
        }
        worker.values[slot] = out;
        return;
    }
    match &node.op {
        Op::GatherWeighted(_) => {
            let flags = (true, true);
            let plain = Derivative::Neither;
            interpolate(env, lanes, id, view, view, flags, plain, &mut out);
        }
        Op::Matmul => {
            let mut scratch = take(&mut worker.scratch);
            let view = values(env, worker);
            dense(
                env,
                lanes,
                id,
                view,
                view,
                (true, true),
                Derivative::Neither,
                &mut out,
                &mut scratch,
            );
            worker.scratch = scratch;
        }
        _ => push_linear(env, view, lanes, id, &mut out, |_| true),
    }
    worker.values[slot] = out;
}

/// Values as seen from a block.
pub(super) fn values<'v, R: Lane>(env: &Env<'v, R>, worker: &'v Worker<R>) -> View<'v, R> {
    View {
        local: &worker.values,
        whole: env.values,
        tables: env.tables,
    }
}

/// Tangents as seen from a block.
pub(super) fn tangents_of<'v, R: Lane>(env: &Env<'v, R>, worker: &'v Worker<R>) -> View<'v, R> {
    View {
        local: &worker.tangents,
        whole: env.tangents,
        tables: env.table_tangents,
    }
}

/// One channel of each operand.
pub(super) fn operands<'v, R: Lane>(
    env: &Env<R>,
    view: View<'v, R>,
    lanes: Lanes,
    inputs: &[NodeId],
    channel: usize,
) -> [&'v [R]; OPERANDS] {
    std::array::from_fn(|i| {
        inputs
            .get(i)
            .map_or(&[][..], |&input| env.channel(view, lanes, input, channel))
    })
}

/// Operations that are linear in their only differentiable operand.
pub(super) fn push_linear<R: Lane>(
    env: &Env<R>,
    view: View<R>,
    lanes: Lanes,
    id: NodeId,
    out: &mut Buffer<R>,
    present: impl Fn(NodeId) -> bool,
) {
    let node = &env.program.nodes[id];
    let (pitch, axis) = (env.pitch(id), env.axis(id));
    let len = lanes.len * axis;
    let input = node.inputs[0];
    let all = env.all_lanes(input) * axis;
    match node.op {
        Op::Gather(index) => {
            let index = &env.indices[index][lanes.start..lanes.start + lanes.len];
            lookup::gather(
                env.arch,
                view.table(env, input),
                rows(env, id),
                index,
                out.as_mut_slice(),
            );
        }
        Op::Expand => {
            for c in 0..node.shape.channels {
                let parents = &view.whole[input].as_slice()[c * all..(c + 1) * all];
                let out = &mut out.as_mut_slice()[c * pitch..c * pitch + len];
                expand(env, lanes, axis, parents, 0, out, false, false);
            }
        }
        _ => linear::push(env, view, lanes, id, out, present),
    }
}
