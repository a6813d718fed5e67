//! One phase: nodes of one domain, executed block by block.

use super::runs::{Run, Step, group};
use super::schedule::Group;
use crate::graph::{Node, NodeId, Op};

/// No slot.
pub(crate) const NONE: u32 = u32::MAX;

/// Nodes of one domain that run together.
pub(crate) struct Phase {
    pub domain: usize,
    pub body: Body,
    /// Nodes in order of execution.
    pub nodes: Vec<NodeId>,
    /// The same, elementwise nodes in runs.
    pub steps: Vec<Step>,
    pub runs: Vec<Run>,
    /// Slot in the block arena of each node of the program, or [`NONE`].
    pub slot: Vec<u32>,
    /// Nodes that have a slot: those computed here, then operands of the same domain that are whole already.
    pub locals: Vec<NodeId>,
    /// How many of `locals` are computed here.
    pub computed: usize,
    /// Nodes of `locals` whose values are kept whole.
    pub stores: Vec<NodeId>,
    /// Accumulations over lanes.
    pub sinks: Vec<NodeId>,
    /// Where adjoints of whole operands are accumulated.
    pub pulls: Vec<Pull>,
}

/// How a phase runs.
pub(crate) enum Body {
    /// Block by block.
    Block,
    /// One linear map of a whole array.
    Map,
}

/// The accumulation of an adjoint of a whole value.
///
/// Each user of a table or matrix has its own: their shares of one accumulation would interleave block by block, and the
/// order of additions must not depend on blocks.
pub(crate) struct Pull {
    pub target: NodeId,
    /// The node whose operand the target is.
    pub user: NodeId,
    pub kind: PullKind,
}

impl Pull {
    /// Whether it is of this operand of `user`.
    pub fn is(&self, target: NodeId, user: NodeId) -> bool {
        (self.target, self.user) == (target, user)
    }
}

/// Which lanes of the target a chunk of lanes contributes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PullKind {
    /// The same lanes.
    Lanes,
    /// The parents of the chunk's lanes.
    Parents,
    /// Any lane: a scatter.
    Table,
    /// The only lane.
    Uniform,
    /// The only lane, of a matrix.
    Weight,
}

impl Phase {
    pub(super) fn new(nodes: &[Node], members: &Group, whole: &[bool]) -> Phase {
        let mut order = members.nodes.clone();
        let (steps, runs) = group(nodes, whole, &mut order);
        let mut phase = Phase {
            domain: members.domain,
            body: Body::Block,
            nodes: order,
            steps,
            runs,
            slot: vec![NONE; nodes.len()],
            locals: Vec::new(),
            computed: 0,
            stores: Vec::new(),
            sinks: Vec::new(),
            pulls: Vec::new(),
        };
        if matches!(nodes[phase.nodes[0]].op, Op::Map(_)) {
            phase.body = Body::Map;
            return phase;
        }
        for &id in &members.nodes {
            if nodes[id].op.is_sink() {
                phase.sinks.push(id);
                continue;
            }
            phase.add_local(id);
            if whole[id] {
                phase.stores.push(id);
            }
        }
        phase.computed = phase.locals.len();
        for &id in &members.nodes {
            let node = &nodes[id];
            for (i, &input) in node.inputs.iter().enumerate() {
                let kind = match node.op {
                    Op::Splat => PullKind::Uniform,
                    Op::Expand => PullKind::Parents,
                    Op::Matmul if i == 1 => PullKind::Weight,
                    Op::Matmul if i == 2 => PullKind::Uniform,
                    Op::Gather(_) | Op::GatherWeighted(_) if i == 0 => PullKind::Table,
                    _ => {
                        if phase.slot[input] != NONE {
                            continue;
                        }
                        phase.add_local(input);
                        PullKind::Lanes
                    }
                };
                if nodes[input].active {
                    phase.add_pull(input, kind, id);
                }
            }
        }
        phase
    }

    fn add_local(&mut self, id: NodeId) {
        self.slot[id] = self.locals.len() as u32;
        self.locals.push(id);
    }

    fn add_pull(&mut self, target: NodeId, kind: PullKind, user: NodeId) {
        if self.pull(target, kind, user).is_none() {
            self.pulls.push(Pull { target, user, kind });
        }
    }

    /// Position in `pulls` of the accumulation of an operand of `user`.
    pub fn pull(&self, target: NodeId, kind: PullKind, user: NodeId) -> Option<usize> {
        self.pulls
            .iter()
            .position(|pull| (pull.target, pull.kind, pull.user) == (target, kind, user))
    }
}
