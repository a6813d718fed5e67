//! Finds where derivatives are not finite, masked or not.

use std::fmt;

use super::block::{Env, Lanes, Worker};
use super::lane::{Function, Lane};
use super::value::{operands, values};
use super::walk::Observer;
use super::workspace::Workspace;
use crate::error::RunError;
use crate::graph::NodeId;
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
    /// The values of the operands there.
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
    #[allow(private_interfaces)]
    fn before_adjoint(&mut self, env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
        let node = &env.program.nodes[id];
        let Some(function) = Function::of(node) else {
            return;
        };
        let slot = env.slot(id);
        if !worker.written[slot] {
            return;
        }
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

impl Strict {
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
