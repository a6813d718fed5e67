//! Gradients of phases over segments and of what reads their sums, block by block: forward and back in one go.
//!
//! Every element goes through the same operations in the same order as in separate passes: the results are the same bits.

use std::ops::Range;

use super::block::{Env, Lanes, Place, Worker, blocks, store};
use super::chunk::{Chunk, Span, widest};
use super::driver::{Pass, State, lock, share, unlocked};
use super::lane::Lane;
use super::passes::{
    clear, fill_constants, forward_step, pull_lanes, replay, reverse_block, sink_position,
};
use super::room::{grow, scratch_len};
use super::segments::segments_of;
use super::sizes::Extent;
use super::tiles::{Known, kept_len, tile_len};
use crate::graph::{NodeId, Op};
use crate::program::{Fusion, NONE, Program};

/// The fusion that a workspace makes use of.
pub(super) struct Fused {
    /// Which of the program's.
    at: usize,
    /// Where the outer phase finds its nodes when the sums that it reads are in its arena.
    places: Vec<Place>,
}

impl Fused {
    pub fn new(
        program: &Program,
        extent: &Extent,
        strides: &[usize],
        places: &[Vec<Place>],
    ) -> Option<Self> {
        let at = chosen(program, extent, |p| strides[p])?;
        let fusion = &program.fusions[at];
        let outer = fusion.outer.map(|outer| places[outer].clone());
        let mut places = outer.unwrap_or_default();
        fusion.sums.iter().for_each(|&id| places[id].compute());
        Some(Fused { at, places })
    }
}

/// The fusion over the most lanes, if its segments fit into blocks.
fn chosen(program: &Program, extent: &Extent, stride: impl Fn(usize) -> usize) -> Option<usize> {
    let domain = |fusion: &Fusion| program.phases[fusion.inner].domain;
    let fits = |fusion: &Fusion| {
        let parents = program.domains[domain(fusion)]
            .parent
            .map(|p| extent.lanes[p]);
        let segments = extent.segments[domain(fusion)].as_ref();
        fusion.outer.is_none()
            || segments
                .zip(parents)
                .is_some_and(|(segments, n)| segments.longest(n) <= stride(fusion.inner))
    };
    let all = program.fusions.iter().enumerate();
    let fitting = all.filter(|(_, fusion)| fits(fusion));
    let largest = fitting.max_by_key(|(_, fusion)| extent.lanes[domain(fusion)]);
    largest.map(|(at, _)| at)
}

/// Elements that a thread holds for a fusion, buffer by buffer.
pub(super) fn lengths(
    program: &Program,
    extent: &Extent,
    stride: impl Fn(usize) -> usize,
) -> Vec<usize> {
    let Some(at) = chosen(program, extent, &stride) else {
        return Vec::new();
    };
    let fusion = &program.fusions[at];
    let inner = &program.phases[fusion.inner];
    let mut lengths = vec![kept_len(program, extent, inner, stride(fusion.inner))];
    if let Some(outer) = fusion.outer {
        let (phase, stride) = (&program.phases[outer], stride(outer));
        let room = room(program, extent, stride);
        // Values and adjoints.
        let arena = phase.locals.iter().flat_map(|&id| [room(id); 2]);
        let widest = widest(program, extent, phase);
        let scratch = scratch_len(program, phase, stride, widest);
        lengths.extend(arena.chain([scratch, tile_len(phase)]));
    }
    lengths
}

/// Elements of a node in an arena.
fn room(program: &Program, extent: &Extent, stride: usize) -> impl Fn(NodeId) -> usize {
    move |id| {
        let shape = program.nodes[id].shape;
        shape.channels * stride * extent.axis(shape.axis)
    }
}

impl<R: Lane> State<R> {
    /// All values, and the seeded adjoints passed back to the parameters.
    pub fn gradient(&mut self, program: &Program) {
        self.spread_liveness(program);
        let closed = |fused: &Fused| {
            let fusion = &program.fusions[fused.at];
            fusion.is_closed(&program.phases, &self.live, &self.seeded)
        };
        let closed = self
            .fused
            .as_ref()
            .filter(|fused| R::PACKED && closed(fused));
        let last = closed.map(|fused| program.fusions[fused.at].last());
        let possible = last.is_some_and(|last| self.is_linear_after(program, last));
        let Some(fused) = self.fused.clone().filter(|_| possible) else {
            self.forward(program, false);
            return self.reverse(program, 0..program.phases.len(), None);
        };
        let fusion = &program.fusions[fused.at];
        let (inner, last) = (fusion.inner, fusion.last());
        self.reverse(program, last + 1..program.phases.len(), None);
        for p in 0..inner {
            self.forward_phase(program, p, false);
        }
        self.run_fused(program, &fused);
        self.assemble_values(program, inner, false);
        for p in inner + 1..program.phases.len() {
            self.forward_phase(program, p, false);
        }
        self.reverse(program, 0..last + 1, Some(inner));
    }

    /// Whether the way back through all phases after `p` needs no value that is computed.
    fn is_linear_after(&mut self, program: &Program, p: usize) -> bool {
        self.replay.fill(false);
        for p in p + 1..program.phases.len() {
            self.mark_replay(program, p);
        }
        let mut later = program.phases[p + 1..]
            .iter()
            .flat_map(|phase| &phase.nodes);
        let reads_whole = |op: &Op| matches!(op, Op::Matmul | Op::GatherWeighted(_));
        let mut nodes = program.nodes.iter().enumerate();
        nodes.all(|(id, node)| node.op.is_leaf() || !self.replay[id])
            && later.all(|&id| !self.live[id] || !reads_whole(&program.nodes[id].op))
    }

    fn run_fused(&mut self, program: &Program, fused: &Fused) {
        let fusion = &program.fusions[fused.at];
        let inner = fusion.inner;
        self.interleave(program, inner, false);
        // The inner phase will find the adjoints of its sums.
        self.mark_sums(fusion, true);
        self.plan_reverse(program, inner);
        self.mark_sums(fusion, false);
        self.prepare(program, inner, Pass::Values);
        self.prepare(program, inner, Pass::Adjoints);
        let kept = kept_len(
            program,
            &self.extent,
            &program.phases[inner],
            self.strides[inner],
        );
        let workers = unlocked(&mut self.workers);
        workers.iter_mut().for_each(|w| w.kept.grow(kept));
        if let Some(outer) = fusion.outer {
            self.interleave(program, outer, false);
            self.plan_reverse(program, outer);
            self.prepare_above(program, outer);
        }
        let env = self.env(program, inner);
        let outer = fusion.outer.map(|outer| Env {
            places: &fused.places,
            ..self.env(program, outer)
        });
        let mut workers = lock(&self.workers);
        share(&mut workers, &self.chunks[inner], |worker, chunk| {
            clear(&mut chunk.sink);
            clear(&mut chunk.pull);
            fill_constants(&env, worker, |_| true);
            match (&outer, worker.above.take()) {
                (Some(outer), Some(mut above)) => {
                    run_segments(&env, outer, &fusion.sums, worker, &mut above, chunk);
                    worker.above = Some(above);
                }
                _ => run_blocks(&env, worker, chunk),
            }
        });
    }

    fn mark_sums(&mut self, fusion: &Fusion, known: bool) {
        for &id in fusion.sums.iter().filter(|&&id| self.live[id]) {
            self.seeded[id] = known;
        }
    }

    /// Makes room for the outer phase in an arena of its own.
    fn prepare_above(&mut self, program: &Program, outer: usize) {
        let (phase, stride) = (&program.phases[outer], self.strides[outer]);
        let room = room(program, &self.extent, stride);
        let widest = widest(program, &self.extent, phase);
        for worker in unlocked(&mut self.workers) {
            let above = worker.above.get_or_insert_with(|| Box::new(Worker::new()));
            grow(&mut above.values, phase, phase.locals.len(), &room);
            grow(&mut above.adjoints, phase, phase.locals.len(), &room);
            if above.written.len() < phase.locals.len() {
                above.written.resize(phase.locals.len(), false);
            }
            above
                .scratch
                .grow(scratch_len(program, phase, stride, widest));
            above.tile.grow(tile_len(phase));
        }
    }
}

/// The blocks of a chunk, forward and back: all adjoints are known.
fn run_blocks<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, chunk: &mut Chunk<R>) {
    for lanes in blocks(chunk, env.stride) {
        run_forward(env, worker, chunk, lanes);
        reverse_block(env, worker, chunk, lanes, Some(&Known::nothing()));
        pull_lanes(env, worker, chunk, lanes);
    }
}

fn run_forward<R: Lane>(env: &Env<R>, worker: &mut Worker<R>, chunk: &mut Chunk<R>, lanes: Lanes) {
    for step in &env.phase.steps {
        forward_step(env, worker, chunk, lanes, *step, true);
    }
    let span = chunk.span.clone();
    store(env, &span, lanes, &worker.values, &mut chunk.store, |_| {
        true
    });
}

/// The segments of a chunk, forward and back.
fn run_segments<R: Lane>(
    env: &Env<R>,
    outer: &Env<R>,
    sums: &[NodeId],
    worker: &mut Worker<R>,
    above: &mut Worker<R>,
    chunk: &mut Chunk<R>,
) {
    fill_constants(outer, above, |id| outer.replay[id]);
    let all = chunk.span.parents.clone();
    let mut start = all.start;
    while start < all.end {
        let (lanes, parents) = whole_segments(env, start..all.end, outer.stride);
        start = parents.end;
        if lanes.len == 0 {
            continue;
        }
        run_forward(env, worker, chunk, lanes);
        run_outer(env, outer, sums, above, chunk, &parents);
        let known = Known {
            adjoints: &above.adjoints,
            places: outer.places,
            sums,
            first: parents.start,
        };
        reverse_block(env, worker, chunk, lanes, Some(&known));
        pull_lanes(env, worker, chunk, lanes);
    }
}

/// As many whole segments from the start of `parents` as fit into a block, at least one.
fn whole_segments<R>(env: &Env<R>, parents: Range<usize>, most: usize) -> (Lanes, Range<usize>) {
    let segments = segments_of(env);
    let (start, mut end) = segments.bounds(parents.start);
    let mut next = parents.start + 1;
    while next < parents.end && next - parents.start < most {
        let (_, longer) = segments.bounds(next);
        if longer - start > env.stride {
            break;
        }
        (end, next) = (longer, next + 1);
    }
    let len = end - start;
    (Lanes { start, len }, parents.start..next)
}

/// The adjoints of the sums of `parents`, which the chunk has just summed.
fn run_outer<R: Lane>(
    env: &Env<R>,
    outer: &Env<R>,
    sums: &[NodeId],
    above: &mut Worker<R>,
    chunk: &Chunk<R>,
    parents: &Range<usize>,
) {
    let all = chunk.span.parents.len();
    let first = parents.start - chunk.span.parents.start;
    for &id in sums.iter().filter(|&&id| outer.places[id].slot != NONE) {
        let at = sink_position(env, id);
        let source = chunk.sink[at].as_slice();
        let pitch = outer.pitch(id);
        let target = above.values[outer.slot(id)].as_mut_slice();
        for c in 0..outer.channels(id) {
            let from = c * all + first;
            target[c * pitch..c * pitch + parents.len()]
                .copy_from_slice(&source[from..from + parents.len()]);
        }
    }
    let lanes = Lanes {
        start: parents.start,
        len: parents.len(),
    };
    // Nothing that is whole takes part, so nothing is accumulated.
    let mut nothing = Chunk {
        span: Span {
            lanes: parents.clone(),
            parents: 0..0,
        },
        ..Chunk::default()
    };
    replay(outer, above, lanes);
    reverse_block(outer, above, &mut nothing, lanes, None);
    for &id in sums.iter().filter(|&&id| outer.places[id].slot != NONE) {
        let slot = outer.slot(id);
        if !above.written[slot] {
            above.adjoints[slot].as_mut_slice().fill(R::default());
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Graph, Program, Sizes, Workspace};

    /// A loss of the means of samples, and what keeps it from being known pixel by pixel.
    fn program(total: bool) -> Program {
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let sample = g.segments("sample", &pixel);
        let gain = g.param("gain", &pixel, 3);
        let light = g.input("light", &sample, 1);
        let mean = (gain.expand(&sample) * &light).exp().segment_mean();
        let loss = mean.square().sum();
        let loss = if total { loss.sqrt() } else { loss * 0.5 + 1.0 };
        g.compile(&[("loss", &loss)]).unwrap()
    }

    fn workspace(program: &Program, block: usize) -> Workspace<f32> {
        let sizes = Sizes::new()
            .lanes("pixel", 500)
            .per_parent("sample", 70)
            .block(block);
        let mut ws = program.workspace::<f32>(&sizes).unwrap();
        let numbers = |n: usize| (0..n).map(|i| (i * 37 % 101) as f32 * 0.01);
        ws.set("gain", &numbers(1500).collect::<Vec<_>>()).unwrap();
        let light: Vec<f32> = numbers(35_000).collect();
        ws.set("light", &light).unwrap();
        ws
    }

    #[test]
    fn a_loss_of_pixels_is_fused_where_segments_fit_into_blocks() {
        let program = program(false);
        let with_outer = |program: &Program| program.fusions.iter().any(|f| f.outer.is_some());
        assert!(with_outer(&program));
        let fused = |block: usize| {
            let fused = workspace(&program, block).state.fused;
            fused.is_some_and(|fused| program.fusions[fused.at].outer.is_some())
        };
        assert!(fused(1024) && !fused(64));
        let run = |block: usize, before: bool| {
            let mut ws = workspace(&program, block);
            if before {
                program.forward(&mut ws).unwrap();
            }
            program.vjp(&mut ws, "loss").unwrap();
            let bits = ws.gradient("gain").unwrap().iter().map(|x| x.to_bits());
            (
                ws.output("loss").unwrap()[0].to_bits(),
                bits.collect::<Vec<_>>(),
            )
        };
        let apart = run(1024, true);
        assert!(apart == run(1024, false) && apart == run(128, false) && apart == run(64, false));
    }

    #[test]
    fn a_loss_that_needs_all_pixels_first_is_right_too() {
        let program = program(true);
        let mut ws = workspace(&program, 1024);
        program.vjp(&mut ws, "loss").unwrap();
        let fused = ws.gradient("gain").unwrap().to_vec();
        program.forward(&mut ws).unwrap();
        program.vjp(&mut ws, "loss").unwrap();
        assert_eq!(ws.gradient("gain").unwrap(), fused);
    }
}
