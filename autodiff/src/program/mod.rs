//! The compiled program: an immutable schedule of phases, shared between threads and workspaces.

mod fuse;
mod phase;
mod runs;
mod schedule;
mod simplify;

use std::sync::atomic::{AtomicU64, Ordering};

pub(crate) use fuse::Fusion;
pub(crate) use phase::{Body, NONE, Phase, Pull, PullKind};
pub(crate) use runs::{LIMIT, Run, Step};

use crate::graph::{DomainInfo, IndexInfo, Node, NodeId, Op, Recording, Shape};

/// A compiled graph: immutable, `Send + Sync`, independent of sizes and of the scalar type.
///
/// Nodes are grouped into *phases*, one domain each. Within a phase, blocks of lanes run through all its nodes in a small
/// arena; only values that another phase needs, and the outputs, are kept whole. Reverse mode runs the phases backwards and
/// recomputes each block's values (checkpointing at phase boundaries).
pub struct Program {
    pub(crate) stamp: u64,
    pub(crate) nodes: Vec<Node>,
    pub(crate) domains: Vec<DomainInfo>,
    pub(crate) axes: Vec<String>,
    pub(crate) indices: Vec<IndexInfo>,
    pub(crate) outputs: Vec<(String, NodeId)>,
    pub(crate) phases: Vec<Phase>,
    /// Phases whose gradients can be computed together.
    pub(crate) fusions: Vec<Fusion>,
    /// Nodes whose value is kept for all lanes.
    pub(crate) whole: Vec<bool>,
    /// Nodes that outputs need; leaves that none needs may stay unbound.
    pub(crate) used: Vec<bool>,
    /// Index arrays that outputs need.
    pub(crate) used_indices: Vec<bool>,
}

impl Program {
    pub(crate) fn new(
        recording: &Recording,
        outputs: Vec<(String, NodeId)>,
        simplify: bool,
    ) -> Program {
        static STAMP: AtomicU64 = AtomicU64::new(0);
        let (recorded, outputs) = match simplify {
            true => simplify::simplify(recording.nodes.clone(), outputs),
            false => (recording.nodes.clone(), outputs),
        };
        let (nodes, used, outputs) = prune(&recorded, outputs);
        let mut used_indices = vec![false; recording.indices.len()];
        for node in &nodes {
            match &node.op {
                Op::Gather(index) => used_indices[*index] = true,
                Op::GatherWeighted(indices) => indices.iter().for_each(|&i| used_indices[i] = true),
                _ => {}
            }
        }
        let schedule = schedule::schedule(&nodes, &outputs);
        let phases: Vec<Phase> = schedule
            .groups
            .iter()
            .map(|group| Phase::new(&nodes, group, &schedule.whole))
            .collect();
        let fusions = fuse::fusions(&nodes, &recording.domains, &phases);
        Program {
            stamp: STAMP.fetch_add(1, Ordering::Relaxed),
            nodes,
            domains: recording.domains.clone(),
            axes: recording.axes.clone(),
            indices: recording.indices.clone(),
            outputs,
            phases,
            fusions,
            whole: schedule.whole,
            used,
            used_indices,
        }
    }

    /// Names of the parameters, in the order of declaration.
    pub fn params(&self) -> impl Iterator<Item = &str> {
        self.nodes
            .iter()
            .filter(|node| matches!(node.op, Op::Param))
            .filter_map(|node| node.name.as_deref())
    }

    /// A shape in words.
    pub(crate) fn shape_text(&self, shape: Shape) -> String {
        let recording = Recording {
            domains: self.domains.clone(),
            axes: self.axes.clone(),
            ..Recording::default()
        };
        recording.shape_text(shape)
    }

    /// A node's label, or its operation and place in the source.
    pub(crate) fn node_name(&self, id: NodeId) -> String {
        let node = &self.nodes[id];
        match node.called() {
            Some(name) => name.to_string(),
            None => format!("{} at {}", node.op.name(), node.location),
        }
    }
}

/// Keeps what the outputs need, and all leaves: an unused parameter has a gradient of zero. Also tells which are needed.
fn prune(
    recorded: &[Node],
    outputs: Vec<(String, NodeId)>,
) -> (Vec<Node>, Vec<bool>, Vec<(String, NodeId)>) {
    let mut needed = vec![false; recorded.len()];
    for (_, id) in &outputs {
        needed[*id] = true;
    }
    for id in (0..recorded.len()).rev() {
        if needed[id] {
            for &input in &recorded[id].inputs {
                needed[input] = true;
            }
        }
    }
    let mut position = vec![0; recorded.len()];
    let (mut nodes, mut used): (Vec<Node>, Vec<bool>) = Default::default();
    for (id, node) in recorded.iter().enumerate() {
        if !needed[id] && !node.op.is_leaf() {
            continue;
        }
        position[id] = nodes.len();
        let mut node = node.clone();
        node.inputs.iter_mut().for_each(|i| *i = position[*i]);
        nodes.push(node);
        used.push(needed[id]);
    }
    let outputs = outputs
        .into_iter()
        .map(|(name, id)| (name, position[id]))
        .collect();
    (nodes, used, outputs)
}
