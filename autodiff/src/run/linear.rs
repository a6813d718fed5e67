//! Operations that are linear in one operand and keep the domain: channels, stacks, sums, repeats, splats.

use super::block::{Env, Lanes, View, Worker, into_adjoint};
use super::rows::{PARTIALS, add_partials, put, put_value, sum_row};
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::real::Real;

/// The result of a linear operation on values, or on tangents; operands whose tangent is zero are left out by `present`.
pub(super) fn push<R: Real>(
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
    let out = out.as_mut_slice();
    let input = node.inputs[0];
    match node.op {
        Op::Channel(c) => out[..len].copy_from_slice(env.channel(view, lanes, input, c)),
        Op::Detach => {
            for c in 0..node.shape.channels {
                let out = &mut out[c * pitch..c * pitch + len];
                let source = env.channel(view, lanes, input, c);
                if R::PACKED {
                    out.copy_from_slice(source);
                } else {
                    out.iter_mut().zip(source).for_each(|(y, x)| *y = held(*x));
                }
            }
        }
        Op::Stack => {
            let mut target = 0;
            for &part in &node.inputs {
                for c in 0..env.channels(part) {
                    let row = &mut out[target * pitch..target * pitch + len];
                    if present(part) {
                        row.copy_from_slice(env.channel(view, lanes, part, c));
                    } else {
                        row.fill(R::default());
                    }
                    target += 1;
                }
            }
        }
        Op::SumChannels => {
            for c in 0..env.channels(input) {
                let source = env.channel(view, lanes, input, c);
                put(env.arch, &mut out[..len], source, c > 0);
            }
        }
        Op::SumAxis => {
            let width = env.axis(input);
            for c in 0..node.shape.channels {
                let source = env.channel(view, lanes, input, c);
                for lane in 0..lanes.len {
                    out[c * pitch + lane] =
                        sum_row(env.arch, &source[lane * width..(lane + 1) * width]);
                }
            }
        }
        Op::MaxAxis => {
            let width = env.axis(input);
            for c in 0..node.shape.channels {
                let source = env.channel(view, lanes, input, c);
                for lane in 0..lanes.len {
                    let row = &source[lane * width..(lane + 1) * width];
                    let largest = |largest: R, x: &R| if *x > largest { *x } else { largest };
                    let first = row.first().copied().unwrap_or_default();
                    out[c * pitch + lane] = held(row.iter().fold(first, largest));
                }
            }
        }
        Op::Repeat => {
            for c in 0..node.shape.channels {
                let source = env.channel(view, lanes, input, c);
                for (lane, value) in source.iter().enumerate() {
                    let start = c * pitch + lane * axis;
                    out[start..start + axis].fill(*value);
                }
            }
        }
        Op::Splat => {
            let source = view.whole[input].as_slice();
            for c in 0..node.shape.channels {
                let row = &source[c * axis..(c + 1) * axis];
                // The whole stride, since one fill serves all blocks of a chunk.
                let target = &mut out[c * pitch..(c + 1) * pitch];
                if axis == 1 {
                    target.fill(row[0]);
                } else {
                    target
                        .chunks_exact_mut(axis)
                        .for_each(|t| t.copy_from_slice(row));
                }
            }
        }
        _ => {}
    }
}

/// A number as a constant: derivatives hold still what is detached, second ones too.
#[inline(always)]
fn held<R: Real>(x: R) -> R {
    R::from_f64(x.to_f64())
}

/// The transpose: from the adjoint `g` of the result to those of the operands.
pub(super) fn pull<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let node = &env.program.nodes[id];
    let (pitch, axis) = (env.pitch(id), env.axis(id));
    let len = lanes.len * axis;
    let input = node.inputs[0];
    match node.op {
        Op::Channel(c) => into_adjoint(env, worker, input, |target, add| {
            if !add {
                for other in 0..env.channels(input) {
                    target[other * pitch..other * pitch + len].fill(R::default());
                }
            }
            put(
                env.arch,
                &mut target[c * pitch..c * pitch + len],
                &g[..len],
                true,
            );
        }),
        Op::Stack => {
            let mut source = 0;
            for &part in &node.inputs {
                let channels = env.channels(part);
                if env.live[part] {
                    into_adjoint(env, worker, part, |target, add| {
                        for c in 0..channels {
                            let from = (source + c) * pitch;
                            let target = &mut target[c * pitch..c * pitch + len];
                            put(env.arch, target, &g[from..from + len], add);
                        }
                    });
                }
                source += channels;
            }
        }
        Op::SumChannels => into_adjoint(env, worker, input, |target, add| {
            for c in 0..env.channels(input) {
                put(
                    env.arch,
                    &mut target[c * pitch..c * pitch + len],
                    &g[..len],
                    add,
                );
            }
        }),
        Op::SumAxis => into_adjoint(env, worker, input, |target, add| {
            let width = env.axis(input);
            for c in 0..node.shape.channels {
                for lane in 0..lanes.len {
                    let start = (c * env.stride + lane) * width;
                    put_value(&mut target[start..start + width], g[c * pitch + lane], add);
                }
            }
        }),
        Op::Repeat => into_adjoint(env, worker, input, |target, add| {
            for c in 0..node.shape.channels {
                for lane in 0..lanes.len {
                    let start = c * pitch + lane * axis;
                    let sum = sum_row(env.arch, &g[start..start + axis]);
                    let target = &mut target[c * env.stride + lane];
                    *target = if add { *target + sum } else { sum };
                }
            }
        }),
        _ => {}
    }
}

/// Adds one channel of a block to a running sum over a chunk: partial sums without an axis, a row with one.
/// `first` is the position of the block in the chunk.
pub(super) fn add_lanes<R: Real>(
    env: &Env<R>,
    channel: usize,
    axis: usize,
    first: usize,
    source: &[R],
    sums: &mut [R],
) {
    if axis == 1 {
        let partial = &mut sums[channel * PARTIALS..(channel + 1) * PARTIALS];
        add_partials(env.arch, partial, first, source);
    } else {
        let sum = &mut sums[channel * axis..(channel + 1) * axis];
        for row in source.chunks_exact(axis) {
            put(env.arch, sum, row, true);
        }
    }
}
