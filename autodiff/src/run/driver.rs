//! Running phases: chunks in parallel, then their private results into whole arrays, in a fixed order.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use pulp::Arch;
use rayon::prelude::*;

use super::assemble::Layout;
use super::block::{Env, Place, Whole, Worker, places};
use super::chunk::{Chunk, Span, ensure, pull_len, sink_len, spans, store_len, widest};
use super::lane::Lane;
use super::lookup::interleave;
use super::passes;
use super::plan::{Marks, Plan, forward_plans, reverse_plans};
use super::replay::mark_replay;
use super::rows::{PARTIALS, put};
use super::sizes::{Extent, Sizes};
use super::tiles::tile_len;
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::program::{Body, Phase, Program, PullKind};

/// How many times larger than others a value along an axis may be in a block.
const WIDE: usize = 16;

/// All that a run changes, for one scalar type.
pub(super) struct State<R> {
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
    replay: Vec<bool>,
    pub(super) chunks: Vec<Vec<Mutex<Chunk<R>>>>,
    strides: Vec<usize>,
    places: Vec<Vec<Place>>,
    plans: Vec<Vec<Plan>>,
    /// Which adjoints a phase has written, while its plans are made.
    written: Vec<bool>,
    pub(super) workers: Vec<Worker<R>>,
    column: Buffer<R>,
    arch: Arch,
}

/// What a pass computes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pass {
    Values,
    Tangents,
    Adjoints,
}

impl<R: Lane> State<R> {
    pub fn new(program: &Program, extent: Extent, sizes: &Sizes) -> Self {
        let nodes = program.nodes.len();
        let empty = || vec![Whole::Owned(Buffer::zeros(0)); nodes];
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
            chunks.push(
                spans
                    .into_iter()
                    .map(|span| Mutex::new(Chunk::new(span)))
                    .collect(),
            );
        }
        let plans = program.phases.iter().zip(&resolved);
        let plans = plans.map(|(phase, places)| forward_plans(program, phase, places));
        let plans = plans.collect();
        let threads = threads(sizes);
        let mut state = State {
            values: empty(),
            tangents: empty(),
            tables: vec![Buffer::zeros(0); nodes],
            table_tangents: vec![Buffer::zeros(0); nodes],
            adjoints: empty(),
            lengths: program
                .nodes
                .iter()
                .map(|node| {
                    let shape = node.shape;
                    shape.channels * extent.lanes[shape.domain] * extent.axis(shape.axis)
                })
                .collect(),
            indices: vec![Arc::from([]); program.indices.len()],
            moving: vec![false; nodes],
            live: vec![false; nodes],
            seeded: vec![false; nodes],
            replay: vec![false; nodes],
            chunks,
            strides,
            places: resolved,
            plans,
            written: Vec::new(),
            workers: (0..threads).map(|_| Worker::new()).collect(),
            column: Buffer::zeros(0),
            arch: Arch::new(),
            extent,
        };
        for (id, node) in program.nodes.iter().enumerate() {
            if let Op::Constant(value) = node.op {
                let mut buffer = Buffer::zeros(1);
                buffer.as_mut_slice().fill(R::from_f64(value));
                state.values[id] = Whole::Owned(buffer);
            } else if program.whole[id] && !node.op.is_leaf() {
                state.values[id] = Whole::Owned(Buffer::zeros(state.len(id)));
            }
        }
        for p in 0..program.phases.len() {
            state.prepare(program, p, Pass::Values);
        }
        state
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
        let chunks = self.chunks.iter().flatten().map(|chunk| {
            let chunk = chunk.lock().unwrap_or_else(PoisonError::into_inner);
            chunk.bytes()
        });
        whole.sum::<usize>()
            + chunks.sum::<usize>()
            + self.workers.iter().map(Worker::bytes).sum::<usize>()
            + tables.map(Buffer::bytes).sum::<usize>()
            + self.column.bytes()
    }

    /// Computes all values, and the tangents of moving nodes when asked to.
    pub fn forward(&mut self, program: &Program, tangents: bool) {
        if tangents {
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
        }
        if tangents {
            for &(_, id) in &program.outputs {
                if !self.moving[id] {
                    let len = self.len(id);
                    let still = own(&mut self.tangents[id]);
                    still.ensure(len);
                    still.as_mut_slice().fill(R::default());
                }
            }
        }
        let pass = if tangents {
            Pass::Tangents
        } else {
            Pass::Values
        };
        for p in 0..program.phases.len() {
            if let Body::Map = program.phases[p].body {
                let id = program.phases[p].nodes[0];
                self.map(program, id, false);
                if tangents && self.moving[id] {
                    self.map(program, id, true);
                }
                continue;
            }
            self.interleave(program, p, tangents);
            self.prepare(program, p, pass);
            self.run(program, p, |env, worker, chunk| {
                passes::forward(env, worker, chunk, tangents)
            });
            self.assemble_values(program, p, tangents);
        }
    }

    /// Brings the tables that a phase looks up into their order.
    fn interleave(&mut self, program: &Program, p: usize, tangents: bool) {
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
                    *seed = *t * *w;
                }
            }
        }
    }

    /// Passes the seeded adjoints back to the parameters.
    pub fn reverse(&mut self, program: &Program) {
        for id in (0..program.nodes.len()).rev() {
            if self.live[id] {
                for &input in &program.nodes[id].inputs {
                    self.live[input] |= program.nodes[input].active;
                }
            }
        }
        for p in (0..program.phases.len()).rev() {
            let phase = &program.phases[p];
            if !phase.nodes.iter().any(|&id| self.live[id]) {
                continue;
            }
            if let Body::Map = phase.body {
                self.map_adjoint(program, phase.nodes[0]);
                continue;
            }
            mark_replay(program, phase, &self.live, &mut self.replay);
            let marks = Marks {
                live: &self.live,
                seeded: &self.seeded,
                replay: &self.replay,
            };
            let plans = &mut self.plans[p];
            reverse_plans(
                program,
                phase,
                &self.places[p],
                &marks,
                &mut self.written,
                plans,
            );
            self.prepare(program, p, Pass::Adjoints);
            self.run(program, p, passes::reverse);
            self.assemble_adjoints(program, p);
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

    /// Makes room for a pass over a phase; does nothing when it ran before.
    fn prepare(&mut self, program: &Program, p: usize, pass: Pass) {
        let (phase, extent, stride) = (&program.phases[p], &self.extent, self.strides[p]);
        for chunk in &mut self.chunks[p] {
            let chunk = chunk.get_mut().unwrap_or_else(PoisonError::into_inner);
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
                    let pull = phase
                        .pulls
                        .iter()
                        .map(|pull| pull_len(program, extent, &span, pull.target, pull.kind));
                    ensure(&mut chunk.pull, pull);
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
        for worker in &mut self.workers {
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
    fn run(
        &mut self,
        program: &Program,
        p: usize,
        work: impl Fn(&Env<R>, &mut Worker<R>, &mut Chunk<R>) + Sync,
    ) {
        let mut workers = std::mem::take(&mut self.workers);
        let env = self.env(program, p);
        let chunks = &self.chunks[p];
        let next = AtomicUsize::new(0);
        let drain = |worker: &mut Worker<R>| {
            while let Some(chunk) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
                let mut chunk = chunk.lock().unwrap_or_else(PoisonError::into_inner);
                work(&env, worker, &mut chunk);
            }
        };
        if workers.len() == 1 || chunks.len() == 1 {
            drain(&mut workers[0]);
        } else {
            workers.par_iter_mut().with_max_len(1).for_each(drain);
        }
        self.workers = workers;
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
        }
    }

    /// Copies what chunks stored and accumulated to whole arrays.
    fn assemble_values(&mut self, program: &Program, p: usize, tangents: bool) {
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
    fn assemble_adjoints(&mut self, program: &Program, p: usize) {
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
            if pull.kind == PullKind::Table {
                layout.assemble_table(self.arch, chunks, i, target, add);
            } else {
                layout.assemble(self.arch, chunks, |chunk| &chunk.pull[i], target, add);
            }
        }
    }

    /// Applies a linear map to values or tangents.
    fn map(&mut self, program: &Program, id: NodeId, tangents: bool) {
        let arrays = if tangents {
            &mut self.tangents
        } else {
            &mut self.values
        };
        let node = &program.nodes[id];
        let Op::Map(map) = &node.op else { return };
        let input = node.inputs[0];
        let mut output = std::mem::take(own(&mut arrays[id]));
        let columns = self.extent.axis(node.shape.axis);
        let (from, to) = (
            self.extent.lanes[program.nodes[input].shape.domain] * columns,
            self.extent.lanes[node.shape.domain] * columns,
        );
        let source = arrays[input].as_slice();
        for c in 0..node.shape.channels {
            let source = &source[c * from..(c + 1) * from];
            let target = &mut output.as_mut_slice()[c * to..(c + 1) * to];
            R::apply_map(map.as_ref(), false, columns, source, target);
        }
        arrays[id] = Whole::Owned(output);
    }

    /// Adds the transpose of a linear map, applied to the adjoint of its result, to the adjoint of its operand.
    fn map_adjoint(&mut self, program: &Program, id: NodeId) {
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
            R::apply_map(map.as_ref(), true, columns, source, column);
            let target = &mut target.as_mut_slice()[c * from..(c + 1) * from];
            put(self.arch, target, column, add);
        }
        self.adjoints[input] = Whole::Owned(target);
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

/// Lanes of the largest block of a phase.
pub(super) fn stride(
    program: &Program,
    extent: &Extent,
    phase: &Phase,
    sizes: &Sizes,
    spans: &[Span],
) -> usize {
    let longest = spans.iter().map(|span| span.lanes.len()).max().unwrap_or(0);
    // Few values of a phase are wide: they may overflow L1 as long as blocks keep enough lanes.
    let wide = (WIDE * sizes.block) / widest(program, extent, phase);
    let wanted = sizes.block.min(wide).min(longest);
    wanted.next_multiple_of(PARTIALS).max(PARTIALS)
}

/// Threads to share work among.
pub(super) fn threads(sizes: &Sizes) -> usize {
    let available = rayon::current_num_threads();
    sizes.threads.unwrap_or(available).clamp(1, available)
}

/// Makes room in an arena for the first `count` locals of a phase.
fn grow<R: Lane>(
    arena: &mut Vec<Buffer<R>>,
    phase: &Phase,
    count: usize,
    room: impl Fn(NodeId) -> usize,
) {
    if arena.len() < count {
        arena.resize_with(count, || Buffer::zeros(0));
    }
    for (slot, &id) in phase.locals[..count].iter().enumerate() {
        arena[slot].grow(room(id));
    }
}

/// Elements of scratch that a block needs: products of a contraction, or the operands of a dense layer, twice.
pub(super) fn scratch_len(program: &Program, phase: &Phase, stride: usize, widest: usize) -> usize {
    let needs = phase.nodes.iter().map(|&id| {
        let node = &program.nodes[id];
        match node.op {
            Op::SegmentDot => stride * widest,
            Op::Matmul => 2 * stride * program.nodes[node.inputs[0]].shape.channels,
            _ => 0,
        }
    });
    needs.max().unwrap_or(0)
}
