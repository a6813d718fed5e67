//! Where a NaN or an infinity comes from.

use std::fmt;
use std::sync::PoisonError;

use super::block::{Env, Lanes, Worker, blocks, is_constant};
use super::driver::State;
use super::lane::Lane;
use super::passes::fill_constants;
use super::value::{value, values};
use super::workspace::Workspace;
use crate::error::RunError;
use crate::graph::{NodeId, Op, Shape};
use crate::program::{Body, Program};
use crate::real::Scalar;

/// The first value of a run that is not finite, in the order of computation.
#[derive(Clone, Debug, PartialEq)]
pub struct NonFinite {
    /// The label of the value, or its operation and place in the source.
    pub origin: String,
    /// Lane of its domain.
    pub lane: usize,
    /// Channel.
    pub channel: usize,
    /// Position along the inner axis.
    pub position: usize,
    /// The value.
    pub value: f64,
    /// Labels and values of its operands at that lane; empty where an operation combines lanes, and for bound arrays.
    pub operands: Vec<(String, f64)>,
}

impl fmt::Display for NonFinite {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "`{}` is {} at lane {}, channel {}, position {}",
            self.origin, self.value, self.lane, self.channel, self.position
        )?;
        for (i, (name, value)) in self.operands.iter().enumerate() {
            let lead = if i == 0 { ", from" } else { " and" };
            write!(f, "{lead} `{name}` = {value}")?;
        }
        Ok(())
    }
}

impl Program {
    /// Computes all outputs, and finds the first value that is not finite, if any: bound arrays first, then results in the
    /// order of computation. For debugging: runs on one thread.
    ///
    /// # Errors
    /// As [`Program::forward`].
    pub fn find_non_finite<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
    ) -> Result<Option<NonFinite>, RunError> {
        self.forward(ws)?;
        Ok(S::find_non_finite(&mut ws.state, self))
    }
}

impl<R: Lane> State<R> {
    pub(super) fn find_non_finite(&mut self, program: &Program) -> Option<NonFinite> {
        for (id, node) in program.nodes.iter().enumerate() {
            if node.op.is_leaf() && program.used[id] {
                let found = self.inspect_whole(program, id);
                if found.is_some() {
                    return found;
                }
            }
        }
        for p in 0..program.phases.len() {
            let phase = &program.phases[p];
            if let Body::Block = phase.body {
                let found = self.inspect_phase(program, p);
                if found.is_some() {
                    return found;
                }
            }
            for &id in &phase.nodes {
                let op = &program.nodes[id].op;
                let found = match op.is_sink() || matches!(op, Op::Map(_)) {
                    true => self.inspect_whole(program, id),
                    false => None,
                };
                if found.is_some() {
                    return found;
                }
            }
        }
        None
    }

    fn inspect_whole(&self, program: &Program, id: NodeId) -> Option<NonFinite> {
        let shape = program.nodes[id].shape;
        let (lanes, axis) = (
            self.extent.lanes[shape.domain],
            self.extent.axis(shape.axis),
        );
        let array = self.values[id].as_slice();
        let at = array.iter().position(|x| !x.is_finite())?;
        Some(NonFinite {
            origin: program.node_name(id),
            lane: at / axis % lanes,
            channel: at / axis / lanes,
            position: at % axis,
            value: array[at].to_f64(),
            operands: Vec::new(),
        })
    }

    fn inspect_phase(&mut self, program: &Program, p: usize) -> Option<NonFinite> {
        let mut found = None;
        let mut workers = std::mem::take(&mut self.workers);
        if let Some(worker) = workers.first_mut() {
            let env = self.env(program, p);
            for chunk in &self.chunks[p] {
                let chunk = chunk.lock().unwrap_or_else(PoisonError::into_inner);
                fill_constants(&env, worker, |_| true);
                found =
                    blocks(&chunk, env.stride).find_map(|lanes| inspect_block(&env, worker, lanes));
                if found.is_some() {
                    break;
                }
            }
        }
        self.workers = workers;
        found
    }
}

/// Computes a block, stopping at the first value that is not finite.
fn inspect_block<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes) -> Option<NonFinite> {
    for &id in &env.phase.nodes {
        let node = &env.program.nodes[id];
        if node.op.is_sink() || is_constant(&node.op) {
            continue;
        }
        value(env, worker, lanes, id);
        let view = values(env, worker);
        let axis = env.axis(id);
        for channel in 0..env.channels(id) {
            let row = env.channel(view, lanes, id, channel);
            let Some(at) = row.iter().position(|x| !x.is_finite()) else {
                continue;
            };
            let aligned = |shape: Shape| shape.domain == node.shape.domain;
            let operands = node.inputs.iter().enumerate().filter_map(|(i, &input)| {
                let known = aligned(env.program.nodes[input].shape) && !node.op.reads_whole(i);
                if !known || env.axis(input) != axis {
                    return None;
                }
                let value =
                    env.channel(view, lanes, input, channel.min(env.channels(input) - 1))[at];
                Some((env.program.node_name(input), value.to_f64()))
            });
            return Some(NonFinite {
                origin: env.program.node_name(id),
                lane: lanes.start + at / axis,
                channel,
                position: at % axis,
                value: row[at].to_f64(),
                operands: operands.collect(),
            });
        }
    }
    None
}
