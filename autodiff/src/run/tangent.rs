//! Tangents of a block, alongside its values.

use std::mem::take;

use super::block::{Env, Lanes, Worker};
use super::corners::interpolate;
use super::dense::dense;
use super::rows::put_value;

use super::lane::{Function, Lane};
use super::value::{operands, push_linear, tangents_of, values};
use super::zero::Derivative;
use crate::graph::{NodeId, Op};

pub(super) fn tangent<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    let slot = env.slot(id);
    let mut out = take(&mut worker.tangents[slot]);
    let mut scratch = take(&mut worker.scratch);
    let values = values(env, worker);
    let tangents = tangents_of(env, worker);
    let node = &env.program.nodes[id];
    let moving = |id: NodeId| env.moving[id];
    if let Some(function) = Function::of(node) {
        let len = lanes.len * env.axis(id);
        for c in 0..node.shape.channels {
            let start = c * env.pitch(id);
            let x = operands(env, values, lanes, &node.inputs, c);
            let y = &worker.values[slot].as_slice()[start..start + len];
            let target = &mut out.as_mut_slice()[start..start + len];
            let mut add = false;
            for (i, &input) in node.inputs.iter().enumerate() {
                if moving(input) {
                    let source = env.channel(tangents, lanes, input, c);
                    let x = &x[..node.inputs.len()];
                    function.pass(env.arch, i, x, y, source, target, add);
                    add = true;
                }
            }
        }
        worker.tangents[slot] = out;
        worker.scratch = scratch;
        return;
    }
    match &node.op {
        Op::GatherWeighted(_) => {
            let table = moving(node.inputs[0]);
            if table {
                let (flags, of_table) = ((true, true), Derivative::Second);
                interpolate(env, lanes, id, tangents, values, flags, of_table, &mut out);
            }
            if node.inputs[1..].iter().any(|&w| moving(w)) {
                let (flags, of_weights) = ((!table, false), Derivative::First);
                interpolate(
                    env, lanes, id, values, tangents, flags, of_weights, &mut out,
                );
            }
        }
        Op::Matmul => {
            let bias = node.inputs.get(2).is_some_and(|&b| moving(b));
            if moving(node.inputs[0]) {
                dense(
                    env,
                    lanes,
                    id,
                    tangents,
                    values,
                    (true, false),
                    Derivative::Second,
                    &mut out,
                    &mut scratch,
                );
            }
            if moving(node.inputs[1]) {
                let first = !moving(node.inputs[0]);
                dense(
                    env,
                    lanes,
                    id,
                    values,
                    tangents,
                    (first, false),
                    Derivative::First,
                    &mut out,
                    &mut scratch,
                );
            }
            if bias {
                let first = !moving(node.inputs[0]) && !moving(node.inputs[1]);
                let tangent = tangents.whole[node.inputs[2]].as_slice();
                for (c, t) in tangent.iter().enumerate() {
                    let start = c * env.stride;
                    let row = &mut out.as_mut_slice()[start..start + lanes.len];
                    put_value(row, *t, !first);
                }
            }
        }
        _ => push_linear(env, tangents, lanes, id, &mut out, moving),
    }
    worker.tangents[slot] = out;
    worker.scratch = scratch;
}
