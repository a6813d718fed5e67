//! The way from an output that is not finite back to where that began.

use std::ops::Range;

use super::block::{Env, Lanes, View, is_constant};
use super::driver::{State, lock};
use super::inspect::NonFinite;
use super::lane::Lane;
use super::passes::fill_constants;
use super::value::{value, values};
use crate::graph::{NodeId, Op};
use crate::op::Element;
use crate::program::Program;

/// One element of a node.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    pub id: NodeId,
    pub channel: usize,
    pub lane: usize,
    pub position: usize,
}

/// Some elements of a node.
struct Region {
    id: NodeId,
    channels: Range<usize>,
    lanes: Range<usize>,
    positions: Range<usize>,
}

impl Spot {
    fn region(self) -> Region {
        Region {
            id: self.id,
            channels: self.channel..self.channel + 1,
            lanes: self.lane..self.lane + 1,
            positions: self.position..self.position + 1,
        }
    }

    fn of(self, id: NodeId) -> Spot {
        Spot { id, ..self }
    }
}

impl<R: Lane> State<R> {
    /// Where the first element of an output that is not finite comes from. All values have been computed.
    pub(super) fn find_non_finite(&self, program: &Program) -> Option<NonFinite> {
        let mut outputs = program.outputs.iter();
        let mut at =
            outputs.find_map(|&(_, id)| self.find(program, self.whole_region(program, id)))?;
        while let Some(before) = self.cause(program, at) {
            at = before;
        }
        Some(NonFinite {
            origin: program.node_name(at.id),
            lane: at.lane,
            channel: at.channel,
            position: at.position,
            value: self.element(program, at)?,
            operands: self.operands(program, at),
        })
    }

    /// An operand's element that is not finite, and that the element at `at` took in.
    fn cause(&self, program: &Program, at: Spot) -> Option<Spot> {
        let node = &program.nodes[at.id];
        let inputs = &node.inputs;
        let first = *inputs.first()?;
        let operand = |id: NodeId| {
            let single = program.nodes[id].shape.channels == 1;
            let channel = if single { 0 } else { at.channel };
            Spot {
                channel,
                ..at.of(id)
            }
        };
        let find = |region: Region| self.find(program, region);
        let bad = |spot: Spot| find(spot.region());
        match &node.op {
            Op::Element(Element::Select) => {
                let mask = self.element(program, operand(first))?;
                bad(operand(inputs[if mask == 0.0 { 2 } else { 1 }]))
            }
            Op::Element(Element::Min | Element::Max) => {
                let result = self.element(program, at)?;
                let chosen = |spot: &Spot| {
                    let x = self.element(program, *spot);
                    x.is_some_and(|x| x == result || (x.is_nan() && result.is_nan()))
                };
                inputs.iter().map(|&id| operand(id)).find(chosen)
            }
            Op::Channel(c) => bad(Spot {
                channel: *c,
                ..at.of(first)
            }),
            Op::Stack => {
                let mut channel = at.channel;
                for &part in inputs {
                    let channels = program.nodes[part].shape.channels;
                    if channel < channels {
                        return bad(Spot {
                            channel,
                            ..at.of(part)
                        });
                    }
                    channel -= channels;
                }
                None
            }
            Op::SumChannels => find(Region {
                channels: 0..program.nodes[first].shape.channels,
                ..at.of(first).region()
            }),
            Op::SumAxis | Op::MaxAxis => find(Region {
                positions: 0..self.extent.axis(program.nodes[first].shape.axis),
                ..at.of(first).region()
            }),
            Op::Splat => bad(Spot {
                lane: 0,
                ..at.of(first)
            }),
            Op::Repeat => bad(Spot {
                position: 0,
                ..at.of(first)
            }),
            Op::Expand => {
                let segments = self.extent.segments[node.shape.domain].as_ref()?;
                let lane = segments.parent(at.lane);
                bad(Spot {
                    lane,
                    ..at.of(first)
                })
            }
            Op::Gather(index) => {
                let lane = self.indices[*index][at.lane] as usize;
                bad(Spot {
                    lane,
                    ..at.of(first)
                })
            }
            Op::GatherWeighted(indices) => {
                indices.iter().zip(&inputs[1..]).find_map(|(i, &weight)| {
                    let lane = self.indices[*i][at.lane] as usize;
                    let of_weight = Spot {
                        channel: 0,
                        position: 0,
                        ..at.of(weight)
                    };
                    bad(of_weight).or_else(|| {
                        bad(Spot {
                            lane,
                            ..at.of(first)
                        })
                    })
                })
            }
            Op::SegmentSum { .. } | Op::SegmentDot | Op::SumLanes => {
                let domain = program.nodes[first].shape.domain;
                let lanes = match (&node.op, &self.extent.segments[domain]) {
                    (Op::SumLanes, _) | (_, None) => 0..self.extent.lanes[domain],
                    (_, Some(segments)) => {
                        let (start, end) = segments.bounds(at.lane);
                        start..end
                    }
                };
                inputs.iter().find_map(|&id| {
                    let along = program.nodes[id].shape.axis.is_some();
                    let spot = operand(id);
                    find(Region {
                        lanes: lanes.clone(),
                        ..Spot {
                            position: if along { at.position } else { 0 },
                            ..spot
                        }
                        .region()
                    })
                })
            }
            Op::Map(_) => find(Region {
                lanes: 0..self.extent.lanes[program.nodes[first].shape.domain],
                ..at.of(first).region()
            }),
            Op::Matmul => {
                let inner = program.nodes[first].shape.channels;
                let of_lane = Region {
                    channels: 0..inner,
                    ..at.of(first).region()
                };
                let uniform = Spot { lane: 0, ..at };
                let row = Region {
                    channels: at.channel * inner..(at.channel + 1) * inner,
                    ..uniform.of(inputs[1]).region()
                };
                let bias = || bad(uniform.of(*inputs.get(2)?));
                find(of_lane).or_else(|| find(row)).or_else(bias)
            }
            _ => inputs.iter().find_map(|&id| bad(operand(id))),
        }
    }

    fn whole_region(&self, program: &Program, id: NodeId) -> Region {
        let shape = program.nodes[id].shape;
        Region {
            id,
            channels: 0..shape.channels,
            lanes: 0..self.extent.lanes[shape.domain],
            positions: 0..self.extent.axis(shape.axis),
        }
    }

    /// The first element of a region that is not finite.
    fn find(&self, program: &Program, region: Region) -> Option<Spot> {
        let axis = self.extent.axis(program.nodes[region.id].shape.axis);
        let mut found = None;
        self.read(program, &region, |channel, lane, rows| {
            for (k, row) in rows.chunks_exact(axis).enumerate() {
                let mut bad = region.positions.clone().filter(|&p| !row[p].is_finite());
                if let Some(position) = bad.next() {
                    found = Some(Spot {
                        id: region.id,
                        channel,
                        lane: lane + k,
                        position,
                    });
                    return true;
                }
            }
            false
        });
        found
    }

    /// The value of an element.
    fn element(&self, program: &Program, at: Spot) -> Option<f64> {
        let mut value = None;
        self.read(program, &at.region(), |_, _, row| {
            value = Some(row[at.position].to_f64());
            true
        });
        value
    }

    /// Calls `see` with a channel, the first of some lanes, and their rows, until it has seen enough.
    fn read(
        &self,
        program: &Program,
        region: &Region,
        mut see: impl FnMut(usize, usize, &[R]) -> bool,
    ) {
        let shape = program.nodes[region.id].shape;
        let (all, axis) = (
            self.extent.lanes[shape.domain],
            self.extent.axis(shape.axis),
        );
        if program.whole[region.id] {
            let array = self.values[region.id].as_slice();
            for channel in region.channels.clone() {
                let first = channel * all;
                let (start, end) = (first + region.lanes.start, first + region.lanes.end);
                if see(
                    channel,
                    region.lanes.start,
                    &array[start * axis..end * axis],
                ) {
                    return;
                }
            }
            return;
        }
        let computes = |p: &usize| program.phases[*p].nodes.contains(&region.id);
        let Some(p) = (0..program.phases.len()).find(computes) else {
            return;
        };
        for start in region.lanes.clone().step_by(self.strides[p]) {
            let lanes = Lanes {
                start,
                len: self.strides[p].min(region.lanes.end - start),
            };
            let enough = self.compute(program, p, lanes, |env, view| {
                let mut channels = region.channels.clone();
                channels.any(|c| see(c, start, env.channel(view, lanes, region.id, c)))
            });
            if enough {
                return;
            }
        }
    }

    /// Computes all values of a phase for some lanes.
    fn compute(
        &self,
        program: &Program,
        p: usize,
        lanes: Lanes,
        read: impl FnOnce(&Env<R>, View<R>) -> bool,
    ) -> bool {
        let mut workers = lock(&self.workers);
        let Some(worker) = workers.first_mut() else {
            return false;
        };
        let env = self.env(program, p);
        fill_constants(&env, worker, |_| true);
        for &id in &env.phase.nodes {
            let op = &program.nodes[id].op;
            if !op.is_sink() && !is_constant(op) {
                value(&env, worker, lanes, id);
            }
        }
        read(&env, values(&env, worker))
    }

    /// Names and values of the operands of an element, as far as they lie where it does.
    pub(super) fn operands(&self, program: &Program, at: Spot) -> Vec<(String, f64)> {
        let node = &program.nodes[at.id];
        let aligned = |(i, id): (usize, &NodeId)| {
            let shape = program.nodes[*id].shape;
            let same = shape.domain == node.shape.domain && shape.axis == node.shape.axis;
            let known = same && !node.op.reads_whole(i) && !node.op.is_sink();
            let channel = at.channel.min(shape.channels - 1);
            let value = || {
                self.element(
                    program,
                    Spot {
                        channel,
                        ..at.of(*id)
                    },
                )
            };
            Some((program.node_name(*id), value().filter(|_| known)?))
        };
        node.inputs.iter().enumerate().filter_map(aligned).collect()
    }
}
