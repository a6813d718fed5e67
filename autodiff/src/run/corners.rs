//! Interpolated lookups in a block.

use super::block::{Env, Lanes, View};
use super::interpolation;
use super::lookup::Rows;
use super::zero::Derivative;
use crate::buffer::Buffer;
use crate::graph::{CORNERS, NodeId, Op};
use crate::real::Real;

/// An interpolated lookup in `tables` with `weights`, of which one may be a derivative; the flags: whether to overwrite, and to take
/// weights that do not move too.
pub(super) fn interpolate<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    tables: View<R>,
    weights: View<R>,
    (first, all_weights): (bool, bool),
    derivative: Derivative,
    out: &mut Buffer<R>,
) {
    let table = tables.table(env, env.program.nodes[id].inputs[0]);
    let wanted = |weight: NodeId| all_weights || env.moving[weight];
    with_corners(env, lanes, id, weights, wanted, |corners| {
        let (rows, out) = (rows(env, id), out.as_mut_slice());
        let lanes = lanes.len;
        interpolation::gather_weighted(
            env.arch, table, rows, lanes, corners, out, first, derivative,
        );
    });
}

/// Calls `run` with the corners of an interpolated lookup; `wanted` leaves out weights.
pub(super) fn with_corners<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    weights: View<R>,
    wanted: impl Fn(NodeId) -> bool,
    run: impl FnOnce(&[(&[u32], &[R])]),
) {
    let node = &env.program.nodes[id];
    let Op::GatherWeighted(indices) = &node.op else {
        return;
    };
    let mut group: [(&[u32], &[R]); CORNERS] = [(&[], &[]); CORNERS];
    let mut count = 0;
    for (&index, &weight) in indices.iter().zip(&node.inputs[1..]) {
        if !wanted(weight) {
            continue;
        }
        let rows = &env.indices[index][lanes.start..lanes.start + lanes.len];
        group[count] = (rows, env.channel(weights, lanes, weight, 0));
        count += 1;
    }
    if count > 0 {
        run(&group[..count]);
    }
}

/// The layout of a lookup.
pub(super) fn rows<R: Real>(env: &Env<R>, id: NodeId) -> Rows {
    Rows {
        channels: env.channels(id),
        axis: env.axis(id),
        pitch: env.pitch(id),
    }
}
