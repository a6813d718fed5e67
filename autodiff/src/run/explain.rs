//! What a program spends time and memory on.

use std::fmt;
use std::time::{Duration, Instant};

use super::walk::{Observer, Way};
use super::workspace::Workspace;
use crate::error::RunError;
use crate::graph::NodeId;
use crate::program::{Body, NONE, Program};
use crate::real::Scalar;

/// Time and memory of one node of a program.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeCost {
    /// The label of the value, or its operation and place in the source.
    pub name: String,
    /// The operation.
    pub op: &'static str,
    /// Domain, channels and axis: `sample x 3 x frame`.
    pub shape: String,
    /// The phase that computes it, in the order of execution; none for leaves.
    pub phase: Option<usize>,
    /// Time to compute its value.
    pub forward: Duration,
    /// Time to compute it again and to pass its adjoint on.
    pub reverse: Duration,
    /// Bytes of the value for all lanes; 0 if it lives in a block's arena only.
    pub whole_bytes: usize,
    /// Bytes that it takes in the arena of one thread.
    pub arena_bytes: usize,
}

/// Time and memory of all nodes, in the order of execution.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// One entry for each node that is left after simplification.
    pub nodes: Vec<NodeCost>,
}

impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:>5} {:>11} {:>11} {:>9} {:>9}  operation",
            "phase", "forward us", "reverse us", "whole KiB", "arena KiB"
        )?;
        for node in &self.nodes {
            let phase = node
                .phase
                .map_or("-".to_string(), |phase| phase.to_string());
            writeln!(
                f,
                "{phase:>5} {:>11.1} {:>11.1} {:>9.1} {:>9.1}  {} ({})",
                node.forward.as_secs_f64() * 1e6,
                node.reverse.as_secs_f64() * 1e6,
                node.whole_bytes as f64 / 1024.0,
                node.arena_bytes as f64 / 1024.0,
                node.name,
                node.shape
            )?;
        }
        Ok(())
    }
}

/// Adds up time by node.
struct Clock {
    forward: Vec<Duration>,
    reverse: Vec<Duration>,
}

impl<R> Observer<R> for Clock {
    fn around(&mut self, id: NodeId, way: Way, work: &mut dyn FnMut()) {
        let start = Instant::now();
        work();
        let spent = match way {
            Way::Forward => &mut self.forward[id],
            Way::Reverse => &mut self.reverse[id],
        };
        *spent += start.elapsed();
    }
}

impl Program {
    /// Measures every node of a gradient of `output`, one after another on one thread. The sum is more than a gradient takes:
    /// elementwise operations otherwise run together, tile by tile.
    ///
    /// # Errors
    /// As [`Program::vjp`].
    pub fn explain<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        output: &str,
    ) -> Result<Explanation, RunError> {
        self.vjp(ws, output)?;
        let mut clock = Clock {
            forward: vec![Duration::ZERO; self.nodes.len()],
            reverse: vec![Duration::ZERO; self.nodes.len()],
        };
        S::walk(&mut ws.state, self, &mut clock);
        let leaves =
            (0..self.nodes.len()).filter(|&id| self.nodes[id].op.is_leaf() && self.used[id]);
        let computed = self.phases.iter().enumerate();
        let computed =
            computed.flat_map(|(p, phase)| phase.nodes.iter().map(move |&id| (Some(p), id)));
        let cost = |(phase, id): (Option<usize>, NodeId)| {
            let node = &self.nodes[id];
            let arena = phase.filter(|&p| {
                matches!(self.phases[p].body, Body::Block) && self.phases[p].slot[id] != NONE
            });
            NodeCost {
                name: self.node_name(id),
                op: node.op.name(),
                shape: self.shape_text(node.shape),
                phase,
                forward: clock.forward[id],
                reverse: clock.reverse[id],
                whole_bytes: match self.whole[id] {
                    true => ws.state.len(id) * size_of::<S>(),
                    false => 0,
                },
                arena_bytes: arena.map_or(0, |p| ws.state.arena_len(self, p, id) * size_of::<S>()),
            }
        };
        Ok(Explanation {
            nodes: leaves
                .map(|id| (None, id))
                .chain(computed)
                .map(cost)
                .collect(),
        })
    }
}
