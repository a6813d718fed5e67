//! Linear maps of whole arrays, and their transposes.

use super::block::Whole;
use super::driver::{State, own};
use super::lane::Lane;
use super::rows::put;
use crate::graph::{NodeId, Op};
use crate::program::Program;

impl<R: Lane> State<R> {
    /// Applies a linear map to values or tangents.
    pub(super) fn map(&mut self, program: &Program, id: NodeId, tangents: bool) {
        let arrays = if tangents {
            &mut self.tangents
        } else {
            &mut self.values
        };
        let node = &program.nodes[id];
        let Op::Map(map) = &node.op else { return };
        let input = node.inputs[0];
        let columns = self.extent.axis(node.shape.axis);
        let (from, to) = (
            self.extent.lanes[program.nodes[input].shape.domain] * columns,
            self.extent.lanes[node.shape.domain] * columns,
        );
        // Operands come before results.
        let (before, after) = arrays.split_at_mut(id);
        let (source, target) = (before[input].as_slice(), own(&mut after[0]).as_mut_slice());
        for c in 0..node.shape.channels {
            let source = &source[c * from..(c + 1) * from];
            let target = &mut target[c * to..(c + 1) * to];
            R::apply_map(
                map.as_ref(),
                false,
                columns,
                source,
                target,
                &mut self.parts,
            );
        }
    }

    /// Adds the transpose of a linear map, applied to the adjoint of its result, to the adjoint of its operand.
    pub(super) fn map_adjoint(&mut self, program: &Program, id: NodeId) {
        let node = &program.nodes[id];
        let input = node.inputs[0];
        let Op::Map(map) = &node.op else { return };
        if !self.live[input] || !self.seeded[id] {
            return;
        }
        let columns = self.extent.axis(node.shape.axis);
        let (from, to) = (
            self.extent.lanes[program.nodes[input].shape.domain] * columns,
            self.extent.lanes[node.shape.domain] * columns,
        );
        let add = std::mem::replace(&mut self.seeded[input], true);
        let mut target = std::mem::take(own(&mut self.adjoints[input]));
        target.ensure(node.shape.channels * from);
        self.column.grow(from);
        let column = &mut self.column.as_mut_slice()[..from];
        let source = self.adjoints[id].as_slice();
        for c in 0..node.shape.channels {
            let source = &source[c * to..(c + 1) * to];
            R::apply_map(map.as_ref(), true, columns, source, column, &mut self.parts);
            let target = &mut target.as_mut_slice()[c * from..(c + 1) * from];
            put(self.arch, target, column, add);
        }
        self.adjoints[input] = Whole::Owned(target);
    }
}
