//! Recording: a graph of array operations, its domains, and the handles that record.

mod arithmetic;
mod array;
mod custom;
mod handles;
mod leaves;
mod masks;
mod node;
mod rates;
mod record;

pub use array::{Array, Detached, Differentiable, Fixed, Join, Kind, Mask, Var};
pub use handles::{Axis, Domain, Index};
pub(crate) use node::{DomainInfo, IndexInfo, Node, NodeId, Op, Shape};
pub(crate) use rates::CORNERS;
pub use record::Graph;
pub(crate) use record::Recording;
