//! The sum over a segment of a product, without the product in memory.
//!
//! The case that matters has a coefficient without axis (a few channels) and a row along the axis (one channel): the
//! accumulators of one segment stay in registers while its lanes stream by.

use super::block::{Env, Lanes, View, Worker};
use super::chunk::Span;
use super::contract_kernel::{Accumulate, Dots, Products, PullRows};
use super::segments::{collect, pieces};
use super::zero::{Derivative, times};
use crate::graph::NodeId;
use crate::op::kernel::dispatch;
use crate::real::Real;

/// An operand as a value or as a tangent.
pub(super) type Operand<'a, R> = (NodeId, View<'a, R>);

/// A product to be summed.
#[derive(Clone, Copy)]
pub(super) struct Term<'a, R> {
    pub a: Operand<'a, R>,
    pub b: Operand<'a, R>,
    pub derivative: Derivative,
}

impl<R> Term<'_, R> {
    fn exchanged(self) -> Self {
        Term {
            a: self.b,
            b: self.a,
            derivative: self.derivative.exchanged(),
        }
    }
}

/// Adds the products of a block, summed over `terms`, to the segments' sums.
pub(super) fn push<R: Real>(
    env: &Env<R>,
    span: &Span,
    lanes: Lanes,
    id: NodeId,
    terms: &[Term<R>],
    sums: &mut [R],
    scratch: &mut [R],
) {
    let inputs = &env.program.nodes[id].inputs;
    let (channels, axis) = (env.channels(id), env.axis(id));
    if env.axis(inputs[0]) != env.axis(inputs[1]) {
        return match terms {
            &[one] => push_rows(env, span, lanes, id, [one], sums),
            &[one, two, ..] => push_rows(env, span, lanes, id, [one, two], sums),
            [] => {}
        };
    }
    // All terms at once: the open sum of a segment is carried from block to block.
    let product = &mut scratch[..lanes.len * axis];
    for c in 0..channels {
        product.fill(R::default());
        for term in terms {
            let term = match term.derivative {
                Derivative::Second => term.exchanged(),
                _ => *term,
            };
            let x = env.channel(term.a.1, lanes, term.a.0, c);
            let y = env.channel(term.b.1, lanes, term.b.0, c);
            let factors = product.iter_mut().zip(x).zip(y);
            if term.derivative == Derivative::Neither {
                factors.for_each(|((p, x), y)| *p = *p + *x * *y);
            } else {
                factors.for_each(|((p, x), y)| *p = *p + times(*x, *y));
            }
        }
        collect(env, span, lanes, (c, channels), axis, product, sums, false);
    }
}

/// The same for a coefficient without axis times a row along it.
fn push_rows<R: Real, const N: usize>(
    env: &Env<R>,
    span: &Span,
    lanes: Lanes,
    id: NodeId,
    terms: [Term<R>; N],
    sums: &mut [R],
) {
    // The coefficient first.
    let terms = terms.map(|term| match env.axis(term.a.0) {
        1 => term,
        _ => term.exchanged(),
    });
    let derivatives = terms.map(|term| term.derivative);
    let (channels, axis, parents) = (env.channels(id), env.axis(id), span.parents.len());
    let shared = env.channels(terms[0].b.0) == 1;
    for piece in pieces(env, lanes) {
        let first = piece.lanes.start - lanes.start;
        let last = piece.lanes.end - lanes.start;
        let rows = |c: usize| {
            terms.map(|Term { b: (b, view), .. }| {
                &env.channel(view, lanes, b, c)[first * axis..last * axis]
            })
        };
        let factor = |n: usize, c: usize| {
            let (a, view) = terms[n].a;
            &env.channel(view, lanes, a, c)[first..last]
        };
        let pitch = parents * axis;
        let mut c = 0;
        while c < channels {
            let start = c * pitch + (piece.parent - span.parents.start) * axis;
            let rows = rows(c);
            if shared && channels - c >= 3 {
                let factors =
                    std::array::from_fn(|n| [factor(n, c), factor(n, c + 1), factor(n, c + 2)]);
                let sums = &mut sums[start..start + 2 * pitch + axis];
                dispatch(
                    env.arch,
                    Accumulate {
                        factors,
                        rows,
                        derivatives,
                        axis,
                        sums,
                        pitch,
                    },
                );
                c += 3;
            } else {
                let factors = std::array::from_fn(|n| [factor(n, c)]);
                let sums = &mut sums[start..start + axis];
                dispatch(
                    env.arch,
                    Accumulate {
                        factors,
                        rows,
                        derivatives,
                        axis,
                        sums,
                        pitch,
                    },
                );
                c += 1;
            }
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
