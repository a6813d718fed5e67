//! Operations that change the domain or the axis: expand and segment sums, gathers, linear maps, reductions, matmul.

use std::panic::Location;
use std::sync::Arc;

use super::array::{Array, Detached, Fixed, Join, Kind};
use super::handles::{Domain, Index};
use super::node::{Op, Shape, UNIFORM};
use crate::error::GraphError;
use crate::linear_map::LinearMap;

impl<A: Kind> Array<A> {
    /// The value of each lane's parent, on a domain declared with [`super::Graph::segments`]. Adjoint of
    /// [`Array::segment_sum`].
    #[track_caller]
    pub fn expand(&self, child: &Domain) -> Array<A> {
        let location = Location::caller();
        if !self.owns_handle(child.graph, "expand", "a domain", location) {
            return self.clone();
        }
        let shape = self.shape();
        if self.parent_of(child.id) != Some(shape.domain) {
            let own = self.graph.domain_name(shape.domain);
            self.reject(
                "expand",
                location,
                format!(
                    "`{0}` is not made of segments of `{own}`: declare it by `segments`, with that domain as its parent",
                    self.graph.domain_name(child.id)
                ),
            );
        }
        let shape = Shape {
            domain: child.id,
            ..shape
        };
        // One expansion of a value serves all its uses.
        let id = self.graph.reuse(Op::Expand, self.id, shape, location);
        Array::from_id(&self.graph, id)
    }

    /// Sum over the lanes of each segment, on the parent domain; 0 for an empty segment. Adjoint of [`Array::expand`].
    #[track_caller]
    pub fn segment_sum(&self) -> Array<A> {
        self.segment(Op::SegmentSum { mean: false }, Location::caller())
    }

    /// Mean over the lanes of each segment, on the parent domain; 0 for an empty segment.
    #[track_caller]
    pub fn segment_mean(&self) -> Array<A> {
        self.segment(Op::SegmentSum { mean: true }, Location::caller())
    }

    /// `(self * other).segment_sum()` without the product in memory. Channels and axis broadcast as in a product.
    #[track_caller]
    pub fn segment_dot<B: Kind>(&self, other: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        let location = Location::caller();
        let operands = [(&self.graph, self.id), (&other.graph, other.id)];
        let common = self
            .graph
            .common_shape("segment_dot", &operands, true, location);
        let Some(shape) = common else {
            return Array::from_id(&self.graph, self.id);
        };
        let Some(parent) = self.parent_of(shape.domain) else {
            self.reject("segment_dot", location, NO_SEGMENTS);
            return Array::from_id(&self.graph, self.id);
        };
        let inputs = [self.id, other.id]
            .iter()
            .map(|&id| self.graph.broadcast(id, shape.domain, None, location))
            .collect();
        let shape = Shape {
            domain: parent,
            ..shape
        };
        let id = self.graph.push(Op::SegmentDot, inputs, shape, location);
        Array::from_id(&self.graph, id)
    }

    /// Sum over all lanes, keeping channels and axis; uniform.
    #[track_caller]
    pub fn sum_lanes(&self) -> Array<A> {
        let shape = Shape {
            domain: UNIFORM,
            ..self.shape()
        };
        self.derive(Op::SumLanes, shape, Location::caller())
    }

    /// Sum along the inner axis.
    #[track_caller]
    pub fn sum_axis(&self) -> Array<A> {
        let shape = self.shape();
        if shape.axis.is_none() {
            return self.clone();
        }
        let shape = Shape {
            axis: None,
            ..shape
        };
        self.derive(Op::SumAxis, shape, Location::caller())
    }

    /// The largest element along the inner axis, detached: a shift that keeps exponentials from overflowing.
    ///
    /// `ln(sum exp(x))` is `ln(sum exp(x - m)) + m` for any `m`, and so is its derivative: [`Array::log_sum_exp`].
    #[track_caller]
    pub fn max_axis(&self) -> Detached {
        let shape = Shape {
            axis: None,
            ..self.shape()
        };
        self.derive(Op::MaxAxis, shape, Location::caller())
    }

    /// `ln(sum exp(x))` along the inner axis, without overflow.
    #[track_caller]
    pub fn log_sum_exp(&self) -> Array<A>
    where
        A: Join<Fixed, Out = A>,
    {
        let shift = self.max_axis();
        (self - &shift).exp().sum_axis().ln() + &shift
    }

    /// Sum of everything: axis, channels and lanes; a single number.
    #[track_caller]
    pub fn sum(&self) -> Array<A> {
        let mut sum = self.sum_axis();
        if sum.channels() > 1 {
            sum = sum.sum_channels();
        }
        sum.sum_lanes()
    }

    /// Rows of this table at `index`: channels and axis are carried. The adjoint scatters and adds.
    #[track_caller]
    pub fn gather(&self, index: &Index) -> Array<A> {
        let location = Location::caller();
        let Some(shape) = self.lookup_shape(index, "gather", location) else {
            return self.clone();
        };
        let id = self
            .graph
            .reuse(Op::Gather(index.id), self.id, shape, location);
        Array::from_id(&self.graph, id)
    }

    /// `sum_k weight_k * self[index_k]`: an interpolated lookup. Weights have one channel and no axis.
    #[track_caller]
    pub fn gather_weighted<B: Kind>(&self, corners: &[(&Index, &Array<B>)]) -> Array<A::Out>
    where
        A: Join<B>,
    {
        let location = Location::caller();
        let mut shape = self.shape();
        let mut inputs = vec![self.id];
        let mut indices = Vec::new();
        if corners.is_empty() || corners.len() > CORNERS {
            self.reject("gather_weighted", location, "give one to eight corners");
        }
        for (index, weight) in corners {
            let found = self.lookup_shape(index, "gather_weighted", location);
            let Some(found) = found.filter(|_| self.owns(weight, "gather_weighted", location))
            else {
                return Array::from_id(&self.graph, self.id);
            };
            if indices.is_empty() {
                shape = found;
            } else if found != shape {
                let recording = self.graph.recording.borrow();
                let names =
                    [corners[0].0, index].map(|index| recording.indices[index.id].name.clone());
                drop(recording);
                let [first, other] = names;
                let hint = format!(
                    "the indices of all corners have one domain, but `{other}` has another than `{first}`"
                );
                self.reject("gather_weighted", location, hint);
            }
            let weight_shape = weight.shape();
            let fits = weight_shape.domain == shape.domain || weight_shape.domain == UNIFORM;
            if !fits || weight_shape.channels != 1 || weight_shape.axis.is_some() {
                self.graph.fail(GraphError::ShapeMismatch {
                    op: "gather_weighted",
                    lhs: self.graph.describe(self.id),
                    rhs: self.graph.describe(weight.id),
                    hint: "a weight has one channel, no axis, and the domain of its index"
                        .to_string(),
                    location: location.to_string(),
                });
            }
            inputs.push(
                self.graph
                    .broadcast(weight.id, shape.domain, None, location),
            );
            indices.push(index.id);
        }
        let id = self
            .graph
            .push(Op::GatherWeighted(indices), inputs, shape, location);
        Array::from_id(&self.graph, id)
    }

    /// A fixed linear operator on the whole array, channel by channel; the axis goes along as columns.
    #[track_caller]
    pub fn linear_map(&self, to: &Domain, map: Arc<dyn LinearMap>) -> Array<A> {
        let location = Location::caller();
        if !self.owns_handle(to.graph, "linear_map", "a domain", location) {
            return self.clone();
        }
        let shape = Shape {
            domain: to.id,
            ..self.shape()
        };
        self.derive(Op::Map(map), shape, location)
    }

    /// A dense layer: the channels of each lane times a uniform matrix of `out x in` channels (row-major), plus an
    /// optional uniform bias of `out` channels.
    #[track_caller]
    pub fn matmul<B: Kind>(&self, weight: &Array<B>, bias: Option<&Array<B>>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        let location = Location::caller();
        for operand in [Some(weight), bias].into_iter().flatten() {
            if !self.owns(operand, "matmul", location) {
                return Array::from_id(&self.graph, self.id);
            }
        }
        let (shape, matrix) = (self.shape(), weight.shape());
        let channels = matrix.channels / shape.channels.max(1);
        let fits = shape.axis.is_none()
            && matrix.axis.is_none()
            && matrix.domain == UNIFORM
            && channels * shape.channels == matrix.channels;
        if !fits {
            self.graph.fail(GraphError::ShapeMismatch {
                op: "matmul",
                lhs: self.graph.describe(self.id),
                rhs: self.graph.describe(weight.id),
                hint: "the weight is uniform with out x in channels, and neither has an axis"
                    .to_string(),
                location: location.to_string(),
            });
        }
        let mut inputs = vec![self.id, weight.id];
        if let Some(bias) = bias {
            let offset = bias.shape();
            if offset.domain != UNIFORM || offset.axis.is_some() || offset.channels != channels {
                bias.reject(
                    "matmul",
                    location,
                    format!(
                        "the bias of {} times {} is uniform with {channels} channels",
                        self.graph.describe(self.id),
                        self.graph.describe(weight.id)
                    ),
                );
            }
            inputs.push(bias.id);
        }
        // A weight that is refused may leave none, which what follows does not expect.
        let channels = channels.max(1);
        let shape = Shape { channels, ..shape };
        let id = self.graph.push(Op::Matmul, inputs, shape, location);
        Array::from_id(&self.graph, id)
    }

    fn segment(&self, op: Op, location: &'static Location<'static>) -> Array<A> {
        let shape = self.shape();
        let Some(parent) = self.parent_of(shape.domain) else {
            self.reject(op.name(), location, NO_SEGMENTS);
            return self.clone();
        };
        let shape = Shape {
            domain: parent,
            ..shape
        };
        self.derive(op, shape, location)
    }

    /// Whether another operand is of this one's graph; a mistake if not.
    fn owns<B>(
        &self,
        other: &Array<B>,
        op: &'static str,
        location: &'static Location<'static>,
    ) -> bool {
        let names = || {
            let other = other.graph.describe(other.id);
            (self.graph.describe(self.id), other)
        };
        self.graph.owns(other.graph.stamp, op, location, names)
    }

    /// The same for a domain or an index array.
    fn owns_handle(
        &self,
        stamp: u64,
        op: &'static str,
        what: &str,
        location: &'static Location<'static>,
    ) -> bool {
        let names = || (self.graph.describe(self.id), what.to_string());
        self.graph.owns(stamp, op, location, names)
    }

    fn parent_of(&self, domain: usize) -> Option<usize> {
        self.graph.recording.borrow().domains[domain].parent
    }

    /// The shape of a lookup in this table; nothing if the index is of another graph.
    fn lookup_shape(
        &self,
        index: &Index,
        op: &'static str,
        location: &'static Location<'static>,
    ) -> Option<Shape> {
        let shape = self.shape();
        if !self.owns_handle(index.graph, op, "an index", location) {
            return None;
        }
        let info = self.graph.recording.borrow().indices[index.id].clone();
        if info.table != shape.domain {
            let [table, own] = [info.table, shape.domain].map(|id| self.graph.domain_name(id));
            self.reject(
                op,
                location,
                format!(
                    "index `{}` looks up the domain `{table}`: declare it with the domain `{own}` as its table",
                    info.name
                ),
            );
        }
        Some(Shape {
            domain: info.domain,
            ..shape
        })
    }
}

/// Most corners of an interpolated lookup: those of a cell in three dimensions.
pub(crate) const CORNERS: usize = 8;

const NO_SEGMENTS: &str =
    "its domain has no parent: declare it with `segments`, or use `sum_lanes`";
