//! Where a NaN or an infinity comes from.

use std::fmt;

use super::workspace::Workspace;
use crate::error::RunError;
use crate::program::Program;
use crate::real::Scalar;

/// Where what is not finite in an output began: a value that is not finite although what it was computed from is.
#[derive(Clone, Debug, PartialEq)]
pub struct NonFinite {
    /// The label of the value, or its operation and place in the source.
    pub origin: String,
    /// Lane of its domain.
    pub lane: usize,
    /// Channel.
    pub channel: usize,
    /// Position along the inner axis.
    pub position: usize,
    /// The value.
    pub value: f64,
    /// Labels and values of its operands at that lane; empty where an operation combines lanes, and for bound arrays.
    pub operands: Vec<(String, f64)>,
}

impl fmt::Display for NonFinite {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "`{}` is {} at lane {}, channel {}, position {}",
            self.origin, self.value, self.lane, self.channel, self.position
        )?;
        for (i, (name, value)) in self.operands.iter().enumerate() {
            let lead = if i == 0 { ", from" } else { " and" };
            write!(f, "{lead} `{name}` = {value}")?;
        }
        Ok(())
    }
}

/// Where what is not finite in a gradient began: an operation that made an adjoint which is not finite, although those that it was
/// made of are.
#[derive(Clone, Debug, PartialEq)]
pub struct NonFiniteAdjoint {
    /// The parameter whose gradient it spoils.
    pub parameter: String,
    /// The label of the operation's result, or the operation and its place in the source.
    pub origin: String,
    /// The label of the operand whose adjoint it made.
    pub operand: String,
    /// Lane of the operand's domain.
    pub lane: usize,
    /// Channel of the operand.
    pub channel: usize,
    /// Position along the operand's inner axis.
    pub position: usize,
    /// The operand's adjoint there.
    pub adjoint: f64,
    /// The adjoint of the result there; none where an operation combines lanes, channels or positions.
    pub incoming: Option<f64>,
    /// Labels and values of all operands there; empty where there is no `incoming`.
    pub operands: Vec<(String, f64)>,
}

impl fmt::Display for NonFiniteAdjoint {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "the gradient of `{}` is not finite: `{}` makes the adjoint of `{}` {} at lane {}, channel {}, position {}",
            self.parameter,
            self.origin,
            self.operand,
            self.adjoint,
            self.lane,
            self.channel,
            self.position
        )?;
        if let Some(incoming) = self.incoming {
            write!(f, ", from its own of {incoming}")?;
        }
        for (i, (name, value)) in self.operands.iter().enumerate() {
            let lead = if i == 0 { ", where" } else { " and" };
            write!(f, "{lead} `{name}` = {value}")?;
        }
        write!(
            f,
            "; select the operand, not only the result, or keep it away from here"
        )
    }
}

impl Program {
    /// Computes all outputs, and follows the first element of them that is not finite, if any, back to where it began: a bound
    /// array, or a result of finite operands. What reaches no output is not looked at, such as a NaN in the branch of a
    /// selection that is not taken. Where gradients alone are not finite, [`Program::find_non_finite_gradient`] tells why. For
    /// debugging: runs on one thread.
    ///
    /// # Errors
    /// As [`Program::forward`].
    pub fn find_non_finite<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
    ) -> Result<Option<NonFinite>, RunError> {
        self.forward(ws)?;
        Ok(S::find_non_finite(&mut ws.state, self))
    }

    /// Computes gradients of `output`, and names the operation that made the first of them that is not finite, if any: `sqrt` at 0,
    /// for one, whose value is finite. What reaches no gradient is not named, such as what a selection stops on the way;
    /// [`Program::find_singularities`] lists that too. Ask [`Program::find_non_finite`] first: where values are not finite, adjoints
    /// made of them need not be. For debugging: one more pass, on one thread and node by node.
    ///
    /// ```
    /// use autodiff::{Graph, Sizes};
    ///
    /// let g = Graph::new();
    /// let x = g.param("x", &g.domain("lane"), 3);
    /// let length = x.dot(&x).label("squared").sqrt().label("length");
    /// let program = g.compile(&[("loss", &length.sum())])?;
    /// let mut ws = program.workspace::<f64>(&Sizes::new().lanes("lane", 2))?;
    /// ws.set("x", &[1.0, 0.0, 2.0, 0.0, 2.0, 0.0])?;
    /// let found = program.find_non_finite_gradient(&mut ws, "loss")?.expect("the slope at 0");
    /// assert_eq!((found.origin.as_str(), found.lane), ("length", 1));
    /// assert_eq!(found.operands, [("squared".to_string(), 0.0)]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`Program::vjp`].
    pub fn find_non_finite_gradient<S: Scalar>(
        &self,
        ws: &mut Workspace<S>,
        output: &str,
    ) -> Result<Option<NonFiniteAdjoint>, RunError> {
        // Values first: then no phase runs forward and back in one go, which would leave adjoints between the two nowhere.
        self.forward(ws)?;
        self.vjp(ws, output)?;
        Ok(S::find_non_finite_adjoint(&mut ws.state, self))
    }
}
