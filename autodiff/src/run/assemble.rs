//! Putting the private results of chunks together, in the order of chunks.

use std::sync::{Mutex, PoisonError};

use pulp::Arch;
use rayon::prelude::*;

use super::chunk::Chunk;
use super::driver::{State, own};
use super::lane::Lane;
use super::lookup::deinterleave;
use super::rows::{PARTIALS, put, total};
use super::sizes::Extent;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::program::{Program, PullKind};
use crate::real::Real;

/// Elements of a table that one task adds up.
const SHARE: usize = 1 << 13;

/// How the private results of chunks make up a whole array.
pub(super) struct Layout {
    kind: PullKind,
    channels: usize,
    lanes: usize,
    axis: usize,
}

impl Layout {
    pub fn new(program: &Program, extent: &Extent, id: NodeId, kind: PullKind) -> Self {
        let shape = program.nodes[id].shape;
        Layout {
            kind,
            channels: shape.channels,
            lanes: extent.lanes[shape.domain],
            axis: extent.axis(shape.axis),
        }
    }

    /// Adds up the chunks' tables or matrices, chunk after chunk, and writes or adds the sum to `target`.
    pub fn assemble_table<R: Real>(
        &self,
        arch: Arch,
        chunks: &mut [Mutex<Chunk<R>>],
        pull: usize,
        target: &mut [R],
        add: bool,
    ) {
        let [first, others @ ..] = chunks else { return };
        let first = first.get_mut().unwrap_or_else(PoisonError::into_inner);
        let mut sum = std::mem::take(&mut first.pull[pull]);
        add_shares(arch, sum.as_mut_slice(), others, pull);
        if self.kind == PullKind::Weight || self.channels == 1 {
            put(arch, target, sum.as_slice(), add);
        } else {
            deinterleave(sum.as_slice(), self.channels, self.axis, target, add);
        }
        first.pull[pull] = sum;
    }

    /// Writes, or adds, the chunks' results to `target`, chunk after chunk.
    pub fn assemble<R: Real>(
        &self,
        arch: Arch,
        chunks: &mut [Mutex<Chunk<R>>],
        part: impl Fn(&Chunk<R>) -> &Buffer<R>,
        target: &mut [R],
        add: bool,
    ) {
        let disjoint = matches!(self.kind, PullKind::Lanes | PullKind::Parents);
        if !disjoint && !add {
            target.fill(R::default());
        }
        for chunk in chunks {
            let chunk = chunk.get_mut().unwrap_or_else(PoisonError::into_inner);
            let range = match self.kind {
                PullKind::Lanes => &chunk.span.lanes,
                _ => &chunk.span.parents,
            };
            let (start, len) = (range.start * self.axis, range.len() * self.axis);
            let source = part(chunk).as_slice();
            for c in 0..self.channels {
                let row = self.lanes * self.axis;
                match self.kind {
                    PullKind::Lanes | PullKind::Parents => {
                        let target = &mut target[c * row + start..c * row + start + len];
                        put(arch, target, &source[c * len..(c + 1) * len], add);
                    }
                    PullKind::Uniform if self.axis == 1 => {
                        let sum = total(&source[c * PARTIALS..(c + 1) * PARTIALS]);
                        target[c] = target[c] + sum;
                    }
                    _ => {
                        let target = &mut target[c * row..(c + 1) * row];
                        put(arch, target, &source[c * row..(c + 1) * row], true);
                    }
                }
            }
        }
    }
}

/// Adds the chunks' pulls to `sum`, chunk after chunk, all elements of a share by one task.
fn add_shares<R: Real>(arch: Arch, sum: &mut [R], chunks: &[Mutex<Chunk<R>>], pull: usize) {
    let shares = sum.par_chunks_mut(SHARE).enumerate();
    shares.for_each(|(share, sum)| {
        for chunk in chunks {
            let chunk = chunk.lock().unwrap_or_else(PoisonError::into_inner);
            let start = share * SHARE;
            let part = &chunk.pull[pull].as_slice()[start..start + sum.len()];
            put(arch, sum, part, true);
        }
    });
}

impl<R: Lane> State<R> {
    /// Copies what chunks stored and accumulated to whole arrays.
    pub(super) fn assemble_values(&mut self, program: &Program, p: usize, tangents: bool) {
        let phase = &program.phases[p];
        let (extent, arch) = (&self.extent, self.arch);
        let chunks = &mut self.chunks[p];
        for (i, &id) in phase.stores.iter().enumerate() {
            let layout = Layout::new(program, extent, id, PullKind::Lanes);
            let target = own(&mut self.values[id]).as_mut_slice();
            layout.assemble(arch, chunks, |chunk| &chunk.store[i], target, false);
            if tangents && self.moving[id] {
                let target = own(&mut self.tangents[id]).as_mut_slice();
                layout.assemble(arch, chunks, |chunk| &chunk.store_tangent[i], target, false);
            }
        }
        for (i, &id) in phase.sinks.iter().enumerate() {
            let kind = match program.nodes[id].op {
                Op::SumLanes => PullKind::Uniform,
                _ => PullKind::Parents,
            };
            let layout = Layout::new(program, extent, id, kind);
            let target = own(&mut self.values[id]).as_mut_slice();
            layout.assemble(arch, chunks, |chunk| &chunk.sink[i], target, false);
            if tangents && self.moving[id] {
                let target = own(&mut self.tangents[id]).as_mut_slice();
                layout.assemble(arch, chunks, |chunk| &chunk.sink_tangent[i], target, false);
            }
        }
    }

    /// Adds what chunks accumulated to the whole adjoints.
    pub(super) fn assemble_adjoints(&mut self, program: &Program, p: usize) {
        for (i, pull) in program.phases[p].pulls.iter().enumerate() {
            let id = pull.target;
            if !self.live[id] {
                continue;
            }
            let len = self.len(id);
            let add = std::mem::replace(&mut self.seeded[id], true);
            let target = own(&mut self.adjoints[id]);
            target.ensure(len);
            let layout = Layout::new(program, &self.extent, id, pull.kind);
            let chunks = &mut self.chunks[p];
            let target = target.as_mut_slice();
            if let Some(bucketing) = self.bucketings[p][i] {
                let lookups = (program, &self.indices[..]);
                bucketing.assemble(lookups, pull.user, (chunks, i), target, add);
            } else if matches!(pull.kind, PullKind::Table | PullKind::Weight) {
                layout.assemble_table(self.arch, chunks, i, target, add);
            } else {
                layout.assemble(self.arch, chunks, |chunk| &chunk.pull[i], target, add);
            }
        }
    }
}
