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

impl Program {
    /// Computes all outputs, and follows the first element of them that is not finite, if any, back to where it began: a bound
    /// array, or a result of finite operands. What reaches no output is not looked at, such as a NaN in the branch of a
    /// selection that is not taken. Where gradients alone are not finite, [`Program::find_singularities`] tells why. For
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
}
