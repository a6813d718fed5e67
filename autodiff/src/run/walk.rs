//! Runs a program node by node on one thread, watched: for profiles and for finding singularities.

use super::adjoint::adjoint;
use super::block::{Env, Lanes, Worker, blocks, is_constant};
use super::chunk::Chunk;
use super::driver::{State, lock};
use super::lane::Lane;
use super::passes::{fill_constants, replay_node, seed, sink_position};
use super::sinks::accumulate;
use super::value::value;
use crate::graph::NodeId;
use crate::program::{Body, Program};

/// Which way a node runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    Forward,
    Reverse,
}

/// Watches the nodes of a run.
pub(crate) trait Observer<R> {
    /// Wraps the work of a node on a block, or of a linear map.
    fn around(&mut self, id: NodeId, way: Way, work: &mut dyn FnMut()) {
        let _ = (id, way);
        work();
    }
    /// Whether the way back needs all values, not only those that adjoints are made of.
    fn wants_values(&self) -> bool {
        false
    }
    /// Sees a block before a node passes its adjoint on.
    #[allow(private_interfaces)]
    fn before_adjoint(&mut self, env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
        let _ = (env, worker, lanes, id);
    }
    /// Sees it once the node has.
    #[allow(private_interfaces)]
    fn after_adjoint(
        &mut self,
        env: &Env<R>,
        worker: &Worker<R>,
        chunk: &Chunk<R>,
        lanes: Lanes,
        id: NodeId,
    ) {
        let _ = (env, worker, chunk, lanes, id);
    }
}

impl<R: Lane> State<R> {
    /// Runs forward and, in reverse, what is live; both must have run before. Leaves all results as they were.
    pub(super) fn walk(&mut self, program: &Program, observer: &mut dyn Observer<R>) {
        for p in 0..program.phases.len() {
            match program.phases[p].body {
                Body::Map => {
                    let id = program.phases[p].nodes[0];
                    observer.around(id, Way::Forward, &mut || self.map(program, id, false));
                }
                Body::Block => self.walk_phase(program, p, |env, worker, chunk| {
                    walk_forward(env, worker, chunk, observer)
                }),
            }
        }
        for p in (0..program.phases.len()).rev() {
            let phase = &program.phases[p];
            let live = phase.nodes.iter().any(|&id| self.live[id]);
            if !live || matches!(phase.body, Body::Map) {
                continue;
            }
            self.mark_replay(program, p);
            self.walk_phase(program, p, |env, worker, chunk| {
                walk_reverse(env, worker, chunk, observer)
            });
        }
    }

    fn walk_phase(
        &mut self,
        program: &Program,
        p: usize,
        mut work: impl FnMut(&Env<R>, &mut Worker<R>, &mut Chunk<R>),
    ) {
        let mut workers = lock(&self.workers);
        if let Some(worker) = workers.first_mut() {
            let env = self.env(program, p);
            for chunk in &self.chunks[p] {
                work(&env, worker, &mut lock(chunk));
            }
        }
    }
}

fn walk_forward<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    observer: &mut dyn Observer<R>,
) {
    for sink in &mut chunk.sink {
        sink.as_mut_slice().fill(R::default());
    }
    fill_constants(env, worker, |_| true);
    for lanes in blocks(chunk, env.stride) {
        for &id in &env.phase.nodes {
            let op = &env.program.nodes[id].op;
            observer.around(id, Way::Forward, &mut || {
                if op.is_sink() {
                    let at = sink_position(env, id);
                    accumulate(env, worker, chunk, lanes, id, at, false);
                } else if !is_constant(op) {
                    value(env, worker, lanes, id);
                }
            });
        }
    }
}

fn walk_reverse<R: Lane>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    observer: &mut dyn Observer<R>,
) {
    for pull in &mut chunk.pull {
        pull.as_mut_slice().fill(R::default());
    }
    fill_constants(env, worker, |_| true);
    for lanes in blocks(chunk, env.stride) {
        for &id in &env.phase.nodes {
            let op = &env.program.nodes[id].op;
            let wanted = observer.wants_values() && !op.is_sink() && !is_constant(op);
            observer.around(id, Way::Reverse, &mut || match wanted {
                true => value(env, worker, lanes, id),
                false => replay_node(env, worker, lanes, id),
            });
        }
        worker.written[..env.phase.locals.len()].fill(false);
        seed(env, worker, lanes);
        for &id in env.phase.nodes.iter().rev() {
            if env.live[id] {
                observer.before_adjoint(env, worker, lanes, id);
                observer.around(id, Way::Reverse, &mut || {
                    adjoint(env, worker, chunk, lanes, id)
                });
                observer.after_adjoint(env, worker, chunk, lanes, id);
            }
        }
    }
}
