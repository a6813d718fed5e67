//! What the runs of a phase do in each pass: which values they compute, read and leave, and how adjoints flow.

use super::block::Place;
use super::replay::reads_value;
use crate::graph::{NodeId, Op};
use crate::op::RESULT;
use crate::op::tile::{Instruction, Pull, Transfer};
use crate::program::{Phase, Program, PullKind, Run, Step};

/// The plans of one run.
#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    /// All values.
    pub forward: Values,
    /// Values that the reverse pass needs outside of the run.
    pub replay: Values,
    pub adjoints: Adjoints,
}

/// Computes values, and leaves some in the arena.
#[derive(Clone, Debug, Default)]
pub(super) struct Values {
    pub instructions: Vec<Instruction>,
    /// Which of the run's externals are read.
    pub reads: Vec<bool>,
    pub exports: Vec<Transfer>,
    /// Slots that are written.
    pub targets: Vec<usize>,
    /// Whether the run's sums are accumulated.
    pub sums: bool,
}

/// Computes values again, and passes adjoints back.
#[derive(Clone, Debug, Default)]
pub(super) struct Adjoints {
    pub instructions: Vec<Instruction>,
    pub reads: Vec<bool>,
    /// Adjoints of results that others have written.
    pub imports: Vec<Transfer>,
    pub sources: Vec<usize>,
    pub pulls: Vec<Pull>,
    /// Adjoints of what is read that others have written before.
    pub adds: Vec<Transfer>,
    pub exports: Vec<Transfer>,
    pub targets: Vec<usize>,
    /// Adjoints of the run's sums.
    pub sums: Vec<SumAdjoint>,
    /// Adjoints that go to whole arrays.
    pub lookups: Vec<LookupAdjoint>,
    /// Which rows have an adjoint.
    has: Vec<bool>,
    /// Which rows' values are read.
    needed: Vec<bool>,
}

/// Spreads the adjoint of one channel of a sum over lanes.
#[derive(Clone, Copy, Debug)]
pub(super) struct SumAdjoint {
    pub sink: NodeId,
    pub channel: usize,
    pub row: usize,
    pub add: bool,
}

/// Adds the adjoint of a lookup to the accumulation of a chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct LookupAdjoint {
    pub id: NodeId,
    /// Row of the first channel.
    pub row: usize,
    /// Which accumulation.
    pub pull: usize,
}

/// Marks of the nodes for one reverse pass.
pub(super) struct Marks<'a> {
    pub live: &'a [bool],
    pub seeded: &'a [bool],
    pub replay: &'a [bool],
}

/// Plans of the forward pass.
pub(super) fn forward_plans(program: &Program, phase: &Phase, places: &[Place]) -> Vec<Plan> {
    let plan = |run: &Run| {
        let mut plan = Plan::default();
        let leaves = |id: NodeId| phase.stores.contains(&id) || !run.users(id).is_empty();
        let mut needed = Vec::new();
        let summed = run.sinks.iter().map(|&sink| program.nodes[sink].inputs[0]);
        let summed: Vec<NodeId> = summed.collect();
        plan.forward.sums = !summed.is_empty();
        let sums = |id: NodeId| summed.contains(&id);
        plan.forward.fill(run, places, leaves, sums, &mut needed);
        plan
    };
    phase.runs.iter().map(plan).collect()
}

impl Values {
    /// Plans to leave the nodes that `leaves` tells, and to compute them, those that `keeps` tells, and what they need.
    fn fill(
        &mut self,
        run: &Run,
        places: &[Place],
        leaves: impl Fn(NodeId) -> bool,
        keeps: impl Fn(NodeId) -> bool,
        needed: &mut Vec<bool>,
    ) {
        self.exports.clear();
        self.targets.clear();
        needed.clear();
        needed.resize(run.rows(), false);
        for (instruction, &(id, channel)) in run.instructions.iter().zip(&run.owners) {
            let leaves = leaves(id);
            needed[instruction.out as usize] |= leaves || keeps(id);
            if !leaves {
                continue;
            }
            let place = places[id];
            let array = position(&mut self.targets, place.slot as usize);
            self.exports.push(Transfer {
                row: instruction.out,
                array,
                offset: channel * place.pitch,
            });
        }
        close(run, needed, &mut self.instructions, &mut self.reads);
    }
}

/// Plans of the reverse pass, given what is live, seeded and to be replayed. Allocates nothing when nothing changed.
pub(super) fn reverse_plans(
    program: &Program,
    phase: &Phase,
    places: &[Place],
    marks: &Marks,
    written: &mut Vec<bool>,
    plans: &mut [Plan],
) {
    for (run, plan) in phase.runs.iter().zip(plans.iter_mut()) {
        let outside = |id: NodeId| {
            let mut users = run.users(id).iter();
            users.any(|&user| reads_value(program, user, id, marks.live, marks.replay))
        };
        let Plan {
            replay, adjoints, ..
        } = plan;
        replay.fill(run, places, outside, |_| false, &mut adjoints.needed);
    }
    let slot = |id: NodeId| places[id].slot as usize;
    written.clear();
    written.resize(phase.locals.len(), false);
    for &id in &phase.stores {
        written[slot(id)] = marks.live[id] && marks.seeded[id];
    }
    for step in phase.steps.iter().rev() {
        match *step {
            Step::Run(at) => {
                let adjoints = &mut plans[at].adjoints;
                adjoints.fill(program, phase, &phase.runs[at], places, marks, written);
            }
            Step::Node(id) => {
                let node = &program.nodes[id];
                let reached = match node.op.is_sink() {
                    true => marks.seeded[id],
                    false => written[slot(id)],
                };
                if !marks.live[id] || !reached {
                    continue;
                }
                for (i, &input) in node.inputs.iter().enumerate() {
                    if marks.live[input] && !node.op.reads_whole(i) {
                        written[slot(input)] = true;
                    }
                }
            }
        }
    }
}

impl Adjoints {
    fn fill(
        &mut self,
        program: &Program,
        phase: &Phase,
        run: &Run,
        places: &[Place],
        marks: &Marks,
        written: &mut [bool],
    ) {
        let live = marks.live;
        for list in [&mut self.imports, &mut self.adds, &mut self.exports] {
            list.clear();
        }
        self.sources.clear();
        self.targets.clear();
        self.pulls.clear();
        self.sums.clear();
        self.lookups.clear();
        for marks in [&mut self.has, &mut self.needed] {
            marks.clear();
            marks.resize(run.rows(), false);
        }
        for (instruction, &(id, channel)) in run.instructions.iter().zip(&run.owners) {
            let place = places[id];
            if live[id] && written[place.slot as usize] {
                self.has[instruction.out as usize] = true;
                let array = position(&mut self.sources, place.slot as usize);
                self.imports.push(Transfer {
                    row: instruction.out,
                    array,
                    offset: channel * place.pitch,
                });
            }
        }
        for &sink in &run.sinks {
            let input = program.nodes[sink].inputs[0];
            if !(marks.seeded[sink] && live[sink] && live[input]) {
                continue;
            }
            for channel in 0..program.nodes[input].shape.channels {
                let Some(row) = run.row(input, channel) else {
                    continue;
                };
                let add = std::mem::replace(&mut self.has[row], true);
                self.sums.push(SumAdjoint {
                    sink,
                    channel,
                    row,
                    add,
                });
            }
        }
        for (instruction, &(id, _)) in run.instructions.iter().zip(&run.owners).rev() {
            if live[id] && self.has[instruction.out as usize] {
                self.pull(program, run, places, live, written, (instruction, id));
            }
        }
        for &(id, row) in &run.lookups {
            let input = program.nodes[id].inputs[0];
            let kind = match program.nodes[id].op {
                Op::Expand => PullKind::Parents,
                _ => PullKind::Table,
            };
            let pull = phase.pull(input, kind, id);
            if let Some(pull) = pull.filter(|_| live[input] && self.has[row]) {
                self.lookups.push(LookupAdjoint { id, row, pull });
            }
        }
        for export in &self.exports {
            written[self.targets[export.array as usize]] = true;
        }
        close(
            run,
            &mut self.needed,
            &mut self.instructions,
            &mut self.reads,
        );
    }

    /// Passes the adjoint of one row on to its live operands.
    fn pull(
        &mut self,
        program: &Program,
        run: &Run,
        places: &[Place],
        live: &[bool],
        written: &[bool],
        (instruction, id): (&Instruction, NodeId),
    ) {
        for (i, &input) in program.nodes[id].inputs.iter().enumerate() {
            if !live[input] {
                continue;
            }
            let row = instruction.x[i] as usize;
            if let Some(&(_, channel)) = run.externals.get(row)
                && !self.has[row]
                && run.lookups.iter().all(|&(lookup, _)| lookup != input)
            {
                let place = places[input];
                let transfer = Transfer {
                    row: row as u32,
                    array: position(&mut self.targets, place.slot as usize),
                    offset: channel * place.pitch,
                };
                self.exports.push(transfer);
                if written[place.slot as usize] {
                    self.adds.push(transfer);
                    self.has[row] = true;
                }
            }
            let add = self.has[row];
            let first = self.pulls.last_mut().filter(|pull| {
                let same = pull.of.out == instruction.out;
                i == 1 && same && pull.operand == 0 && instruction.x[0] != instruction.x[1]
            });
            match first {
                Some(first) => first.both = Some(add),
                None => self.pulls.push(Pull {
                    of: *instruction,
                    operand: i as u8,
                    add,
                    both: None,
                }),
            }
            self.has[row] = true;
            let reads = instruction.element.reads(i);
            for j in 0..instruction.element.arity() {
                self.needed[instruction.x[j] as usize] |= reads & (1 << j) != 0;
            }
            self.needed[instruction.out as usize] |= reads & RESULT != 0;
        }
    }
}

/// Position of `value` in `list`, to which it is appended if new.
fn position(list: &mut Vec<usize>, value: usize) -> u32 {
    let found = list.iter().position(|&known| known == value);
    found.unwrap_or_else(|| {
        list.push(value);
        list.len() - 1
    }) as u32
}

/// The instructions that compute the rows `needed`, and which externals they read.
fn close(
    run: &Run,
    needed: &mut [bool],
    instructions: &mut Vec<Instruction>,
    reads: &mut Vec<bool>,
) {
    for instruction in run.instructions.iter().rev() {
        if needed[instruction.out as usize] {
            for x in instruction.x {
                needed[x as usize] = true;
            }
        }
    }
    instructions.clear();
    let wanted = |i: &&Instruction| needed[i.out as usize];
    instructions.extend(run.instructions.iter().filter(wanted));
    reads.clear();
    reads.extend_from_slice(&needed[..run.externals.len()]);
}
