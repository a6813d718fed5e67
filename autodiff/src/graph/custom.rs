//! Elementwise operations supplied by the user, on recorded values.

use std::panic::Location;
use std::sync::Arc;

use super::array::{Array, Kind};
use super::node::Op;
use super::record::Graph;
use crate::custom::{Component, CustomOp, CustomVecOp, Erased, FirstOrderOnly, Limited, Smooth};
use crate::run::OPERANDS;

impl Graph {
    /// A user's elementwise operation on one to eight operands, broadcast as in arithmetic.
    #[track_caller]
    pub fn custom<A: Kind, const N: usize>(
        &self,
        op: impl CustomOp<N>,
        operands: [&Array<A>; N],
    ) -> Array<A> {
        self.apply_custom(Arc::new(Smooth(op)), operands, Location::caller())
    }

    /// The same, for an operation of several results.
    ///
    /// ```
    /// use autodiff::{CustomVecOp, Fma, Graph, Real, Sizes, Var};
    ///
    /// /// A point of the plane, by its distance and angle.
    /// struct Polar;
    ///
    /// impl CustomVecOp<2, 2> for Polar {
    ///     fn name(&self) -> &'static str {
    ///         "polar"
    ///     }
    ///     fn eval<R: Real, F: Fma>(&self, [r, angle]: [R; 2]) -> [R; 2] {
    ///         [r * angle.cos::<F>(), r * angle.sin::<F>()]
    ///     }
    /// }
    ///
    /// let g = Graph::new();
    /// let lane = g.domain("lane");
    /// let (r, angle) = (g.param("r", &lane, 1), g.param("angle", &lane, 1));
    /// let [x, y] = g.custom_vec(Polar, [&r, &angle]);
    /// let program = g.compile(&[("point", &Var::stack(&[&x, &y]))])?;
    /// let mut ws = program.workspace::<f64>(&Sizes::new().lanes("lane", 1))?;
    /// ws.set("r", &[2.0])?;
    /// ws.set("angle", &[0.0])?;
    /// program.vjp(&mut ws, "point")?;
    /// assert_eq!(ws.output("point")?, [2.0, 0.0]);
    /// assert_eq!(ws.gradient("angle")?, [2.0]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[track_caller]
    pub fn custom_vec<A: Kind, const N: usize, const M: usize>(
        &self,
        op: impl CustomVecOp<N, M>,
        operands: [&Array<A>; N],
    ) -> [Array<A>; M] {
        let (op, location) = (Arc::new(op), Location::caller());
        std::array::from_fn(|at| {
            let component = Component {
                op: Arc::clone(&op),
                at,
            };
            self.apply_custom(Arc::new(Smooth(component)), operands, location)
        })
    }

    /// As [`Graph::custom`], for an operation whose first derivatives alone are known.
    #[track_caller]
    pub fn custom_first_order<A: Kind, const N: usize>(
        &self,
        op: impl FirstOrderOnly<N>,
        operands: [&Array<A>; N],
    ) -> Array<A> {
        self.apply_custom(Arc::new(Limited(op)), operands, Location::caller())
    }

    fn apply_custom<A: Kind, const N: usize>(
        &self,
        op: Arc<dyn Erased>,
        operands: [&Array<A>; N],
        location: &'static Location<'static>,
    ) -> Array<A> {
        if N == 0 || N > OPERANDS {
            let nothing: Array<A> = self.constant(0.0);
            nothing.reject(op.name(), location, "give one to eight operands");
            return nothing;
        }
        let operands = operands.map(|operand| (&operand.graph, operand.id));
        let name = op.name();
        Array::<A>::broadcast_together(self, Op::Custom(op), name, &operands, location)
    }
}
