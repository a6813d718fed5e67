//! The way from a gradient that is not finite back to the operation that made it so.
//!
//! Adjoints of a block are gone when the next one runs, so that the way cannot be followed afterwards. One more pass back is watched
//! instead: every node whose adjoint is not finite is given the operation that this came from.

use super::block::{Env, Lanes, Whole, Worker};
use super::chunk::Chunk;
use super::driver::State;
use super::inspect::NonFiniteAdjoint;
use super::lane::{Function, Lane};
use super::origin::Spot;
use super::sizes::Extent;
use super::value::{operands, values};
use super::walk::Observer;
use crate::graph::{NodeId, Op};
use crate::program::Program;

/// An operation that made an adjoint which is not finite of finite ones.
#[derive(Clone, Copy)]
struct Made {
    by: NodeId,
    /// The element of its operand, and the adjoint there.
    at: Spot,
    adjoint: f64,
    /// Of an elementwise operation: the channel of the result, and the adjoint there.
    from: Option<(usize, f64)>,
}

/// What made the adjoint of each node not finite, as far as the pass has come.
struct Trace {
    made: Vec<Option<Made>>,
    /// Whole adjoints that have been looked at.
    seen: Vec<bool>,
}

impl<R: Lane> State<R> {
    /// What made the first gradient that is not finite. All gradients have been computed.
    pub(super) fn find_non_finite_adjoint(
        &mut self,
        program: &Program,
    ) -> Option<NonFiniteAdjoint> {
        let nodes = 0..program.nodes.len();
        let param = nodes.clone().find(|&id| {
            let gradient = matches!(program.nodes[id].op, Op::Param) && self.live[id];
            gradient && self.whole_adjoints(program).spoilt(id).is_some()
        })?;
        let mut trace = Trace {
            made: vec![None; nodes.len()],
            seen: vec![false; nodes.len()],
        };
        self.walk(program, &mut trace);
        trace.look(self.whole_adjoints(program), param);
        let made = trace.made[param]?;
        let operands = made.from.map(|(channel, _)| {
            let result = Spot {
                id: made.by,
                channel,
                ..made.at
            };
            self.operands(program, result)
        });
        Some(NonFiniteAdjoint {
            parameter: program.node_name(param),
            origin: program.node_name(made.by),
            operand: program.node_name(made.at.id),
            lane: made.at.lane,
            channel: made.at.channel,
            position: made.at.position,
            adjoint: made.adjoint,
            incoming: made.from.map(|(_, incoming)| incoming),
            operands: operands.unwrap_or_default(),
        })
    }

    fn whole_adjoints<'a>(&'a self, program: &'a Program) -> WholeAdjoints<'a, R> {
        WholeAdjoints {
            program,
            extent: &self.extent,
            live: &self.live,
            adjoints: &self.adjoints,
        }
    }
}

impl<R: Lane> Observer<R> for Trace {
    #[allow(private_interfaces)]
    fn before_adjoint(&mut self, env: &Env<R>, _: &mut Worker<R>, _: Lanes, id: NodeId) {
        if env.seeded[id] {
            self.look(WholeAdjoints::of(env), id);
        }
    }

    #[allow(private_interfaces)]
    fn after_adjoint(
        &mut self,
        env: &Env<R>,
        worker: &Worker<R>,
        chunk: &Chunk<R>,
        lanes: Lanes,
        id: NodeId,
    ) {
        let node = &env.program.nodes[id];
        let passed = match node.op.is_sink() {
            true => env.seeded[id],
            false => worker.written[env.slot(id)],
        };
        for (i, &input) in node.inputs.iter().enumerate() {
            if !passed || !env.live[input] || self.made[input].is_some() {
                continue;
            }
            let found = match node.op.reads_whole(i) {
                true => accumulated(env, chunk, id, input),
                false => local(env, worker, lanes, input),
            };
            let Some((at, adjoint)) = found else { continue };
            let from = passed_on(env, worker, lanes, id, i, at);
            // Where elements cannot be told apart, a result that is not finite is to blame for its operands.
            let inherited = from.is_none_or(|(_, incoming)| !incoming.is_finite());
            let made = Made {
                by: id,
                at,
                adjoint,
                from,
            };
            let before = self.made[id].filter(|_| inherited);
            self.made[input] = before.or(Some(made));
        }
    }
}

/// Whole adjoints, as the passes before left them.
#[derive(Clone, Copy)]
struct WholeAdjoints<'a, R> {
    program: &'a Program,
    extent: &'a Extent,
    live: &'a [bool],
    adjoints: &'a [Whole<R>],
}

impl<'a, R: Lane> WholeAdjoints<'a, R> {
    fn of(env: &Env<'a, R>) -> Self {
        WholeAdjoints {
            program: env.program,
            extent: env.extent,
            live: env.live,
            adjoints: env.adjoints,
        }
    }

    /// The first element of a node's adjoint that is not finite.
    fn spoilt(self, id: NodeId) -> Option<(Spot, f64)> {
        let shape = self.program.nodes[id].shape;
        let (lanes, axis) = (
            self.extent.lanes[shape.domain],
            self.extent.axis(shape.axis),
        );
        let adjoint = self.adjoints[id].as_slice();
        let k = adjoint.iter().position(|x| !x.is_finite())?;
        let at = Spot {
            id,
            channel: k / (lanes * axis),
            lane: k / axis % lanes,
            position: k % axis,
        };
        Some((at, adjoint[k].to_f64()))
    }
}

impl Trace {
    /// Looks at a whole adjoint, once all that adds to it has run. What blocks added has been watched: left are linear maps, and sums
    /// over many lanes that are too large.
    fn look<R: Lane>(&mut self, whole: WholeAdjoints<R>, id: NodeId) {
        if self.made[id].is_some() || std::mem::replace(&mut self.seen[id], true) {
            return;
        }
        let Some((at, adjoint)) = whole.spoilt(id) else {
            return;
        };
        let nodes = &whole.program.nodes;
        let uses = |&user: &NodeId| whole.live[user] && nodes[user].inputs.contains(&id);
        let users: Vec<NodeId> = (id + 1..nodes.len()).filter(uses).collect();
        let is_map = |&&user: &&NodeId| matches!(nodes[user].op, Op::Map(_));
        for &map in users.iter().filter(is_map) {
            self.look(whole, map);
            if self.made[map].is_some() {
                self.made[id] = self.made[map];
                return;
            }
        }
        let by = users.iter().find(is_map).or(users.first());
        self.made[id] = by.map(|&by| Made {
            by,
            at,
            adjoint,
            from: None,
        });
    }
}

/// The first element of an operand's adjoint that is not finite in a block.
fn local<R: Lane>(
    env: &Env<R>,
    worker: &Worker<R>,
    lanes: Lanes,
    id: NodeId,
) -> Option<(Spot, f64)> {
    let (slot, axis) = (env.slot(id), env.axis(id));
    let adjoint = worker.adjoints[slot].as_slice();
    (0..env.channels(id)).find_map(|channel| {
        let row = &adjoint[channel * env.pitch(id)..][..lanes.len * axis];
        let k = row.iter().position(|x| !x.is_finite())?;
        let at = Spot {
            id,
            channel,
            lane: lanes.start + k / axis,
            position: k % axis,
        };
        Some((at, row[k].to_f64()))
    })
}

/// The same of an adjoint that chunks accumulate for a user: where the whole of it is not finite, if this is not.
fn accumulated<R: Lane>(
    env: &Env<R>,
    chunk: &Chunk<R>,
    user: NodeId,
    id: NodeId,
) -> Option<(Spot, f64)> {
    let pulls = env.phase.pulls.iter().zip(env.bucketings).zip(&chunk.pull);
    let mut pulls = pulls.filter(|((pull, _), _)| pull.is(id, user));
    let spoilt = pulls.any(|((_, bucketing), sums)| match bucketing {
        Some(bucketing) => bucketing.spoils(sums.as_slice(), chunk.span.lanes.len()),
        None => sums.as_slice().iter().any(|x| !x.is_finite()),
    });
    spoilt.then(|| WholeAdjoints::of(env).spoilt(id)).flatten()
}

/// The channel of an elementwise result from which an operand's adjoint at an element was not finite, and the adjoint there.
fn passed_on<R: Lane>(
    env: &Env<R>,
    worker: &Worker<R>,
    lanes: Lanes,
    id: NodeId,
    i: usize,
    at: Spot,
) -> Option<(usize, f64)> {
    let node = &env.program.nodes[id];
    let function = Function::of(node)?;
    let (slot, axis) = (env.slot(id), env.axis(id));
    let k = (at.lane - lanes.start) * axis + at.position;
    let row = |channel: usize| channel * env.pitch(id)..channel * env.pitch(id) + lanes.len * axis;
    let spoils = |&channel: &usize| {
        let x = operands(env, values(env, worker), lanes, &node.inputs, channel);
        let y = &worker.values[slot].as_slice()[row(channel)];
        let g = &worker.adjoints[slot].as_slice()[row(channel)];
        let mut part = vec![R::default(); y.len()];
        let x = &x[..node.inputs.len()];
        function.pass(env.arch, i, x, y, g, &mut part, false);
        !part[k].is_finite()
    };
    let channels = match env.channels(at.id) {
        1 => 0..node.shape.channels,
        _ => at.channel..at.channel + 1,
    };
    // None does where finite shares have too large a sum.
    let channel = channels.clone().find(spoils).unwrap_or(channels.start);
    let incoming = worker.adjoints[slot].as_slice()[row(channel)][k];
    Some((channel, incoming.to_f64()))
}
