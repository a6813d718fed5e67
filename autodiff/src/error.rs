//! What can go wrong: when a graph is recorded, when sizes and arrays are bound, when a program runs.

/// A mistake in a recorded graph. Recording goes on after one; `Graph::compile` returns the first.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GraphError {
    /// Two operands that do not fit together.
    #[error("`{op}` at {location}: {lhs} and {rhs} do not fit: {hint}")]
    ShapeMismatch {
        /// The operation.
        op: &'static str,
        /// Label and shape of the first operand.
        lhs: String,
        /// Label and shape of the second operand.
        rhs: String,
        /// What to do.
        hint: String,
        /// File and line of the call.
        location: String,
    },
    /// An operand that the operation cannot take.
    #[error("`{op}` at {location}: {operand} cannot be used here: {hint}")]
    Operand {
        /// The operation.
        op: &'static str,
        /// Label and shape of the operand.
        operand: String,
        /// What to do.
        hint: String,
        /// File and line of the call.
        location: String,
    },
    /// A name used for two things.
    #[error("{what} `{name}` at {location} was declared before: choose another name")]
    Duplicate {
        /// What was declared: a domain, an axis, a parameter ...
        what: &'static str,
        /// Its name.
        name: String,
        /// File and line of the call.
        location: String,
    },
    /// Values of two graphs in one operation.
    #[error(
        "`{op}` at {location} mixes {lhs} with {rhs} of another graph: record both on the same graph"
    )]
    OtherGraph {
        /// The operation.
        op: &'static str,
        /// What belongs to the graph.
        lhs: String,
        /// What belongs to another.
        rhs: String,
        /// File and line of the call.
        location: String,
    },
}

/// A mistake in what was bound to a workspace, or asked of it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RunError {
    /// A domain, axis or segmentation without a size.
    #[error("{what} `{name}` has no size: give it with {hint}")]
    MissingSize {
        /// A domain, an axis or segments.
        what: &'static str,
        /// Its name.
        name: String,
        /// The call that gives it.
        hint: &'static str,
    },
    /// Sizes that contradict each other.
    #[error("sizes of `{name}`: {problem}")]
    Sizes {
        /// The domain.
        name: String,
        /// What was expected and found.
        problem: String,
    },
    /// A name that the program does not have.
    #[error("the program has no {what} `{name}`; it has {known}")]
    Unknown {
        /// What was looked for.
        what: &'static str,
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// An array of the wrong length.
    #[error("`{name}` ({shape}) needs {expected} values, but {found} were given")]
    Length {
        /// The name of what was bound.
        name: String,
        /// Its shape, channel by lane by axis.
        shape: String,
        /// Values needed.
        expected: usize,
        /// Values given.
        found: usize,
    },
    /// An index beyond its table.
    #[error(
        "index `{name}`: lane {lane} is {value}, but the table `{table}` has {lanes} lanes: indices count them from 0"
    )]
    IndexOutOfRange {
        /// The index array.
        name: String,
        /// The first lane that is out of range.
        lane: usize,
        /// Its value.
        value: u64,
        /// The domain indexed into.
        table: String,
        /// Lanes of that domain.
        lanes: usize,
    },
    /// Something declared but not bound.
    #[error("`{name}` ({shape}) has not been bound: call `{call}` before running")]
    Unbound {
        /// The name of what is missing.
        name: String,
        /// Its shape.
        shape: String,
        /// The call that binds it.
        call: &'static str,
    },
    /// A result that is not there, or not that of what is bound.
    #[error("the {what} of `{name}` has not been computed for what is bound: call {call} first")]
    NotComputed {
        /// A value, a tangent, a gradient ..
        what: &'static str,
        /// The output or parameter.
        name: String,
        /// The call that computes it.
        call: &'static str,
    },
    /// An operation that only has first derivatives was asked for second ones.
    #[error(
        "`{op}` is `FirstOrderOnly`: write it generically over `Real` to have Hessian-vector products"
    )]
    FirstOrderOnly {
        /// The operation.
        op: String,
    },
    /// A workspace of another program.
    #[error("this workspace was made by another program: make it with `program.workspace`")]
    OtherProgram,
    /// A user's linear map whose shape is not that of the domains.
    #[error(
        "the linear map of `{name}` is {map_in} -> {map_out} lanes, its domains have {domain_in} -> {domain_out}: make them agree by \
         `Sizes::lanes`"
    )]
    MapShape {
        /// Label of the result.
        name: String,
        /// Lanes the map takes.
        map_in: usize,
        /// Lanes the map gives.
        map_out: usize,
        /// Lanes of the input's domain.
        domain_in: usize,
        /// Lanes of the output's domain.
        domain_out: usize,
    },
}
