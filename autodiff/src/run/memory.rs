//! How much memory a program will need, before it is allocated.

use super::bucketing::Bucketing;
use super::chunk::{pull_len, sink_len, sorted_len, spans, store_len, widest};
use super::fused;
use super::lane::Lane;
use super::lookup::row_width;
use super::room::{scratch_len, stride, threads};
use super::sizes::{Extent, Sizes};
use super::tiles::tile_len;
use crate::buffer::Buffer;
use crate::error::RunError;
use crate::graph::{NodeId, Op, Shape};
use crate::program::{Body, Phase, Program};
use crate::real::Scalar;

/// Predicted heap bytes of a workspace, by what needs them. Index arrays, and arrays bound without a copy, come on top as far
/// as the caller keeps them; the latter are counted here as if copied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Bound arrays, whole values, and the arenas of blocks: needed by every pass.
    pub values: usize,
    /// In addition for [`Program::vjp`].
    pub adjoints: usize,
    /// In addition for [`Program::jvp`]; a Gauss-Newton product needs all three.
    pub tangents: usize,
    /// In addition for [`Program::hvp`], besides `values`.
    pub hessian: usize,
}

impl Memory {
    /// Bytes for values, adjoints and tangents together; [`Memory::hessian`] comes on top.
    pub fn total(&self) -> usize {
        self.values + self.adjoints + self.tangents
    }
}

impl Program {
    /// Predicts the memory of a workspace with these sizes, run in scalar `S`; nothing is allocated.
    ///
    /// # Errors
    /// As [`Program::workspace`].
    pub fn memory<S: Scalar>(&self, sizes: &Sizes) -> Result<Memory, RunError> {
        let extent = Extent::new(self, sizes)?;
        let mut memory = self.predict::<S>(&extent, sizes);
        let dual = self.predict::<S::Dual>(&extent, sizes);
        let bytes = |shape: Shape| {
            Buffer::<S>::bytes_for(extent.column(shape).saturating_mul(shape.channels))
        };
        memory.hessian = dual.values + dual.adjoints;
        for node in &self.nodes {
            memory.hessian += match node.op {
                // The gradient and the product.
                Op::Param => 2 * bytes(node.shape),
                _ => 0,
            };
        }
        let maps = self
            .nodes
            .iter()
            .filter(|node| matches!(node.op, Op::Map(_)));
        let room = maps.map(|node| {
            let [input, output] = [self.nodes[node.inputs[0]].shape, node.shape];
            let [input, output] = [input, output].map(|shape| extent.column(shape));
            // What goes in, and the value and derivative of what comes out, there and back.
            (input + 2 * output).max(output + 2 * input)
        });
        memory.hessian += Buffer::<S>::bytes_for(room.max().unwrap_or(0));
        Ok(memory)
    }

    fn predict<R: Lane>(&self, extent: &Extent, sizes: &Sizes) -> Memory {
        let bytes = Buffer::<R>::bytes_for;
        let mut memory = Memory::default();
        let whole = |id: NodeId| {
            let shape = self.nodes[id].shape;
            bytes(extent.column(shape).saturating_mul(shape.channels))
        };
        let mut table = vec![false; self.nodes.len()];
        let mut column = 0;
        for (id, node) in self.nodes.iter().enumerate() {
            if self.whole[id] {
                memory.values += whole(id);
                // Outputs are seeded whether or not a gradient can flow through them.
                if node.active || self.outputs.iter().any(|output| output.1 == id) {
                    memory.adjoints += whole(id);
                    memory.tangents += whole(id);
                }
            }
            match node.op {
                Op::Gather(_) | Op::GatherWeighted(_) => table[node.inputs[0]] = true,
                // One channel of the operand at a time.
                Op::Map(_) => column = column.max(extent.column(self.nodes[node.inputs[0]].shape)),
                _ => {}
            }
        }
        memory.adjoints += bytes(column);
        for (id, _) in table.iter().enumerate().filter(|(_, is_table)| **is_table) {
            let shape = self.nodes[id].shape;
            if shape.channels > 1 {
                let row = row_width(shape.channels, extent.axis(shape.axis));
                let table = bytes(extent.lanes[shape.domain].saturating_mul(row));
                memory.values += table;
                memory.tangents += table;
            }
        }
        let mut arena = Arena::default();
        let stride = |p: usize| {
            let phase = &self.phases[p];
            stride(self, extent, phase, sizes, &spans(self, extent, phase))
        };
        // Dual numbers run in separate passes.
        let fused = match R::PACKED {
            true => fused::lengths(self, extent, stride),
            false => Vec::new(),
        };
        for phase in self
            .phases
            .iter()
            .filter(|phase| matches!(phase.body, Body::Block))
        {
            for span in spans(self, extent, phase) {
                let stores = phase
                    .stores
                    .iter()
                    .map(|&id| store_len(self, extent, &span, id));
                let sinks = phase
                    .sinks
                    .iter()
                    .map(|&id| sink_len(self, extent, &span, id));
                let kept: usize = stores.chain(sinks).map(bytes).sum();
                memory.values += kept;
                memory.tangents += kept;
                for pull in &phase.pulls {
                    let bucketing = Bucketing::of(self, extent, phase, pull);
                    let sorted = sorted_len(&span, bucketing) * size_of::<u32>();
                    memory.adjoints +=
                        bytes(pull_len(self, extent, &span, pull, bucketing)) + sorted;
                }
            }
            arena.fit(self, extent, phase, sizes);
        }
        let threads = threads(sizes);
        let slots = |slots: &[usize]| slots.iter().map(|&len| bytes(len)).sum::<usize>();
        memory.values +=
            threads * (slots(&arena.computed) + bytes(arena.scratch) + bytes(arena.tile));
        memory.tangents += threads * slots(&arena.computed);
        memory.adjoints += threads * (slots(&arena.locals) + slots(&fused));
        memory
    }
}

/// The slots of a thread, as large as any phase needs them.
#[derive(Default)]
struct Arena {
    computed: Vec<usize>,
    locals: Vec<usize>,
    scratch: usize,
    tile: usize,
}

impl Arena {
    fn fit(&mut self, program: &Program, extent: &Extent, phase: &Phase, sizes: &Sizes) {
        let stride = stride(
            program,
            extent,
            phase,
            sizes,
            &spans(program, extent, phase),
        );
        let room = |id: &NodeId| {
            let shape = program.nodes[*id].shape;
            shape.channels * stride * extent.axis(shape.axis)
        };
        for (slots, count) in [
            (&mut self.computed, phase.computed),
            (&mut self.locals, phase.locals.len()),
        ] {
            slots.resize(slots.len().max(count), 0);
            for (slot, id) in slots.iter_mut().zip(&phase.locals[..count]) {
                *slot = (*slot).max(room(id));
            }
        }
        let scratch = scratch_len(program, phase, stride, widest(program, extent, phase));
        self.scratch = self.scratch.max(scratch);
        self.tile = self.tile.max(tile_len(phase));
    }
}
