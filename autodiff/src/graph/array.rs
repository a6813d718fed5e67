//! Values being recorded: differentiable ones, detached ones, masks.

use std::marker::PhantomData;
use std::panic::Location;

use super::handles::Domain;
use super::node::{NodeId, Op, Shape};
use super::record::Graph;
use crate::error::GraphError;
use crate::op::Element;

/// A recorded value; [`Var`] and [`Detached`] are its two kinds.
pub struct Array<M> {
    pub(crate) graph: Graph,
    pub(crate) id: NodeId,
    pub(super) kind: PhantomData<M>,
}

/// A value that gradients flow through.
pub type Var = Array<Differentiable>;

/// A value that no gradient flows through: an input, a sample, a density, a visibility.
///
/// Arithmetic among detached values stays detached; together with a [`Var`] it gives a [`Var`]. Only
/// [`Detached::attach`] and [`Detached::attach_to`] turn one into a [`Var`].
pub type Detached = Array<Fixed>;

/// Marks [`Var`].
#[derive(Clone, Copy, Debug)]
pub enum Differentiable {}

/// Marks [`Detached`].
#[derive(Clone, Copy, Debug)]
pub enum Fixed {}

/// The two kinds of values.
pub trait Kind: 'static {}
impl Kind for Differentiable {}
impl Kind for Fixed {}

/// The kind of a result of two operands: differentiable if either is.
pub trait Join<B: Kind>: Kind {
    /// The kind of the result.
    type Out: Kind;
}
impl Join<Fixed> for Fixed {
    type Out = Fixed;
}
impl Join<Fixed> for Differentiable {
    type Out = Differentiable;
}
impl Join<Differentiable> for Fixed {
    type Out = Differentiable;
}
impl Join<Differentiable> for Differentiable {
    type Out = Differentiable;
}

/// A boolean per lane.
#[derive(Clone)]
pub struct Mask {
    pub(super) value: Detached,
}

impl<M> Clone for Array<M> {
    fn clone(&self) -> Self {
        Array {
            graph: self.graph.clone(),
            id: self.id,
            kind: PhantomData,
        }
    }
}

impl<M> AsRef<Array<M>> for Array<M> {
    fn as_ref(&self) -> &Array<M> {
        self
    }
}

impl<M> Array<M> {
    pub(super) fn from_id(graph: &Graph, id: NodeId) -> Self {
        Array {
            graph: graph.clone(),
            id,
            kind: PhantomData,
        }
    }

    pub(super) fn shape(&self) -> Shape {
        self.graph.shape(self.id)
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.shape().channels
    }

    /// The domain whose lanes this value has.
    pub fn domain(&self) -> Domain {
        Domain {
            graph: self.graph.stamp,
            id: self.shape().domain,
        }
    }

    /// Gives the value a name for error messages and profiles. Parameters and inputs are still bound by the name that they were
    /// declared with.
    pub fn label(self, name: &str) -> Self {
        self.graph.recording.borrow_mut().nodes[self.id].label = Some(name.to_string());
        self
    }

    /// The value without its gradient.
    #[track_caller]
    pub fn detach(&self) -> Detached {
        let shape = self.shape();
        let id = self
            .graph
            .push(Op::Detach, vec![self.id], shape, Location::caller());
        Array::from_id(&self.graph, id)
    }

    /// A node with one operand and a shape derived from it.
    pub(super) fn derive<N>(
        &self,
        op: Op,
        shape: Shape,
        location: &'static Location<'static>,
    ) -> Array<N> {
        let id = self.graph.push(op, vec![self.id], shape, location);
        Array::from_id(&self.graph, id)
    }

    /// Records a mistake about this operand.
    pub(super) fn reject(
        &self,
        op: &'static str,
        location: &'static Location<'static>,
        hint: impl Into<String>,
    ) {
        self.graph.fail(GraphError::Operand {
            op,
            operand: self.graph.describe(self.id),
            hint: hint.into(),
            location: location.to_string(),
        });
    }

    /// An elementwise operation of several operands, broadcast to a common domain, channel count and axis.
    pub(super) fn elementwise<N>(
        graph: &Graph,
        element: Element,
        operands: &[(&Graph, NodeId)],
        location: &'static Location<'static>,
    ) -> Array<N> {
        let op = element.name();
        Self::broadcast_together(graph, Op::Element(element), op, operands, location)
    }

    pub(super) fn broadcast_together<N>(
        graph: &Graph,
        operation: Op,
        op: &'static str,
        operands: &[(&Graph, NodeId)],
        location: &'static Location<'static>,
    ) -> Array<N> {
        let Some(shape) = graph.common_shape(op, operands, true, location) else {
            return Self::stand_in(graph, operands);
        };
        let inputs = operands
            .iter()
            .map(|&(_, id)| graph.broadcast(id, shape.domain, shape.axis, location))
            .collect();
        let id = graph.push(operation, inputs, shape, location);
        Array::from_id(graph, id)
    }
}

impl<M> Array<M> {
    /// Something to go on with after a mistake: an operand of this graph, or else a number.
    fn stand_in<N>(graph: &Graph, operands: &[(&Graph, NodeId)]) -> Array<N> {
        let mut own = operands.iter().filter(|(g, _)| g.stamp == graph.stamp);
        match own.next() {
            Some(&(_, id)) => Array::from_id(graph, id),
            None => Array::from_id(graph, graph.constant::<Fixed>(0.0).id),
        }
    }
}

impl Graph {
    /// The shape that operands broadcast to, or, without `channels`, their domain and axis; nothing if one is of another graph.
    pub(super) fn common_shape(
        &self,
        op: &'static str,
        operands: &[(&Graph, NodeId)],
        channels: bool,
        location: &'static Location<'static>,
    ) -> Option<Shape> {
        for (other, id) in operands {
            let own = operands.iter().find(|(g, _)| g.stamp == self.stamp);
            let names = || {
                let own = own.map_or("the graph".to_string(), |(_, id)| self.describe(*id));
                (own, other.describe(*id))
            };
            if !self.owns(other.stamp, op, location, names) {
                return None;
            }
        }
        let shape_of = |id: NodeId| match channels {
            true => self.shape(id),
            false => Shape {
                channels: 1,
                ..self.shape(id)
            },
        };
        let mut widest = operands.first()?.1;
        let mut shape = shape_of(widest);
        for &(_, id) in &operands[1..] {
            match join(shape, shape_of(id)) {
                Ok(joined) => {
                    if joined != shape {
                        widest = id;
                    }
                    shape = joined;
                }
                Err(hint) => self.fail(GraphError::ShapeMismatch {
                    op,
                    lhs: self.describe(widest),
                    rhs: self.describe(id),
                    hint: hint.to_string(),
                    location: location.to_string(),
                }),
            }
        }
        Some(shape)
    }
}

impl Detached {
    /// The same value as a [`Var`], with no gradient of its own: for results that mix with differentiable ones by type.
    #[track_caller]
    pub fn attach(&self) -> Var {
        Array::from_id(&self.graph, self.id)
    }

    /// A [`Var`] with this value and the gradient of `source`.
    #[track_caller]
    pub fn attach_to(&self, source: &Var) -> Var {
        self + (source - source.detach())
    }
}

/// The shape that two operands broadcast to, or what to do about it.
fn join(a: Shape, b: Shape) -> Result<Shape, &'static str> {
    use super::node::UNIFORM;
    let domain = match (a.domain, b.domain) {
        (a, b) if a == b => a,
        (UNIFORM, b) => b,
        (a, UNIFORM) => a,
        _ => return Err("bring both to one domain with `expand`, `gather` or `segment_sum`"),
    };
    let channels = match (a.channels, b.channels) {
        (a, b) if a == b => a,
        (1, b) => b,
        (a, 1) => a,
        _ => {
            return Err(
                "use `channel` or `stack` to give both as many channels, or one of them a single one",
            );
        }
    };
    let axis = match (a.axis, b.axis) {
        (a, b) if a == b => a,
        (None, b) => b,
        (a, None) => a,
        _ => return Err("values along two different axes: use `sum_axis` on one of them first"),
    };
    Ok(Shape {
        domain,
        channels,
        axis,
    })
}
