//! Which phases can run forward and back in one go.
//!
//! The adjoint of a loss that is a sum over all lanes is known before any lane is computed. The adjoint of a sum over a segment
//! is often known as soon as the segment's own lanes are: a loss compares each pixel with its photograph, and with nothing
//! else. Then a block, of whole segments, runs forward, through the phase that reads its sums, and back, while its values are
//! at hand: nothing is computed twice, and inputs are read from memory once.

use super::{Body, Phase, PullKind};
use crate::graph::{DomainInfo, Node, NodeId, Op};

/// A phase, and the phase over its parents that reads its sums, if any does.
pub(crate) struct Fusion {
    pub inner: usize,
    pub outer: Option<usize>,
    /// The sums that `outer` reads.
    pub sums: Vec<NodeId>,
    /// What must not be live: readers of the inner phase's values before the outer one, and other accumulations of segments,
    /// whose adjoints are not known in time.
    open: Vec<NodeId>,
}

/// All that may be fused, as far as sizes and outputs allow.
pub(super) fn fusions(nodes: &[Node], domains: &[DomainInfo], phases: &[Phase]) -> Vec<Fusion> {
    let mut home = vec![None; nodes.len()];
    for (p, phase) in phases.iter().enumerate() {
        phase.nodes.iter().for_each(|&id| home[id] = Some(p));
    }
    let is_block = |&p: &usize| matches!(phases[p].body, Body::Block);
    let blocks = (0..phases.len()).filter(is_block);
    blocks
        .filter_map(|p| fusion(nodes, domains, phases, &home, p))
        .collect()
}

fn fusion(
    nodes: &[Node],
    domains: &[DomainInfo],
    phases: &[Phase],
    home: &[Option<usize>],
    inner: usize,
) -> Option<Fusion> {
    let phase = &phases[inner];
    let over_all = |id: &NodeId| matches!(nodes[*id].op, Op::SumLanes);
    if phase.sinks.iter().all(over_all) {
        // All adjoints come from later phases.
        return Some(Fusion {
            inner,
            outer: None,
            sums: Vec::new(),
            open: Vec::new(),
        });
    }
    let parent = domains[phase.domain].parent?;
    let is_segment_sum = |id: &NodeId| matches!(nodes[*id].op, Op::SegmentSum { .. });
    let in_runs = phase.runs.iter().flat_map(|run| &run.sinks).copied();
    let sums: Vec<NodeId> = in_runs.filter(is_segment_sum).collect();
    let reads = |node: &Node, wanted: &[NodeId]| node.inputs.iter().any(|i| wanted.contains(i));
    let mut readers = (0..nodes.len()).filter(|&id| reads(&nodes[id], &sums));
    let outer = home[readers.next()?]?;
    let after = &phases[outer];
    let is_block = matches!(after.body, Body::Block);
    if !is_block || after.domain != parent || readers.any(|id| home[id] != Some(outer)) {
        return None;
    }
    // All else that the outer phase reads must be there before the inner one runs.
    let in_time = |id: &NodeId| {
        let node = &nodes[*id];
        let mut inputs = node.inputs.iter().enumerate();
        inputs.all(|(i, input)| match home[*input] {
            Some(p) if p == inner => sums.contains(input) && !node.op.reads_whole(i),
            Some(p) => p < inner || p == outer,
            None => true,
        })
    };
    if !after.nodes.iter().all(in_time) {
        return None;
    }
    let between = |&id: &NodeId| home[id].is_some_and(|p| inner < p && p < outer);
    let reads_inner = |id: &NodeId| {
        let mut inputs = nodes[*id].inputs.iter();
        inputs.any(|&input| home[input] == Some(inner))
    };
    let elsewhere = (0..nodes.len()).filter(between).filter(reads_inner);
    let others = phase.sinks.iter().copied();
    let others = others.filter(|id| !sums.contains(id) && !over_all(id));
    Some(Fusion {
        inner,
        outer: Some(outer),
        open: elsewhere.chain(others).collect(),
        sums,
    })
}

impl Fusion {
    /// The later of the two phases.
    pub fn last(&self) -> usize {
        self.outer.unwrap_or(self.inner)
    }

    /// Whether all adjoints can be known block by block, given what is live and which adjoints are there.
    pub fn is_closed(&self, phases: &[Phase], live: &[bool], seeded: &[bool]) -> bool {
        let pulls = self.outer.map_or(&[][..], |outer| &phases[outer].pulls);
        phases[self.inner].nodes.iter().any(|&id| live[id])
            && self.open.iter().all(|&id| !live[id])
            && self.sums.iter().all(|&id| !(live[id] && seeded[id]))
            && pulls
                .iter()
                .all(|pull| pull.kind == PullKind::Lanes || !live[pull.target])
    }
}
