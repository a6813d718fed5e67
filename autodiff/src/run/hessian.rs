//! Hessian-vector products: the reverse pass, run on dual numbers.

use super::driver::{State, own};
use super::modes::Engine;
use super::workspace::{Workspace, not_computed};
use crate::buffer::Buffer;
use crate::error::RunError;
use crate::graph::Op;
use crate::program::Program;
use crate::real::{Real, Scalar};

/// What Hessian-vector products keep: a state of dual numbers, and their results.
pub(super) struct Curvature<S: Scalar> {
    state: State<S::Dual>,
    products: Vec<Buffer<S>>,
}

impl Program {
    /// Product of the Hessian of an output (of the sum of its elements) with a direction in parameter space; parameters not
    /// named stand still. Read it with [`Workspace::hessian_product`]; the gradient is computed too.
    ///
    /// Exact: forward differentiation of the reverse pass. It needs about twice the memory of a gradient in addition
    /// ([`crate::Memory::hessian`]). What is detached is held still, as samples are.
    ///
    /// # Errors
    /// As [`Program::jvp`] and [`Program::vjp`]; an operation that is [`crate::FirstOrderOnly`] where the gradient passes it.
    pub fn hvp<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        output: &str,
        direction: &[(&str, &[S])],
    ) -> Result<(), RunError> {
        ws.check_ready(self)?;
        let target = ws.output_id(output)?;
        ws.state.mark_live(self, target);
        for (node, live) in self.nodes.iter().zip(&ws.state.live) {
            if let Op::Custom(op) = &node.op
                && *live
                && op.is_first_order()
            {
                return Err(RunError::FirstOrderOnly {
                    op: op.name().to_string(),
                });
            }
        }
        for (name, tangent) in direction {
            let (id, len) = ws.param(name)?;
            ws.check_len(name, id, len, tangent.len())?;
        }
        let mut curvature = match ws.curvature.take() {
            Some(curvature) => curvature,
            None => Box::new(Curvature {
                state: S::Dual::state(self, ws.state.extent.clone(), &ws.sizes),
                products: vec![Buffer::zeros(0); self.nodes.len()],
            }),
        };
        let state = &mut curvature.state;
        state.indices.clone_from(&ws.state.indices);
        for (id, node) in self.nodes.iter().enumerate() {
            if !matches!(node.op, Op::Param | Op::Input | Op::Mask) {
                continue;
            }
            let values = ws.state.values[id].as_slice();
            let given = direction.iter().find(|(name, _)| {
                matches!(node.op, Op::Param) && node.name.as_deref() == Some(name)
            });
            let target = own(&mut state.values[id]);
            target.ensure(values.len());
            for (i, dual) in target.as_mut_slice().iter_mut().enumerate() {
                let derivative = given.map_or(S::default(), |(_, tangent)| tangent[i]);
                *dual = S::join(values[i], derivative);
            }
        }
        S::Dual::forward(state, self, false);
        state.clear_adjoints();
        state.seed(self, target).fill(S::Dual::from_f64(1.0));
        S::Dual::reverse(state, self);
        for (id, node) in self.nodes.iter().enumerate() {
            if !matches!(node.op, Op::Param) {
                continue;
            }
            let adjoint = state.adjoints[id].as_slice();
            let gradient = own(&mut ws.state.adjoints[id]);
            gradient.ensure(adjoint.len());
            let product = &mut curvature.products[id];
            product.ensure(adjoint.len());
            let parts = gradient
                .as_mut_slice()
                .iter_mut()
                .zip(product.as_mut_slice());
            for ((gradient, product), dual) in parts.zip(adjoint) {
                (*gradient, *product) = S::split(*dual);
            }
        }
        // Index arrays are the workspace's alone again, so that the next ones are copied into them.
        state.indices.fill(ws.no_index.clone());
        ws.curvature = Some(curvature);
        ws.has_gradient = true;
        Ok(())
    }
}

impl<S: Scalar> Workspace<S> {
    /// The part of the last Hessian-vector product that belongs to a parameter.
    ///
    /// # Errors
    /// An unknown name; no [`Program::hvp`] before.
    pub fn hessian_product(&self, name: &str) -> Result<&[S], RunError> {
        let (id, _) = self.param(name)?;
        let Some(curvature) = &self.curvature else {
            return Err(not_computed(
                "Hessian-vector product",
                name,
                "`Program::hvp`",
            ));
        };
        Ok(curvature.products[id].as_slice())
    }
}

impl<S: Scalar> Curvature<S> {
    /// Heap bytes held.
    pub fn bytes(&self) -> usize {
        self.state.bytes() + self.products.iter().map(Buffer::bytes).sum::<usize>()
    }
}
