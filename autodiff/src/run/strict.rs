//! Finds where derivatives are not finite, masked or not.

use std::fmt;

use super::block::{Env, Lanes, View, Worker};
use super::lane::{Function, Lane};
use super::lookup::row_width;
use super::segments::pieces;
use super::value::{operands, values};
use super::walk::Observer;
use super::workspace::Workspace;
use crate::error::RunError;
use crate::graph::{NodeId, Op};
use crate::program::Program;
use crate::real::Scalar;

/// A place where a partial derivative is infinite or NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Singularity {
    /// The label of the operation's result, or the operation and its place in the source.
    pub origin: String,
    /// The operand whose partial derivative it is, counted from 0.
    pub operand: usize,
    /// Whether the adjoint there is exactly 0, so that nothing was contributed. If not, the gradient is not finite.
    pub masked: bool,
    /// How many elements it concerns.
    pub count: usize,
    /// The first of their lanes.
    pub lane: usize,
    /// The partial derivative there.
    pub partial: f64,
    /// The values of the operands there; of the other factor alone where an operation multiplies many.
    pub at: Vec<f64>,
}

impl fmt::Display for Singularity {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (what, hint) = match self.masked {
            true => ("masked: contributes 0", ""),
            false => (
                "NOT masked: spoils the gradient",
                "; select the operand, not only the result, or keep it away from here",
            ),
        };
        write!(
            f,
            "`{}`: derivative by operand {} is {} at lane {} ({} in all), operands {:?}; {what}{hint}",
            self.origin, self.operand, self.partial, self.lane, self.count, self.at
        )
    }
}

struct Strict {
    found: Vec<(NodeId, Singularity)>,
    names: Vec<String>,
}

impl<R: Lane> Observer<R> for Strict {
    fn wants_values(&self) -> bool {
        true
    }

    #[allow(private_interfaces)]
    fn before_adjoint(&mut self, env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
        let node = &env.program.nodes[id];
        if let Op::SegmentDot = node.op {
            return self.segment_dot(env, values(env, worker), lanes, id);
        }
        if node.op.is_sink() || !worker.written[env.slot(id)] {
            return;
        }
        let slot = env.slot(id);
        let Some(function) = Function::of(node) else {
            let (view, adjoint) = (values(env, worker), worker.adjoints[slot].as_slice());
            match &node.op {
                Op::Matmul => self.matmul(env, view, lanes, id, adjoint),
                Op::GatherWeighted(indices) => {
                    self.gather_weighted(env, view, lanes, id, indices, adjoint)
                }
                _ => {}
            }
            return;
        };
        let axis = env.axis(id);
        let len = lanes.len * axis;
        let ones = vec![R::from_f64(1.0); len];
        let (mut partial, mut value) = (ones.clone(), ones.clone());
        let view = values(env, worker);
        for (i, &input) in node.inputs.iter().enumerate() {
            if !env.live[input] {
                continue;
            }
            for c in 0..node.shape.channels {
                let x = operands(env, view, lanes, &node.inputs, c);
                let x = &x[..node.inputs.len()];
                function.evaluate(env.arch, x, &mut value);
                function.pass(env.arch, i, x, &value, &ones, &mut partial, false);
                let start = c * env.pitch(id);
                let adjoint = &worker.adjoints[slot].as_slice()[start..start + len];
                for k in 0..len {
                    if !partial[k].is_finite() {
                        let at = x.iter().map(|x| x[k].to_f64()).collect();
                        let masked = adjoint[k].is_zero();
                        let lane = lanes.start + k / axis;
                        self.add(id, i, masked, lane, partial[k].to_f64(), at);
                    }
                }
            }
        }
    }
}

/// Operations that multiply their operands: the derivative by one is the value of the other.
impl Strict {
    fn segment_dot<R: Lane>(&mut self, env: &Env<R>, view: View<R>, lanes: Lanes, id: NodeId) {
        if !env.seeded[id] {
            return;
        }
        let (axis, all) = (env.axis(id), env.all_lanes(id));
        let inputs = &env.program.nodes[id].inputs;
        let g = env.adjoints[id].as_slice();
        for (i, other) in [(0, inputs[1]), (1, inputs[0])] {
            if !env.live[inputs[i]] {
                continue;
            }
            let along = env.axis(other);
            for piece in pieces(env, lanes) {
                for c in 0..env.channels(id) {
                    let row = (c * all + piece.parent) * axis;
                    let g = &g[row..row + axis];
                    for lane in piece.lanes.clone() {
                        let at = (lane - lanes.start) * along;
                        let factors = &env.channel(view, lanes, other, c)[at..at + along];
                        for (k, x) in factors.iter().enumerate() {
                            let g = if along == axis { &g[k..k + 1] } else { g };
                            self.factor(id, i, g.iter().all(|g| g.is_zero()), lane, *x);
                        }
                    }
                }
            }
        }
    }

    fn matmul<R: Lane>(&mut self, env: &Env<R>, view: View<R>, lanes: Lanes, id: NodeId, g: &[R]) {
        let inputs = &env.program.nodes[id].inputs;
        let (x, weight) = (inputs[0], inputs[1]);
        let adjoint = |row: usize, lane: usize| g[row * env.pitch(id) + lane].is_zero();
        let (rows, inner) = (env.channels(id), env.channels(x));
        for c in (0..inner).filter(|_| env.live[weight]) {
            for (lane, x) in env.channel(view, lanes, x, c).iter().enumerate() {
                let masked = || (0..rows).all(|row| adjoint(row, lane));
                if !x.is_finite() {
                    self.factor(id, 1, masked(), lanes.start + lane, *x);
                }
            }
        }
        let matrix = view.whole[weight].as_slice();
        for (i, w) in matrix.iter().enumerate().filter(|_| env.live[x]) {
            for lane in (0..lanes.len).filter(|_| !w.is_finite()) {
                self.factor(id, 0, adjoint(i / inner, lane), lanes.start + lane, *w);
            }
        }
    }

    fn gather_weighted<R: Lane>(
        &mut self,
        env: &Env<R>,
        view: View<R>,
        lanes: Lanes,
        id: NodeId,
        indices: &[usize],
        g: &[R],
    ) {
        let inputs = &env.program.nodes[id].inputs;
        let (channels, axis) = (env.channels(id), env.axis(id));
        let adjoint = |i: usize, lane: usize| {
            let (channel, k) = (i / axis, i % axis);
            g[channel * env.pitch(id) + lane * axis + k].is_zero()
        };
        let table = view.table(env, inputs[0]);
        let width = row_width(channels, axis);
        for (corner, &weight) in inputs[1..].iter().enumerate() {
            let weights = env.channel(view, lanes, weight, 0);
            let index = &env.indices[indices[corner]][lanes.start..lanes.start + lanes.len];
            for (lane, (w, i)) in weights.iter().zip(index).enumerate() {
                if env.live[inputs[0]] {
                    let masked = (0..channels * axis).all(|i| adjoint(i, lane));
                    self.factor(id, 0, masked, lanes.start + lane, *w);
                }
                let row = &table[*i as usize * width..][..channels * axis];
                for (i, x) in row.iter().enumerate().filter(|_| env.live[weight]) {
                    let at = lanes.start + lane;
                    self.factor(id, corner + 1, adjoint(i, lane), at, *x);
                }
            }
        }
    }

    /// Looks at the derivative by an operand of a product: the other factor.
    fn factor<R: Lane>(&mut self, id: NodeId, operand: usize, masked: bool, lane: usize, x: R) {
        if !x.is_finite() {
            let x = x.to_f64();
            self.add(id, operand, masked, lane, x, vec![x]);
        }
    }

    fn add(
        &mut self,
        id: NodeId,
        operand: usize,
        masked: bool,
        lane: usize,
        partial: f64,
        at: Vec<f64>,
    ) {
        let known = self.found.iter_mut().find(|(known, singularity)| {
            (*known, singularity.operand, singularity.masked) == (id, operand, masked)
        });
        if let Some((_, singularity)) = known {
            singularity.count += 1;
            return;
        }
        let singularity = Singularity {
            origin: self.names[id].clone(),
            operand,
            masked,
            count: 1,
            lane,
            partial,
            at,
        };
        self.found.push((id, singularity));
    }
}

impl Program {
    /// Strict mode: computes a gradient of `output` and tells where a partial derivative was infinite or NaN. Where the adjoint
    /// is exactly 0 it was suppressed, as in the branch of a selection that is not taken ([`Singularity::masked`]); elsewhere
    /// it reached the gradient. For debugging: runs on one thread, node by node.
    ///
    /// # Errors
    /// As [`Program::vjp`].
    pub fn find_singularities<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        output: &str,
    ) -> Result<Vec<Singularity>, RunError> {
        self.vjp(ws, output)?;
        let mut strict = Strict {
            found: Vec::new(),
            names: (0..self.nodes.len()).map(|id| self.node_name(id)).collect(),
        };
        S::walk(&mut ws.state, self, &mut strict);
        Ok(strict.found.into_iter().map(|(_, found)| found).collect())
    }
}
