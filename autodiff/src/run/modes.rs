//! The ways to run a program: forward, reverse, tangent, and the Gauss-Newton product of both.

use super::driver::State;
use super::inspect::{NonFinite, NonFiniteAdjoint};
use super::lane::Lane;
use super::sizes::{Extent, Sizes};
use super::walk::Observer;
use super::workspace::Workspace;
use crate::dual::Dual;
use crate::error::RunError;
use crate::graph::Op;
use crate::program::Program;
use crate::real::Scalar;

/// The passes, compiled in this crate for each scalar type.
#[doc(hidden)]
pub trait Engine: Lane {
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn state(program: &Program, extent: Extent, sizes: &Sizes) -> State<Self>;
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn resize(state: &mut State<Self>, program: &Program, extent: Extent, sizes: &Sizes);
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn forward(state: &mut State<Self>, program: &Program, tangents: bool);
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn tangents(state: &mut State<Self>, program: &Program);
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn reverse(state: &mut State<Self>, program: &Program);
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn gradient(state: &mut State<Self>, program: &Program);
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn find_non_finite(state: &mut State<Self>, program: &Program) -> Option<NonFinite>;
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn find_non_finite_adjoint(
        state: &mut State<Self>,
        program: &Program,
    ) -> Option<NonFiniteAdjoint>;
    #[doc(hidden)]
    #[allow(private_interfaces)]
    fn walk(state: &mut State<Self>, program: &Program, observer: &mut dyn Observer<Self>);
}

macro_rules! engine {
    ($t:ty) => {
        #[allow(private_interfaces)]
        impl Engine for $t {
            fn state(program: &Program, extent: Extent, sizes: &Sizes) -> State<Self> {
                State::new(program, extent, sizes)
            }
            fn resize(state: &mut State<Self>, program: &Program, extent: Extent, sizes: &Sizes) {
                state.resize(program, extent, sizes)
            }
            fn forward(state: &mut State<Self>, program: &Program, tangents: bool) {
                state.forward(program, tangents)
            }
            fn tangents(state: &mut State<Self>, program: &Program) {
                state.tangents(program)
            }
            fn reverse(state: &mut State<Self>, program: &Program) {
                state.reverse(program, 0..program.phases.len(), None)
            }
            fn gradient(state: &mut State<Self>, program: &Program) {
                state.gradient(program)
            }
            fn find_non_finite(state: &mut State<Self>, program: &Program) -> Option<NonFinite> {
                state.find_non_finite(program)
            }
            fn find_non_finite_adjoint(
                state: &mut State<Self>,
                program: &Program,
            ) -> Option<NonFiniteAdjoint> {
                state.find_non_finite_adjoint(program)
            }
            fn walk(state: &mut State<Self>, program: &Program, observer: &mut dyn Observer<Self>) {
                state.walk(program, observer)
            }
        }
    };
}
engine!(f32);
engine!(f64);
engine!(Dual<f32>);
engine!(Dual<f64>);

impl Program {
    /// Computes all outputs; read them with [`Workspace::output`].
    ///
    /// # Errors
    /// Something not bound, or a workspace of another program.
    pub fn forward<S: Scalar>(&self, ws: &mut Workspace<S>) -> Result<(), RunError> {
        ws.check_ready(self)?;
        S::forward(&mut ws.state, self, false);
        ws.fresh = true;
        Ok(())
    }

    /// Gradients of an output, of the sum of its elements if it has several, with respect to all parameters; read them with
    /// [`Workspace::gradient`]. Values are recomputed only if something was bound since they last were.
    ///
    /// # Errors
    /// As [`Program::forward`]; an unknown output.
    pub fn vjp<S: Scalar>(&self, ws: &mut Workspace<S>, output: &str) -> Result<(), RunError> {
        ws.check_ready(self)?;
        let id = ws.output_id(output)?;
        ws.state.clear_adjoints();
        ws.state.seed(self, id).fill(S::from_f64(1.0));
        self.finish_reverse(ws);
        Ok(())
    }

    /// Vector-Jacobian product: gradients of the inner product of outputs with these cotangents.
    ///
    /// # Errors
    /// As [`Program::vjp`]; a cotangent of the wrong length.
    pub fn vjp_with<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        cotangents: &[(&str, &[S])],
    ) -> Result<(), RunError> {
        ws.check_ready(self)?;
        for (name, cotangent) in cotangents {
            let id = ws.output_id(name)?;
            ws.check_len(name, id, ws.state.len(id), cotangent.len())?;
        }
        ws.state.clear_adjoints();
        for (name, cotangent) in cotangents {
            let id = ws.output_id(name)?;
            let seeds = ws.state.seed(self, id);
            for (seed, &x) in seeds.iter_mut().zip(*cotangent) {
                *seed = *seed + x;
            }
        }
        self.finish_reverse(ws);
        Ok(())
    }

    /// Jacobian-vector product: the derivative of all outputs along a direction in parameter space; parameters not named
    /// stand still. Computes values too if something was bound since they last were. Read it with [`Workspace::tangent`].
    ///
    /// # Errors
    /// As [`Program::forward`]; an unknown parameter; a direction of the wrong length.
    pub fn jvp<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        direction: &[(&str, &[S])],
    ) -> Result<(), RunError> {
        ws.check_ready(self)?;
        for (name, tangent) in direction {
            let (id, len) = ws.param(name)?;
            ws.check_len(name, id, len, tangent.len())?;
        }
        ws.state.moving.fill(false);
        for (name, tangent) in direction {
            let (id, _) = ws.param(name)?;
            ws.tangent_of(id).copy_from_slice(tangent);
            ws.state.moving[id] = true;
        }
        // What is there of earlier tangents is overwritten.
        ws.has_tangent = false;
        if ws.fresh {
            S::tangents(&mut ws.state, self);
        } else {
            S::forward(&mut ws.state, self, true);
            ws.fresh = true;
        }
        ws.has_tangent = true;
        Ok(())
    }

    /// Gauss-Newton product `J^T W J v` for the Jacobian `J` of `output`, a diagonal `W` (one weight per element of the
    /// output; identity if `None`), and a direction `v`; read it with [`Workspace::gradient`]. `J` is never formed.
    ///
    /// # Errors
    /// As [`Program::jvp`] and [`Program::vjp`].
    pub fn gauss_newton<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        output: &str,
        direction: &[(&str, &[S])],
        weights: Option<&[S]>,
    ) -> Result<(), RunError> {
        let id = ws.output_id(output)?;
        if let Some(weights) = weights {
            ws.check_len(output, id, ws.state.len(id), weights.len())?;
        }
        self.jvp(ws, direction)?;
        ws.state.clear_adjoints();
        ws.state.seed(self, id);
        if ws.state.moving[id] {
            ws.state.seed_with_tangent(id, weights);
        }
        self.finish_reverse(ws);
        Ok(())
    }

    /// Passes seeds back; values are computed first if something was bound since they last were.
    fn finish_reverse<S: Scalar>(&self, ws: &mut Workspace<S>) {
        ws.has_gradient = false;
        if ws.fresh {
            S::reverse(&mut ws.state, self);
        } else {
            S::gradient(&mut ws.state, self);
            ws.fresh = true;
        }
        ws.has_gradient = true;
        debug_assert!(self.nodes.iter().enumerate().all(|(id, node)| {
            !matches!(node.op, Op::Param)
                || ws.state.adjoints[id].as_slice().len() == ws.state.len(id)
        }));
    }
}
