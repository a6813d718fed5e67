//! Runs: consecutive elementwise nodes of a phase, executed tile by tile.

use crate::graph::{Node, NodeId, Op};
use crate::op::tile::Instruction;

/// Most nodes of a run, and most rows that it reads: they are listed on the stack.
pub(crate) const LIMIT: usize = 48;

/// What a phase does next.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Step {
    /// One node on a block.
    Node(NodeId),
    /// The run at this position.
    Run(usize),
}

/// Elementwise nodes that run together. Each value is a row of a tile for each channel: first what the run reads, then its
/// own results, operands before results.
pub(crate) struct Run {
    pub nodes: Vec<NodeId>,
    /// Nodes and channels that are read; their position is their row.
    pub externals: Vec<(NodeId, usize)>,
    /// One instruction for each channel of each node.
    pub instructions: Vec<Instruction>,
    /// The node that each instruction computes a channel of.
    pub owners: Vec<(NodeId, usize)>,
    /// Expansions and gathers that only this run reads, and the row of their first channel: done tile by tile too.
    pub lookups: Vec<(NodeId, usize)>,
    /// Sums over lanes of results, likewise.
    pub sinks: Vec<NodeId>,
    /// Who else in the phase uses each of `nodes`.
    users: Vec<Vec<NodeId>>,
    axis: Option<usize>,
}

impl Run {
    fn new(axis: Option<usize>) -> Self {
        Run {
            nodes: Vec::new(),
            externals: Vec::new(),
            instructions: Vec::new(),
            owners: Vec::new(),
            lookups: Vec::new(),
            sinks: Vec::new(),
            users: Vec::new(),
            axis,
        }
    }

    /// The row of a channel of a node that the run computes.
    pub fn row(&self, id: NodeId, channel: usize) -> Option<usize> {
        Some(self.externals.len() + self.own((id, channel))?)
    }

    /// The nodes of the phase, outside of the run, that use a node of the run.
    pub fn users(&self, id: NodeId) -> &[NodeId] {
        let at = self.nodes.iter().position(|&node| node == id);
        at.map_or(&[], |at| &self.users[at])
    }

    /// Rows of values.
    pub fn rows(&self) -> usize {
        self.externals.len() + self.instructions.len()
    }

    /// The row that holds a channel of a node, if the run computes it. Before [`Run::close`], counted without externals.
    fn own(&self, owner: (NodeId, usize)) -> Option<usize> {
        self.owners.iter().position(|&known| known == owner)
    }

    /// The rows that `node` would read and the run does not know yet.
    fn unknown(&self, nodes: &[Node], node: &Node) -> Vec<(NodeId, usize)> {
        let mut found = Vec::new();
        for &input in &node.inputs {
            for c in 0..nodes[input].shape.channels {
                let at = (input, c);
                if self.own(at).is_none() && !self.externals.contains(&at) && !found.contains(&at) {
                    found.push(at);
                }
            }
        }
        found
    }

    fn add(&mut self, nodes: &[Node], id: NodeId) {
        let node = &nodes[id];
        let unknown = self.unknown(nodes, node);
        self.externals.extend(unknown);
        self.nodes.push(id);
        let Op::Element(element) = node.op else {
            return;
        };
        for c in 0..node.shape.channels {
            self.owners.push((id, c));
            self.instructions.push(Instruction {
                element,
                out: 0,
                x: [0; 3],
            });
        }
    }

    /// Resolves rows, now that it is known how many are read.
    fn close(&mut self, nodes: &[Node]) {
        let first = self.externals.len();
        for i in 0..self.instructions.len() {
            let (id, channel) = self.owners[i];
            let row = |input: NodeId| {
                let single = nodes[input].shape.channels == 1;
                let at = (input, if single { 0 } else { channel });
                let external = || self.externals.iter().position(|&known| known == at);
                let row = self.own(at).map(|own| first + own).or_else(external);
                row.unwrap_or(0) as u32
            };
            let inputs = &nodes[id].inputs;
            let x = std::array::from_fn(|j| row(*inputs.get(j).unwrap_or(&inputs[0])));
            self.instructions[i].out = (first + i) as u32;
            self.instructions[i].x = x;
        }
    }
}

/// Puts the nodes of a phase in an order that makes few runs, and groups them.
pub(super) fn group(
    nodes: &[Node],
    whole: &[bool],
    members: &mut [NodeId],
) -> (Vec<Step>, Vec<Run>) {
    let is_element = |id: NodeId| matches!(nodes[id].op, Op::Element(_));
    // How often one has to go from a run to something else and back before a node.
    let mut rank = vec![None; nodes.len()];
    for &id in members.iter() {
        let before = nodes[id].inputs.iter().filter_map(|&input| {
            let rank: usize = rank[input]?;
            Some(rank + (is_element(input) && !is_element(id)) as usize)
        });
        rank[id] = Some(before.max().unwrap_or(0));
    }
    // Elements of different axes do not depend on each other without something else in between.
    let axis = |id: NodeId| is_element(id).then_some(nodes[id].shape.axis);
    members.sort_by_key(|&id| (rank[id], is_element(id), axis(id), id));
    let (mut steps, mut runs): (Vec<Step>, Vec<Run>) = Default::default();
    let mut open = false;
    for &id in members.iter() {
        if !is_element(id) {
            steps.push(Step::Node(id));
            open = false;
            continue;
        }
        let node = &nodes[id];
        let fits = open
            && runs.last().is_some_and(|run| {
                run.axis == node.shape.axis
                    && run.nodes.len() < LIMIT
                    && run.externals.len() + run.unknown(nodes, node).len() <= LIMIT
            });
        if !fits {
            // A node that alone reads too many rows stays by itself.
            let run = Run::new(node.shape.axis);
            if run.unknown(nodes, node).len() > LIMIT {
                steps.push(Step::Node(id));
                open = false;
                continue;
            }
            steps.push(Step::Run(runs.len()));
            runs.push(run);
            open = true;
        }
        if let Some(run) = runs.last_mut() {
            run.add(nodes, id);
        }
    }
    for run in &mut runs {
        run.close(nodes);
    }
    absorb(nodes, whole, &mut steps, &mut runs);
    let mut users = vec![Vec::new(); nodes.len()];
    for &id in members.iter() {
        for &input in &nodes[id].inputs {
            users[input].push(id);
        }
    }
    for run in &mut runs {
        let outside = |user: &NodeId| !run.nodes.contains(user) && !run.sinks.contains(user);
        let of = |&id: &NodeId| users[id].iter().copied().filter(outside).collect();
        run.users = run.nodes.iter().map(of).collect();
    }
    (steps, runs)
}

/// Moves lookups that a single run reads, and sums of what a run computes, into the run.
fn absorb(nodes: &[Node], whole: &[bool], steps: &mut Vec<Step>, runs: &mut [Run]) {
    let others: Vec<NodeId> = steps
        .iter()
        .filter_map(|step| match step {
            Step::Node(id) => Some(*id),
            Step::Run(_) => None,
        })
        .collect();
    steps.retain(|step| {
        let &Step::Node(id) = step else { return true };
        let node = &nodes[id];
        if node.shape.axis.is_some() {
            return true;
        }
        match node.op {
            Op::Expand | Op::Gather(_) if !whole[id] => {
                let reads = |run: &Run| run.externals.iter().position(|&read| read == (id, 0));
                let mut readers = runs
                    .iter()
                    .enumerate()
                    .filter_map(|(r, run)| Some((r, reads(run)?)));
                let (Some((run, row)), None) = (readers.next(), readers.next()) else {
                    return true;
                };
                if others
                    .iter()
                    .any(|&other| nodes[other].inputs.contains(&id))
                {
                    return true;
                }
                runs[run].lookups.push((id, row));
                false
            }
            Op::SegmentSum { .. } | Op::SumLanes => {
                let input = node.inputs[0];
                let rows = |run: &Run| {
                    let rows = run.sinks.iter().map(|&sink| nodes[sink].shape.channels);
                    rows.sum::<usize>() + node.shape.channels
                };
                let run = runs.iter_mut().find(|run| run.nodes.contains(&input));
                match run.filter(|run| rows(run) <= LIMIT) {
                    Some(run) => {
                        run.sinks.push(id);
                        false
                    }
                    None => true,
                }
            }
            _ => true,
        }
    });
}
