//! A block of lanes: the arena that it runs in, and access to values whole and local.

use std::mem::take;

use pulp::Arch;

use super::bucketing::Bucketing;
use super::chunk::{Chunk, Span};
use super::plan::Plan;
use super::sizes::Extent;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::program::{NONE, Phase, Program};
use crate::real::Real;

/// A whole array: `[channel][lane][axis]`.
#[derive(Clone, Debug)]
pub(super) enum Whole<R> {
    Owned(Buffer<R>),
    Shared(std::sync::Arc<[R]>),
}

impl<R: Real> Whole<R> {
    #[inline(always)]
    pub fn as_slice(&self) -> &[R] {
        match self {
            Whole::Owned(buffer) => buffer.as_slice(),
            Whole::Shared(array) => array,
        }
    }
}

/// Where a phase finds a node, resolved for its sizes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Elements per lane and channel.
    pub axis: usize,
    pub channels: usize,
    /// Elements between channels in the arena.
    pub pitch: usize,
    /// Slot in the arena, or [`NONE`].
    pub slot: u32,
    /// Whether the value is computed by the phase, so that it is in the arena too.
    computed: bool,
    /// Lanes of the whole value.
    lanes: usize,
}

impl Place {
    /// Makes the phase look for the value in its arena.
    pub fn compute(&mut self) {
        self.computed = self.slot != NONE;
    }
}

/// The places of all nodes in a phase whose blocks have at most `stride` lanes.
pub(super) fn places(
    program: &Program,
    phase: &Phase,
    extent: &Extent,
    stride: usize,
) -> Vec<Place> {
    let nodes = program.nodes.iter().zip(&phase.slot);
    nodes
        .map(|(node, &slot)| {
            let axis = extent.axis(node.shape.axis);
            Place {
                axis,
                channels: node.shape.channels,
                pitch: stride * axis,
                slot,
                computed: slot != NONE && (slot as usize) < phase.computed,
                lanes: extent.lanes[node.shape.domain],
            }
        })
        .collect()
}

/// What all blocks of a phase share.
pub(super) struct Env<'a, R> {
    pub program: &'a Program,
    pub phase: &'a Phase,
    pub extent: &'a Extent,
    pub arch: Arch,
    pub places: &'a [Place],
    /// Lanes between channels in the arena: the largest block.
    pub stride: usize,
    pub values: &'a [Whole<R>],
    pub tangents: &'a [Whole<R>],
    pub tables: &'a [Buffer<R>],
    pub table_tangents: &'a [Buffer<R>],
    pub adjoints: &'a [Whole<R>],
    pub indices: &'a [std::sync::Arc<[u32]>],
    /// Nodes whose tangent is not zero.
    pub moving: &'a [bool],
    /// Nodes whose adjoint is wanted and not zero.
    pub live: &'a [bool],
    /// Nodes whose whole adjoint has been written.
    pub seeded: &'a [bool],
    /// Nodes whose value the reverse pass reads.
    pub replay: &'a [bool],
    /// Plans of the phase's runs.
    pub plans: &'a [Plan],
    /// Which of the phase's pulls go to large tables.
    pub bucketings: &'a [Option<Bucketing>],
}

/// Lanes of a block.
#[derive(Clone, Copy)]
pub(super) struct Lanes {
    /// First lane, counted over the whole domain.
    pub start: usize,
    pub len: usize,
}

/// The arena of one thread.
pub(super) struct Worker<R> {
    pub values: Vec<Buffer<R>>,
    pub tangents: Vec<Buffer<R>>,
    pub adjoints: Vec<Buffer<R>>,
    /// Which adjoints of the block have been written.
    pub written: Vec<bool>,
    pub scratch: Buffer<R>,
    /// Rows of a tile.
    pub tile: Buffer<R>,
    /// Rows of all tiles of a block, where values are kept for the way back.
    pub kept: Buffer<R>,
    /// Where buffers are while a run writes to them; empty in between.
    pub lent: Lent<R>,
    /// The arena of the phase above, if both run block by block.
    pub above: Option<Box<Worker<R>>>,
}

/// Buffers of the arena and of the chunk.
#[derive(Default)]
pub(super) struct Lent<R> {
    pub arena: Vec<Buffer<R>>,
    pub chunk: Vec<Buffer<R>>,
}

impl<R: Real> Worker<R> {
    pub fn new() -> Self {
        Worker {
            values: Vec::new(),
            tangents: Vec::new(),
            adjoints: Vec::new(),
            written: Vec::new(),
            scratch: Buffer::zeros(0),
            tile: Buffer::zeros(0),
            kept: Buffer::zeros(0),
            lent: Lent::default(),
            above: None,
        }
    }

    pub fn bytes(&self) -> usize {
        [&self.values, &self.tangents, &self.adjoints]
            .into_iter()
            .flatten()
            .map(Buffer::bytes)
            .sum::<usize>()
            + self.scratch.bytes()
            + self.tile.bytes()
            + self.kept.bytes()
            + self.above.as_ref().map_or(0, |above| above.bytes())
    }
}

/// Values, or tangents, as seen from a block: those computed in it, and whole ones.
pub(super) struct View<'a, R> {
    pub local: &'a [Buffer<R>],
    pub whole: &'a [Whole<R>],
    /// Whole values in the order of tables, where they differ.
    pub tables: &'a [Buffer<R>],
}

impl<'a, R: Real> View<'a, R> {
    /// A whole value as a table: `[lane][channel][axis]`.
    #[inline(always)]
    pub fn table(self, env: &Env<R>, id: NodeId) -> &'a [R] {
        if env.channels(id) == 1 {
            self.whole[id].as_slice()
        } else {
            self.tables[id].as_slice()
        }
    }
}

impl<R> Clone for View<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<R> Copy for View<'_, R> {}

impl<'a, R: Real> Env<'a, R> {
    /// Elements per lane and channel.
    #[inline(always)]
    pub fn axis(&self, id: NodeId) -> usize {
        self.places[id].axis
    }

    #[inline(always)]
    pub fn channels(&self, id: NodeId) -> usize {
        self.places[id].channels
    }

    #[inline(always)]
    pub fn slot(&self, id: NodeId) -> usize {
        self.places[id].slot as usize
    }

    /// Elements between channels of a node in the arena.
    #[inline(always)]
    pub fn pitch(&self, id: NodeId) -> usize {
        self.places[id].pitch
    }

    /// One channel of an operand on the phase's domain, for the lanes of the block.
    #[inline(always)]
    pub fn channel<'v>(
        &self,
        view: View<'v, R>,
        lanes: Lanes,
        id: NodeId,
        channel: usize,
    ) -> &'v [R] {
        let place = self.places[id];
        let channel = if place.channels == 1 { 0 } else { channel };
        let len = lanes.len * place.axis;
        if place.computed {
            let start = channel * place.pitch;
            &view.local[place.slot as usize].as_slice()[start..start + len]
        } else {
            let start = (channel * place.lanes + lanes.start) * place.axis;
            &view.whole[id].as_slice()[start..start + len]
        }
    }

    /// Lanes of the domain that a whole value lives on.
    #[inline(always)]
    pub fn all_lanes(&self, id: NodeId) -> usize {
        self.places[id].lanes
    }
}

/// Adds to the adjoint of a local operand: `write(target, add)` for each of its channels.
#[inline(always)]
pub(super) fn into_adjoint<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    id: NodeId,
    write: impl FnOnce(&mut [R], bool),
) {
    let slot = env.slot(id);
    let add = worker.written[slot];
    worker.written[slot] = true;
    let mut target = take(&mut worker.adjoints[slot]);
    write(target.as_mut_slice(), add);
    worker.adjoints[slot] = target;
}

/// Whether node `id` is computed in this phase and kept in the arena.
pub(super) fn is_computed<R>(env: &Env<R>, id: NodeId) -> bool {
    env.places[id].computed
}

/// Copies stored values of a block to the chunk.
pub(super) fn store<R: Real>(
    env: &Env<R>,
    span: &Span,
    lanes: Lanes,
    local: &[Buffer<R>],
    targets: &mut [Buffer<R>],
    wanted: impl Fn(NodeId) -> bool,
) {
    for (&id, target) in env.phase.stores.iter().zip(targets) {
        if !wanted(id) {
            continue;
        }
        let axis = env.axis(id);
        let source = local[env.slot(id)].as_slice();
        for c in 0..env.channels(id) {
            let from = c * env.pitch(id);
            let to = (c * span.lanes.len() + lanes.start - span.lanes.start) * axis;
            target.as_mut_slice()[to..to + lanes.len * axis]
                .copy_from_slice(&source[from..from + lanes.len * axis]);
        }
    }
}

/// The blocks of a chunk.
pub(super) fn blocks<R>(chunk: &Chunk<R>, stride: usize) -> impl Iterator<Item = Lanes> + use<R> {
    let range = chunk.span.lanes.clone();
    range.clone().step_by(stride).map(move |start| Lanes {
        start,
        len: stride.min(range.end - start),
    })
}

/// Whether a value is filled once for all blocks of a chunk.
pub(super) fn is_constant(op: &Op) -> bool {
    matches!(op, Op::Splat)
}
