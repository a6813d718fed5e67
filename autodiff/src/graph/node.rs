//! What a recorded graph is made of.

use std::panic::Location;
use std::sync::Arc;

use crate::custom::Erased;
use crate::linear_map::LinearMap;
use crate::op::Element;

/// Position of a node in its graph; operands come before results.
pub(crate) type NodeId = usize;

/// The domain of one lane.
pub(crate) const UNIFORM: usize = 0;

/// Where a value lives. Stored as `[channel][lane][axis]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    /// Index of the domain, whose lanes the value has.
    pub domain: usize,
    /// Number of channels.
    pub channels: usize,
    /// Index of the inner axis, or `None` for a single element per lane.
    pub axis: Option<usize>,
}

/// A recorded operation; its operands are [`Node::inputs`].
#[derive(Clone)]
pub(crate) enum Op {
    /// A differentiable leaf.
    Param,
    /// A leaf without gradient.
    Input,
    /// A bound mask, kept as 0 and 1.
    Mask,
    /// The same number in every lane (uniform).
    Constant(f64),
    /// An elementwise primitive.
    Element(Element),
    /// A user's elementwise operation.
    Custom(Arc<dyn Erased>),
    /// One channel.
    Channel(usize),
    /// Channels of all operands, one after another.
    Stack,
    /// Sum over channels.
    SumChannels,
    /// Sum over the inner axis.
    SumAxis,
    /// The largest element along the inner axis, without gradient.
    MaxAxis,
    /// The uniform operand in every lane.
    Splat,
    /// The operand repeated along an inner axis.
    Repeat,
    /// The parent's value in every lane of its segment.
    Expand,
    /// Rows of a table (operand 0), by this index.
    Gather(usize),
    /// Sum of rows of a table (operand 0) at these indices, times the remaining operands.
    GatherWeighted(Vec<usize>),
    /// Sum, or mean, over the lanes of a segment.
    SegmentSum {
        /// Whether to divide by the number of lanes.
        mean: bool,
    },
    /// Sum over the lanes of a segment of the product of two operands.
    SegmentDot,
    /// Sum over all lanes.
    SumLanes,
    /// A user's linear operator.
    Map(Arc<dyn LinearMap>),
    /// Operand 1 (uniform, `out * in` channels, row-major) times the channels of operand 0, plus operand 2 if given.
    Matmul,
    /// The operand, without gradient.
    Detach,
}

impl Op {
    /// The name shown in messages.
    pub fn name(&self) -> &'static str {
        match self {
            Op::Param => "param",
            Op::Input => "input",
            Op::Mask => "mask",
            Op::Constant(_) => "constant",
            Op::Element(element) => element.name(),
            Op::Custom(op) => op.name(),
            Op::Channel(_) => "channel",
            Op::Stack => "stack",
            Op::SumChannels => "sum_channels",
            Op::SumAxis => "sum_axis",
            Op::MaxAxis => "max_axis",
            Op::Splat => "splat",
            Op::Repeat => "repeat",
            Op::Expand => "expand",
            Op::Gather(_) => "gather",
            Op::GatherWeighted(_) => "gather_weighted",
            Op::SegmentSum { mean: false } => "segment_sum",
            Op::SegmentSum { mean: true } => "segment_mean",
            Op::SegmentDot => "segment_dot",
            Op::SumLanes => "sum_lanes",
            Op::Map(_) => "linear_map",
            Op::Matmul => "matmul",
            Op::Detach => "detach",
        }
    }

    /// Whether two broadcasts, expansions or gathers of one operand to one shape are the same.
    pub fn same_lookup(&self, other: &Op) -> bool {
        match (self, other) {
            (Op::Splat, Op::Splat) | (Op::Repeat, Op::Repeat) | (Op::Expand, Op::Expand) => true,
            (Op::Gather(a), Op::Gather(b)) => a == b,
            _ => false,
        }
    }

    /// Whether the value is bound or constant rather than computed.
    pub fn is_leaf(&self) -> bool {
        matches!(self, Op::Param | Op::Input | Op::Mask | Op::Constant(_))
    }

    /// Whether the value is accumulated over lanes, so that it is known only after its phase.
    pub fn is_sink(&self) -> bool {
        matches!(self, Op::SegmentSum { .. } | Op::SegmentDot | Op::SumLanes)
    }

    /// Whether operand `i` must be known for all lanes before any lane of the result is computed.
    pub fn reads_whole(&self, i: usize) -> bool {
        match self {
            Op::Splat | Op::Expand | Op::Map(_) => true,
            Op::Gather(_) | Op::GatherWeighted(_) => i == 0,
            Op::Matmul => i > 0,
            _ => false,
        }
    }
}

/// A recorded value.
#[derive(Clone)]
pub(crate) struct Node {
    pub op: Op,
    pub inputs: Vec<NodeId>,
    pub shape: Shape,
    /// The name that a leaf is bound by.
    pub name: Option<String>,
    /// What messages call it, if the user said so.
    pub label: Option<String>,
    /// Whether a gradient can flow through to a parameter.
    pub active: bool,
    pub location: &'static Location<'static>,
}

impl Node {
    /// The label, or else the name of a leaf.
    pub fn called(&self) -> Option<&str> {
        self.label.as_deref().or(self.name.as_deref())
    }
}

/// A declared domain.
#[derive(Clone, Debug)]
pub(crate) struct DomainInfo {
    pub name: String,
    /// The domain whose lanes own segments of this one's.
    pub parent: Option<usize>,
}

/// A declared index array.
#[derive(Clone, Debug)]
pub(crate) struct IndexInfo {
    pub name: String,
    /// The domain whose lanes look up.
    pub domain: usize,
    /// The domain looked up.
    pub table: usize,
}
