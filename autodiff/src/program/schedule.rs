//! Grouping nodes into phases.

use std::collections::BTreeMap;

use crate::graph::{Node, NodeId, Op};

/// Phases in the order of execution, and which values are kept whole.
pub(super) struct Schedule {
    pub groups: Vec<Group>,
    pub whole: Vec<bool>,
}

/// The nodes of a phase, in order.
pub(super) struct Group {
    pub domain: usize,
    pub nodes: Vec<NodeId>,
}

/// Assigns every computed node to a phase.
///
/// A node's level is the number of times that its operands had to be known for all lanes before. Nodes of one domain and
/// level make a phase. A node first takes the earliest level possible, then moves later, to the level of what uses it, so
/// that values do not have to be kept between phases. Dense layers stay: in a phase of few lanes, apart from sums over
/// segments, they are shared among threads, and the way back through those sums does not compute them again.
pub(super) fn schedule(nodes: &[Node], outputs: &[(String, NodeId)]) -> Schedule {
    let mut level = vec![0usize; nodes.len()];
    let mut users: Vec<Vec<(NodeId, bool)>> = vec![Vec::new(); nodes.len()];
    for (id, node) in nodes.iter().enumerate() {
        for (i, &input) in node.inputs.iter().enumerate() {
            if nodes[input].op.is_leaf() {
                continue;
            }
            let crosses = crosses(nodes, node, i);
            users[input].push((id, crosses));
            level[id] = level[id].max(level[input] + crosses as usize);
        }
    }
    let mut members: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (id, node) in nodes.iter().enumerate() {
        if is_block(node) {
            *members.entry((level[id], home(nodes, node))).or_default() += 1;
        }
    }
    for (id, node) in nodes.iter().enumerate().rev() {
        if !is_block(node) || users[id].is_empty() || matches!(node.op, Op::Matmul) {
            continue;
        }
        let latest = users[id]
            .iter()
            .map(|&(user, crosses)| level[user] - crosses as usize)
            .min()
            .unwrap_or(level[id]);
        let domain = home(nodes, node);
        let target = (level[id] + 1..=latest)
            .rev()
            .find(|&l| members.get(&(l, domain)).is_some_and(|&n| n > 0));
        if let Some(target) = target {
            *members.entry((level[id], domain)).or_default() -= 1;
            *members.entry((target, domain)).or_default() += 1;
            level[id] = target;
        }
    }
    let mut groups: BTreeMap<(usize, usize, usize), Vec<NodeId>> = BTreeMap::new();
    for (id, node) in nodes.iter().enumerate() {
        if node.op.is_leaf() {
            continue;
        }
        // A linear map is a phase of its own.
        let alone = if is_block(node) { 0 } else { id + 1 };
        groups
            .entry((level[id], home(nodes, node), alone))
            .or_default()
            .push(id);
    }
    let groups: Vec<Group> = groups
        .into_iter()
        .map(|((_, domain, _), nodes)| Group { domain, nodes })
        .collect();
    let mut phase = vec![usize::MAX; nodes.len()];
    for (index, group) in groups.iter().enumerate() {
        for &id in &group.nodes {
            phase[id] = index;
        }
    }
    let whole = (0..nodes.len())
        .map(|id| {
            let node = &nodes[id];
            node.op.is_leaf()
                || node.op.is_sink()
                || !is_block(node)
                || outputs.iter().any(|(_, output)| *output == id)
                || users[id]
                    .iter()
                    .any(|&(user, crosses)| crosses || phase[user] != phase[id])
        })
        .collect();
    Schedule { groups, whole }
}

/// The domain over whose lanes a node is computed.
fn home(nodes: &[Node], node: &Node) -> usize {
    if node.op.is_sink() {
        nodes[node.inputs[0]].shape.domain
    } else {
        node.shape.domain
    }
}

fn is_block(node: &Node) -> bool {
    !node.op.is_leaf() && !matches!(node.op, Op::Map(_))
}

/// Whether operand `i` must be whole before the node's phase.
fn crosses(nodes: &[Node], node: &Node, i: usize) -> bool {
    let input = &nodes[node.inputs[i]];
    node.op.reads_whole(i) || input.op.is_sink() || matches!(input.op, Op::Map(_))
}
