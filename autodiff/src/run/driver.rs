//! Running phases: chunks in parallel, then their private results into whole arrays, in a fixed order.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pulp::Arch;
use rayon::prelude::*;

use super::block::{Env, Place, Whole, Worker, places};
use super::bucketing::Bucketing;
use super::chunk::{Chunk, ensure, pull_len, sink_len, sorted_len, spans, store_len, widest};
use super::fused::Fused;
use super::lane::Lane;
use super::lookup::interleave;
use super::passes;
use super::plan::{Plan, forward_plans};
use super::replay::mark_replay;
use super::room::{grow, scratch_len, stride, threads};
use super::sizes::{Extent, Sizes};
use super::tiles::tile_len;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::program::{Body, Program};

/// All that a run changes, for one scalar type.
pub(super) struct State<R: Lane> {
    pub extent: Extent,
    pub values: Vec<Whole<R>>,
    pub tangents: Vec<Whole<R>>,
    tables: Vec<Buffer<R>>,
    table_tangents: Vec<Buffer<R>>,
    pub adjoints: Vec<Whole<R>>,
    /// Elements of each node's whole array.
    pub lengths: Vec<usize>,
    pub indices: Vec<Arc<[u32]>>,
    pub moving: Vec<bool>,
    pub live: Vec<bool>,
    pub seeded: Vec<bool>,
    pub(super) replay: Vec<bool>,
    pub(super) chunks: Vec<Vec<Mutex<Chunk<R>>>>,
    /// Phase by phase, which of its pulls go to large tables.
    pub(super) bucketings: Vec<Vec<Option<Bucketing>>>,
    pub(super) strides: Vec<usize>,
    pub(super) places: Vec<Vec<Place>>,
    /// Phases whose gradient is computed in one go.
    pub(super) fused: Option<Arc<Fused>>,
    pub(super) plans: Vec<Vec<Plan>>,
    /// Which adjoints a phase has written, while its plans are made.
    pub(super) written: Vec<bool>,
    /// Behind a lock, so that they stay where they are if an operation of the user panics.
    pub(super) workers: Mutex<Vec<Worker<R>>>,
    pub(super) parts: Buffer<R::Part>,
    pub(super) column: Buffer<R>,
    pub(super) arch: Arch,
}

/// What a pass computes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Pass {
    Values,
    Tangents,
    Adjoints,
}

impl<R: Lane> State<R> {
    pub fn new(program: &Program, extent: Extent, sizes: &Sizes) -> Self {
        State::empty(program).sized(program, extent, sizes)
    }

    /// Other sizes for the same program, in the same memory. Leaves keep their arrays.
    pub fn resize(&mut self, program: &Program, extent: Extent, sizes: &Sizes) {
        let old = std::mem::replace(self, State::empty(program));
        *self = old.sized(program, extent, sizes);
    }

    fn sized(mut self, program: &Program, extent: Extent, sizes: &Sizes) -> Self {
        let nodes = program.nodes.len();
        let mut chunks = Vec::new();
        let mut strides = Vec::new();
        let mut resolved = Vec::new();
        for phase in &program.phases {
            let spans = match phase.body {
                Body::Block => spans(program, &extent, phase),
                Body::Map => Vec::new(),
            };
            let stride = stride(program, &extent, phase, sizes, &spans);
            strides.push(stride);
            resolved.push(places(program, phase, &extent, stride));
            let mut before = self.chunks.get_mut(chunks.len()).map(std::mem::take);
            let mut before = before.iter_mut().flatten();
            let chunk = |span| Chunk {
                span,
                ..before
                    .next()
                    .map_or_else(Chunk::default, |c| std::mem::take(unlocked(c)))
            };
            chunks.push(spans.into_iter().map(chunk).map(Mutex::new).collect());
        }
        let plans = program.phases.iter().zip(&resolved);
        let plans = plans.map(|(phase, places)| forward_plans(program, phase, places));
        let plans = plans.collect();
        let bucketings = program.phases.iter().map(|phase| {
            let pulls = phase.pulls.iter();
            pulls
                .map(|pull| Bucketing::of(program, &extent, phase, pull))
                .collect()
        });
        let bucketings = bucketings.collect();
        let threads = threads(sizes);
        unlocked(&mut self.workers).resize_with(threads, Worker::new);
        let mut state = State {
            lengths: program
                .nodes
                .iter()
                .map(|node| {
                    let shape = node.shape;
                    shape.channels * extent.lanes[shape.domain] * extent.axis(shape.axis)
                })
                .collect(),
            moving: vec![false; nodes],
            live: vec![false; nodes],
            seeded: vec![false; nodes],
            replay: vec![false; nodes],
            chunks,
            fused: Fused::new(program, &extent, &strides, &resolved).map(Arc::new),
            strides,
            bucketings,
            places: resolved,
            plans,
            extent,
            ..self
        };
        for (id, node) in program.nodes.iter().enumerate() {
            if let Op::Constant(value) = node.op {
                let mut buffer = Buffer::zeros(1);
                buffer.as_mut_slice().fill(R::from_f64(value));
                state.values[id] = Whole::Owned(buffer);
            } else if program.whole[id] && !node.op.is_leaf() {
                let len = state.len(id);
                own(&mut state.values[id]).ensure(len);
            }
        }
        for p in 0..program.phases.len() {
            state.prepare(program, p, Pass::Values);
        }
        state
    }

    /// A state without sizes and memory.
    fn empty(program: &Program) -> Self {
        let nodes = program.nodes.len();
        let empty = || vec![Whole::Owned(Buffer::zeros(0)); nodes];
        State {
            extent: Extent::default(),
            values: empty(),
            tangents: empty(),
            tables: vec![Buffer::zeros(0); nodes],
            table_tangents: vec![Buffer::zeros(0); nodes],
            adjoints: empty(),
            lengths: Vec::new(),
            indices: vec![Arc::from([]); program.indices.len()],
            moving: Vec::new(),
            live: Vec::new(),
            seeded: Vec::new(),
            replay: Vec::new(),
            chunks: Vec::new(),
            bucketings: Vec::new(),
            strides: Vec::new(),
            places: Vec::new(),
            fused: None,
            plans: Vec::new(),
            written: Vec::new(),
            workers: Mutex::new(Vec::new()),
            parts: Buffer::zeros(0),
            column: Buffer::zeros(0),
            arch: Arch::new(),
        }
    }

    /// Elements of a node of a phase in the arena of a thread.
    pub fn arena_len(&self, program: &Program, p: usize, id: NodeId) -> usize {
        let shape = program.nodes[id].shape;
        shape.channels * self.strides[p] * self.extent.axis(shape.axis)
    }

    /// Marks what the reverse pass of a phase computes again.
    pub fn mark_replay(&mut self, program: &Program, p: usize) {
        mark_replay(program, &program.phases[p], &self.live, &mut self.replay);
    }

    /// Elements of a node's whole array.
    pub fn len(&self, id: NodeId) -> usize {
        self.lengths[id]
    }

    /// Heap bytes held.
    pub fn bytes(&self) -> usize {
        let tables = [&self.tables, &self.table_tangents].into_iter().flatten();
        let whole = [&self.values, &self.tangents, &self.adjoints];
        let whole = whole.into_iter().flatten().map(|array| match array {
            Whole::Owned(buffer) => buffer.bytes(),
            Whole::Shared(_) => 0,
        });
        let chunks = self
            .chunks
            .iter()
            .flatten()
            .map(|chunk| lock(chunk).bytes());
        whole.sum::<usize>()
            + chunks.sum::<usize>()
            + lock(&self.workers).iter().map(Worker::bytes).sum::<usize>()
            + tables.map(Buffer::bytes).sum::<usize>()
            + self.column.bytes()
            + self.parts.bytes()
    }

    /// The tangents of moving nodes where all values are those of what is bound already: linear maps, which are the most of many
    /// programs, are not applied to values again, and phases in which nothing moves are left out.
    pub fn tangents(&mut self, program: &Program) {
        self.mark_moving(program);
        for (p, phase) in program.phases.iter().enumerate() {
            if !phase.nodes.iter().any(|&id| self.moving[id]) {
                continue;
            }
            match phase.body {
                Body::Map => self.map(program, phase.nodes[0], true),
                _ => self.forward_phase(program, p, true),
            }
        }
    }

    /// Computes all values, and the tangents of moving nodes when asked to.
    pub fn forward(&mut self, program: &Program, tangents: bool) {
        if tangents {
            self.mark_moving(program);
        }
        for p in 0..program.phases.len() {
            self.forward_phase(program, p, tangents);
        }
    }

    /// Marks what moves with the parameters that do and makes room for its tangents; outputs that stand still have none.
    fn mark_moving(&mut self, program: &Program) {
        for (id, node) in program.nodes.iter().enumerate() {
            if !node.op.is_leaf() {
                self.moving[id] =
                    node.active && node.inputs.iter().any(|&input| self.moving[input]);
            }
            if program.whole[id] && self.moving[id] && !node.op.is_leaf() {
                let len = self.len(id);
                own(&mut self.tangents[id]).ensure(len);
            }
        }
        for &(_, id) in &program.outputs {
            if !self.moving[id] {
                let len = self.len(id);
                let still = own(&mut self.tangents[id]);
                still.ensure(len);
                still.as_mut_slice().fill(R::default());
            }
        }
    }

    /// Computes the values of one phase.
    pub(super) fn forward_phase(&mut self, program: &Program, p: usize, tangents: bool) {
        if let Body::Map = program.phases[p].body {
            let id = program.phases[p].nodes[0];
            self.map(program, id, false);
            if tangents && self.moving[id] {
                self.map(program, id, true);
            }
            return;
        }
        self.interleave(program, p, tangents);
        let pass = match tangents {
            true => Pass::Tangents,
            false => Pass::Values,
        };
        self.prepare(program, p, pass);
        self.run(program, p, |env, worker, chunk| {
            passes::forward(env, worker, chunk, tangents)
        });
        self.assemble_values(program, p, tangents);
    }

    /// Brings the tables that a phase looks up into their order.
    pub(super) fn interleave(&mut self, program: &Program, p: usize, tangents: bool) {
        for &id in &program.phases[p].nodes {
            if !matches!(program.nodes[id].op, Op::Gather(_) | Op::GatherWeighted(_)) {
                continue;
            }
            let table = program.nodes[id].inputs[0];
            let shape = program.nodes[table].shape;
            if shape.channels == 1 {
                continue;
            }
            let axis = self.extent.axis(shape.axis);
            let values = self.values[table].as_slice();
            interleave(values, shape.channels, axis, &mut self.tables[table]);
            if tangents && self.moving[table] {
                let values = self.tangents[table].as_slice();
                interleave(
                    values,
                    shape.channels,
                    axis,
                    &mut self.table_tangents[table],
                );
            }
        }
    }

    /// Makes room for a pass over a phase; does nothing when it ran before.
    pub(super) fn prepare(&mut self, program: &Program, p: usize, pass: Pass) {
        let (phase, extent, stride) = (&program.phases[p], &self.extent, self.strides[p]);
        for chunk in &mut self.chunks[p] {
            let chunk = unlocked(chunk);
            let span = chunk.span.clone();
            let store = || {
                phase
                    .stores
                    .iter()
                    .map(|&id| store_len(program, extent, &span, id))
            };
            let sink = || {
                phase
                    .sinks
                    .iter()
                    .map(|&id| sink_len(program, extent, &span, id))
            };
            match pass {
                Pass::Adjoints => {
                    let bucketings = &self.bucketings[p];
                    let pulls = phase.pulls.iter().zip(bucketings);
                    let pulls = pulls.map(|(pull, b)| pull_len(program, extent, &span, pull, *b));
                    ensure(&mut chunk.pull, pulls);
                    chunk.sorted.resize_with(bucketings.len(), Vec::new);
                    for (sorted, bucketing) in chunk.sorted.iter_mut().zip(bucketings) {
                        sorted.resize(sorted_len(&span, *bucketing), 0);
                    }
                }
                _ => {
                    ensure(&mut chunk.store, store());
                    ensure(&mut chunk.sink, sink());
                }
            }
            if pass == Pass::Tangents {
                ensure(&mut chunk.store_tangent, store());
                ensure(&mut chunk.sink_tangent, sink());
            }
        }
        let room = |id: NodeId| {
            let shape = program.nodes[id].shape;
            shape.channels * stride * extent.axis(shape.axis)
        };
        let scratch = scratch_len(program, phase, stride, widest(program, extent, phase));
        for worker in unlocked(&mut self.workers) {
            grow(&mut worker.values, phase, phase.computed, room);
            if pass == Pass::Tangents {
                grow(&mut worker.tangents, phase, phase.computed, room);
            }
            if pass == Pass::Adjoints {
                grow(&mut worker.adjoints, phase, phase.locals.len(), room);
            }
            if worker.written.len() < phase.locals.len() {
                worker.written.resize(phase.locals.len(), false);
            }
            worker.scratch.grow(scratch);
            worker.tile.grow(tile_len(phase));
        }
    }

    /// Runs the chunks of a phase in parallel. Which thread takes which chunk has no influence on any result.
    pub(super) fn run(
        &mut self,
        program: &Program,
        p: usize,
        work: impl Fn(&Env<R>, &mut Worker<R>, &mut Chunk<R>) + Sync,
    ) {
        let env = self.env(program, p);
        share(
            &mut lock(&self.workers),
            &self.chunks[p],
            |worker, chunk| work(&env, worker, chunk),
        );
    }

    /// What the blocks of a phase share.
    pub(super) fn env<'a>(&'a self, program: &'a Program, p: usize) -> Env<'a, R> {
        Env {
            program,
            phase: &program.phases[p],
            extent: &self.extent,
            arch: self.arch,
            places: &self.places[p],
            stride: self.strides[p],
            values: &self.values,
            tangents: &self.tangents,
            tables: &self.tables,
            table_tangents: &self.table_tangents,
            adjoints: &self.adjoints,
            indices: &self.indices,
            moving: &self.moving,
            live: &self.live,
            seeded: &self.seeded,
            replay: &self.replay,
            plans: &self.plans[p],
            bucketings: &self.bucketings[p],
        }
    }
}

/// What a lock guards, whether or not somebody panicked meanwhile: all of it is written before it is read.
pub(super) fn lock<T>(guarded: &Mutex<T>) -> MutexGuard<'_, T> {
    guarded.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The same for who needs no lock.
pub(super) fn unlocked<T>(guarded: &mut Mutex<T>) -> &mut T {
    guarded.get_mut().unwrap_or_else(PoisonError::into_inner)
}

/// Has the workers take chunks until there are none left.
pub(super) fn share<R: Lane>(
    workers: &mut [Worker<R>],
    chunks: &[Mutex<Chunk<R>>],
    work: impl Fn(&mut Worker<R>, &mut Chunk<R>) + Sync,
) {
    let next = AtomicUsize::new(0);
    let drain = |worker: &mut Worker<R>| {
        while let Some(chunk) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
            work(worker, &mut lock(chunk));
        }
    };
    if workers.len() == 1 || chunks.len() == 1 {
        drain(&mut workers[0]);
    } else {
        workers.par_iter_mut().with_max_len(1).for_each(drain);
    }
}

/// The array as one that can be written to.
pub(super) fn own<R: Lane>(array: &mut Whole<R>) -> &mut Buffer<R> {
    if let Whole::Shared(_) = array {
        *array = Whole::Owned(Buffer::zeros(0));
    }
    match array {
        Whole::Owned(buffer) => buffer,
        Whole::Shared(_) => unreachable!("replaced above"),
    }
}
