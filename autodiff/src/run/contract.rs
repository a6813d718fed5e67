//! The sum over a segment of a product, without the product in memory.
//!
//! The case that matters has a coefficient without axis (a few channels) and a row along the axis (one channel): the
//! accumulators of one segment stay in registers while its lanes stream by.

use super::block::{Env, Lanes, View, Worker};
use super::chunk::Span;
use super::contract_kernel::{Accumulate, Dots, Products, PullRows};
use super::segments::{collect, pieces};
use crate::graph::NodeId;
use crate::op::kernel::dispatch;
use crate::real::Real;

/// Adds the products of a block to the segments' sums. `a` and `b` may be values or tangents.
pub(super) fn push<R: Real>(
    env: &Env<R>,
    span: &Span,
    lanes: Lanes,
    id: NodeId,
    (a, view_a): (NodeId, View<R>),
    (b, view_b): (NodeId, View<R>),
    sums: &mut [R],
    scratch: &mut [R],
) {
    let (channels, axis) = (env.channels(id), env.axis(id));
    let (axis_a, axis_b) = (env.axis(a), env.axis(b));
    if axis_a == axis_b {
        for c in 0..channels {
            let product = &mut scratch[..lanes.len * axis];
            let x = env.channel(view_a, lanes, a, c);
            let y = env.channel(view_b, lanes, b, c);
            for ((p, x), y) in product.iter_mut().zip(x).zip(y) {
                *p = *x * *y;
            }
            collect(env, span, lanes, (c, channels), axis, product, sums, false);
        }
        return;
    }
    let ((a, view_a), (b, view_b)) = if axis_a == 1 {
        ((a, view_a), (b, view_b))
    } else {
        ((b, view_b), (a, view_a))
    };
    let parents = span.parents.len();
    let shared = env.channels(b) == 1;
    for piece in pieces(env, lanes) {
        let p = piece.parent - span.parents.start;
        let (start, end) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let mut c = 0;
        while c < channels {
            let group = if shared && channels - c >= 3 { 3 } else { 1 };
            let rows = &env.channel(view_b, lanes, b, c)[start * axis..end * axis];
            let factor = |i: usize| &env.channel(view_a, lanes, a, c + i)[start..end];
            let sum_start = (c * parents + p) * axis;
            if group == 3 {
                let factors = [factor(0), factor(1), factor(2)];
                let pitch = parents * axis;
                let sums = &mut sums[sum_start..sum_start + 2 * pitch + axis];
                dispatch(
                    env.arch,
                    Accumulate {
                        factors,
                        rows,
                        axis,
                        sums,
                        pitch,
                    },
                );
            } else {
                let sums = &mut sums[sum_start..sum_start + axis];
                let factors = [factor(0)];
                dispatch(
                    env.arch,
                    Accumulate {
                        factors,
                        rows,
                        axis,
                        sums,
                        pitch: 0,
                    },
                );
            }
            c += group;
        }
    }
}

/// The adjoint of `target` (an operand), given the adjoint `g` of the sums (whole, on the parents) and the values of `other`.
pub(super) fn pull<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    id: NodeId,
    (target, other): (NodeId, NodeId),
    g: &[R],
) {
    let slot = env.slot(target);
    let add = std::mem::replace(&mut worker.written[slot], true);
    let mut adjoint = std::mem::take(&mut worker.adjoints[slot]);
    let view = View {
        local: &worker.values,
        whole: env.values,
        tables: env.tables,
    };
    let channels = env.channels(id);
    let (single, shared) = (env.channels(target) == 1, env.channels(other) == 1);
    let (axis_t, axis_o) = (env.axis(target), env.axis(other));
    let mut c = 0;
    while c < channels {
        let three = channels - c >= 3 && axis_t != axis_o;
        let into = Into {
            out: adjoint.as_mut_slice(),
            channel: if single { 0 } else { c },
            add: add || (single && c > 0),
        };
        if three && axis_t == 1 && shared && !single {
            pull_three::<R, true>(env, view, lanes, id, (target, other), c, g, into);
            c += 3;
        } else if three && axis_o == 1 && single && !shared {
            pull_three::<R, false>(env, view, lanes, id, (target, other), c, g, into);
            c += 3;
        } else {
            pull_one(env, view, lanes, id, (target, other), c, g, into);
            c += 1;
        }
    }
    worker.adjoints[slot] = adjoint;
}

/// Where an adjoint goes.
struct Into<'a, R> {
    out: &'a mut [R],
    channel: usize,
    add: bool,
}

/// Three channels at once: the coefficients' adjoints (`DOTS`), or the rows'.
fn pull_three<R: Real, const DOTS: bool>(
    env: &Env<R>,
    view: View<R>,
    lanes: Lanes,
    id: NodeId,
    (target, other): (NodeId, NodeId),
    c: usize,
    g: &[R],
    into: Into<R>,
) {
    let (axis, all) = (env.axis(id), env.all_lanes(id));
    let pitch = env.pitch(target);
    let start = into.channel * pitch;
    for piece in pieces(env, lanes) {
        let g: [&[R]; 3] = std::array::from_fn(|i| {
            let row = ((c + i) * all + piece.parent) * axis;
            &g[row..row + axis]
        });
        let (first, last) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let others: [&[R]; 3] = std::array::from_fn(|i| env.channel(view, lanes, other, c + i));
        let add = into.add;
        if DOTS {
            let rows = &others[0][first * axis..last * axis];
            let out = &mut into.out[start + first..start + 2 * pitch + last];
            dispatch(
                env.arch,
                Dots {
                    g,
                    rows,
                    axis,
                    out,
                    pitch,
                    add,
                },
            );
        } else {
            let factors = others.map(|other| &other[first..last]);
            let rows = &mut into.out[start + first * axis..start + last * axis];
            dispatch(
                env.arch,
                PullRows {
                    g,
                    factors,
                    axis,
                    rows,
                    add,
                },
            );
        }
    }
}

/// One channel, of operands of any shapes.
fn pull_one<R: Real>(
    env: &Env<R>,
    view: View<R>,
    lanes: Lanes,
    id: NodeId,
    (target, other): (NodeId, NodeId),
    c: usize,
    g: &[R],
    into: Into<R>,
) {
    let (axis, all) = (env.axis(id), env.all_lanes(id));
    let (axis_t, axis_o) = (env.axis(target), env.axis(other));
    let start = into.channel * env.pitch(target);
    let other = env.channel(view, lanes, other, c);
    let add = into.add;
    for piece in pieces(env, lanes) {
        let row = (c * all + piece.parent) * axis;
        let g = &g[row..row + axis];
        let (first, last) = (
            piece.lanes.start - lanes.start,
            piece.lanes.end - lanes.start,
        );
        let out = &mut into.out[start + first * axis_t..start + last * axis_t];
        let other = &other[first * axis_o..last * axis_o];
        if axis_t == axis_o {
            dispatch(env.arch, Products { g, other, out, add });
        } else if axis_t == 1 {
            let (g, rows) = ([g], other);
            dispatch(
                env.arch,
                Dots {
                    g,
                    rows,
                    axis,
                    out,
                    pitch: 0,
                    add,
                },
            );
        } else {
            let (g, factors, rows) = ([g], [other], out);
            dispatch(
                env.arch,
                PullRows {
                    g,
                    factors,
                    axis,
                    rows,
                    add,
                },
            );
        }
    }
}
