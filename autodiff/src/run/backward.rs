//! The way back: what is live, and adjoints from one phase to the one before.

use std::ops::Range;

use super::driver::{Pass, State, own};
use super::lane::Lane;
use super::passes;
use super::plan::{Marks, reverse_plans};
use super::zero::times;
use crate::graph::{NodeId, Op};
use crate::program::{Body, Program};

impl<R: Lane> State<R> {
    /// Forgets all seeds; adjoints are then seeded with [`State::seed`].
    pub fn clear_adjoints(&mut self) {
        self.seeded.fill(false);
        self.live.fill(false);
    }

    /// The adjoint array of an output, ready to be added to.
    pub fn seed(&mut self, program: &Program, id: NodeId) -> &mut [R] {
        let len = self.len(id);
        self.live[id] = program.nodes[id].active;
        let first = !std::mem::replace(&mut self.seeded[id], true);
        let adjoint = own(&mut self.adjoints[id]);
        adjoint.ensure(len);
        if first {
            adjoint.as_mut_slice().fill(R::default());
        }
        adjoint.as_mut_slice()
    }

    /// Seeds an output with its own tangent, times weights.
    pub fn seed_with_tangent(&mut self, id: NodeId, weights: Option<&[R]>) {
        let tangent = self.tangents[id].as_slice();
        let seeds = own(&mut self.adjoints[id]).as_mut_slice();
        match weights {
            None => seeds.copy_from_slice(tangent),
            Some(weights) => {
                for ((seed, t), w) in seeds.iter_mut().zip(tangent).zip(weights) {
                    *seed = times(*t, *w);
                }
            }
        }
    }

    /// Marks what a gradient of one output would reach.
    pub fn mark_live(&mut self, program: &Program, output: NodeId) {
        self.live.fill(false);
        self.live[output] = program.nodes[output].active;
        self.spread_liveness(program);
    }

    /// Marks what seeds reach.
    pub(super) fn spread_liveness(&mut self, program: &Program) {
        for id in (0..program.nodes.len()).rev() {
            if self.live[id] {
                for &input in &program.nodes[id].inputs {
                    self.live[input] |= program.nodes[input].active;
                }
            }
        }
    }

    /// Passes the seeded adjoints back through some phases, of which one may have run already, and to the parameters.
    pub fn reverse(&mut self, program: &Program, phases: Range<usize>, done: Option<usize>) {
        self.spread_liveness(program);
        for p in phases.clone().rev() {
            let phase = &program.phases[p];
            if !phase.nodes.iter().any(|&id| self.live[id]) {
                continue;
            }
            if let Body::Map = phase.body {
                self.map_adjoint(program, phase.nodes[0]);
                continue;
            }
            if done != Some(p) {
                self.plan_reverse(program, p);
                self.prepare(program, p, Pass::Adjoints);
                self.run(program, p, passes::reverse);
            }
            self.assemble_adjoints(program, p);
        }
        if phases.start > 0 {
            return;
        }
        for (id, node) in program.nodes.iter().enumerate() {
            if matches!(node.op, Op::Param) && !self.seeded[id] {
                let len = self.len(id);
                let adjoint = own(&mut self.adjoints[id]);
                adjoint.ensure(len);
                adjoint.as_mut_slice().fill(R::default());
            }
        }
    }

    /// Plans the way back through a phase.
    pub(super) fn plan_reverse(&mut self, program: &Program, p: usize) {
        self.mark_replay(program, p);
        let marks = Marks {
            live: &self.live,
            seeded: &self.seeded,
            replay: &self.replay,
        };
        reverse_plans(
            program,
            &program.phases[p],
            &self.places[p],
            &marks,
            &mut self.written,
            &mut self.plans[p],
        );
    }
}
