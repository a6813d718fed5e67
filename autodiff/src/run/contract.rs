//! The sum over a segment of a product, without the product in memory.
//!
//! The case that matters has a coefficient without axis (a few channels) and a row along the axis (one channel): the
//! accumulators of one segment stay in registers while its lanes stream by.

use pulp::Arch;

use super::block::{Env, Lanes, View, Worker};
use super::chunk::Span;
use super::rows::PARTIALS;
use super::segments::{collect, pieces};
use crate::graph::NodeId;
use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// Elements of a register tile.
const TILE: usize = 16;

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
                accumulate(env.arch, factors, rows, axis, sums, pitch);
            } else {
                let sums = &mut sums[sum_start..sum_start + axis];
                accumulate(env.arch, [factor(0)], rows, axis, sums, 0);
            }
            c += group;
        }
    }
}

/// `sums[c * pitch + k] += sum_lane factors[c][lane] rows[lane][k]`.
fn accumulate<R: Real, const C: usize>(
    arch: Arch,
    factors: [&[R]; C],
    rows: &[R],
    axis: usize,
    sums: &mut [R],
    pitch: usize,
) {
    dispatch(
        arch,
        Accumulate {
            factors,
            rows,
            axis,
            sums,
            pitch,
        },
    );
}

struct Accumulate<'a, R, const C: usize> {
    factors: [&'a [R]; C],
    rows: &'a [R],
    axis: usize,
    sums: &'a mut [R],
    pitch: usize,
}

impl<R: Real, const C: usize> Kernel for Accumulate<'_, R, C> {
    #[inline(always)]
    fn run<F: Fma>(mut self) {
        let mut k = 0;
        while k + 3 * TILE <= self.axis {
            self.tiles::<F, 3>(k);
            k += 3 * TILE;
        }
        while k + TILE <= self.axis {
            self.tiles::<F, 1>(k);
            k += TILE;
        }
        for k in k..self.axis {
            for c in 0..C {
                let sum = &mut self.sums[c * self.pitch + k];
                for (lane, row) in self.rows.chunks_exact(self.axis).enumerate() {
                    *sum = self.factors[c][lane].mul_add::<F>(row[k], *sum);
                }
            }
        }
    }
}

impl<R: Real, const C: usize> Accumulate<'_, R, C> {
    /// Columns `k .. k + T * TILE`, held in registers over all lanes.
    #[inline(always)]
    fn tiles<F: Fma, const T: usize>(&mut self, k: usize) {
        let mut sums = [[[R::default(); TILE]; T]; C];
        for c in 0..C {
            for t in 0..T {
                let start = c * self.pitch + k + t * TILE;
                sums[c][t].copy_from_slice(&self.sums[start..start + TILE]);
            }
        }
        let lanes = self.rows.len() / self.axis;
        let factors: [&[R]; C] = std::array::from_fn(|c| &self.factors[c][..lanes]);
        for lane in 0..lanes {
            let row = &self.rows[lane * self.axis + k..][..T * TILE];
            for c in 0..C {
                let factor = factors[c][lane];
                for t in 0..T {
                    for j in 0..TILE {
                        sums[c][t][j] = factor.mul_add::<F>(row[t * TILE + j], sums[c][t][j]);
                    }
                }
            }
        }
        for c in 0..C {
            for t in 0..T {
                let start = c * self.pitch + k + t * TILE;
                self.sums[start..start + TILE].copy_from_slice(&sums[c][t]);
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
    let (channels, axis) = (env.channels(id), env.axis(id));
    let all_parents = env.all_lanes(id);
    let (axis_t, axis_o) = (env.axis(target), env.axis(other));
    let slot = env.slot(target);
    let add = std::mem::replace(&mut worker.written[slot], true);
    let mut adjoint = std::mem::take(&mut worker.adjoints[slot]);
    let view = View {
        local: &worker.values,
        whole: env.values,
    };
    let single = env.channels(target) == 1;
    for c in 0..channels {
        let add = add || (single && c > 0);
        let channel = if single { 0 } else { c };
        let start = channel * env.stride * axis_t;
        let out = &mut adjoint.as_mut_slice()[start..start + lanes.len * axis_t];
        let other = env.channel(view, lanes, other, c);
        for piece in pieces(env, lanes) {
            let row = (c * all_parents + piece.parent) * axis;
            dispatch(
                env.arch,
                PullRow {
                    g: &g[row..row + axis],
                    other,
                    out,
                    axis_t,
                    axis_o,
                    first: piece.lanes.start - lanes.start,
                    last: piece.lanes.end - lanes.start,
                    add,
                },
            );
        }
    }
    worker.adjoints[slot] = adjoint;
}

struct PullRow<'a, R> {
    /// The adjoint of one parent's row.
    g: &'a [R],
    other: &'a [R],
    out: &'a mut [R],
    axis_t: usize,
    axis_o: usize,
    first: usize,
    last: usize,
    add: bool,
}

impl<R: Real> Kernel for PullRow<'_, R> {
    #[inline(always)]
    fn run<F: Fma>(self) {
        let (g, width) = (self.g, self.g.len());
        for lane in self.first..self.last {
            let other = &self.other[lane * self.axis_o..(lane + 1) * self.axis_o];
            let out = &mut self.out[lane * self.axis_t..(lane + 1) * self.axis_t];
            if self.axis_t == 1 {
                let sum = if self.axis_o == 1 {
                    g[0] * other[0]
                } else {
                    dot::<R, F>(g, other)
                };
                out[0] = if self.add { out[0] + sum } else { sum };
            } else if self.axis_o == 1 {
                let factor = other[0];
                if self.add {
                    for k in 0..width {
                        out[k] = factor.mul_add::<F>(g[k], out[k]);
                    }
                } else {
                    for k in 0..width {
                        out[k] = factor * g[k];
                    }
                }
            } else {
                for k in 0..width {
                    let product = other[k] * g[k];
                    out[k] = if self.add { out[k] + product } else { product };
                }
            }
        }
    }
}

/// Inner product in a fixed order, spread over partial sums.
#[inline(always)]
fn dot<R: Real, F: Fma>(a: &[R], b: &[R]) -> R {
    let mut sums = [R::default(); PARTIALS];
    let (mut xs, mut ys) = (a.chunks_exact(PARTIALS), b.chunks_exact(PARTIALS));
    for (x, y) in xs.by_ref().zip(ys.by_ref()) {
        for i in 0..PARTIALS {
            sums[i] = x[i].mul_add::<F>(y[i], sums[i]);
        }
    }
    let mut sum = super::rows::total(&sums);
    for (x, y) in xs.remainder().iter().zip(ys.remainder()) {
        sum = x.mul_add::<F>(*y, sum);
    }
    sum
}
