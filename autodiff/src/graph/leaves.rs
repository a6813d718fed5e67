//! Declarations: domains, axes, parameters, inputs, index arrays, masks, constants.

use std::panic::Location;

use super::array::{Array, Detached, Kind, Mask, Var};
use super::handles::{Axis, Domain, Index};
use super::node::{DomainInfo, IndexInfo, Op, Shape, UNIFORM};
use super::record::Graph;
use crate::error::GraphError;

impl Graph {
    /// The domain of one lane.
    pub fn uniform(&self) -> Domain {
        Domain {
            graph: self.stamp,
            id: UNIFORM,
        }
    }

    /// Declares a domain: a set of lanes whose number is bound later.
    #[track_caller]
    pub fn domain(&self, name: &str) -> Domain {
        self.new_domain(name, None, Location::caller())
    }

    /// Declares a domain each of whose lanes belongs to one lane of `parent`, in consecutive segments.
    #[track_caller]
    pub fn segments(&self, name: &str, parent: &Domain) -> Domain {
        let location = Location::caller();
        let names = || (format!("the domain `{name}`"), "a domain".to_string());
        if !self.owns(parent.graph, "segments", location, names) {
            return self.new_domain(name, None, location);
        }
        if parent.id == UNIFORM {
            self.fail(GraphError::Operand {
                op: "segments",
                operand: "the uniform domain".to_string(),
                hint: "declare a plain domain and use `sum_lanes`".to_string(),
                location: location.to_string(),
            });
        }
        self.new_domain(name, Some(parent.id), location)
    }

    /// Declares an inner axis, whose size is bound later.
    #[track_caller]
    pub fn axis(&self, name: &str) -> Axis {
        let mut recording = self.recording.borrow_mut();
        if recording.axes.iter().any(|axis| axis == name) {
            let error = duplicate("axis", name, Location::caller());
            recording.error.get_or_insert(error);
        }
        recording.axes.push(name.to_string());
        Axis {
            graph: self.stamp,
            id: recording.axes.len() - 1,
        }
    }

    /// A differentiable array of `channels` values for every lane of `domain`.
    #[track_caller]
    pub fn param(&self, name: &str, domain: &Domain, channels: usize) -> Var {
        self.leaf(Op::Param, name, domain, channels, None, Location::caller())
    }

    /// A differentiable array of `channels` rows along `axis` for every lane of `domain`.
    #[track_caller]
    pub fn param_along(&self, name: &str, domain: &Domain, channels: usize, axis: &Axis) -> Var {
        let location = Location::caller();
        self.leaf(Op::Param, name, domain, channels, Some(axis), location)
    }

    /// An array that is not differentiated, of `channels` values for every lane of `domain`.
    #[track_caller]
    pub fn input(&self, name: &str, domain: &Domain, channels: usize) -> Detached {
        self.leaf(Op::Input, name, domain, channels, None, Location::caller())
    }

    /// An array that is not differentiated, of `channels` rows along `axis` for every lane of `domain`.
    #[track_caller]
    pub fn input_along(
        &self,
        name: &str,
        domain: &Domain,
        channels: usize,
        axis: &Axis,
    ) -> Detached {
        let location = Location::caller();
        self.leaf(Op::Input, name, domain, channels, Some(axis), location)
    }

    /// A boolean for every lane of `domain`.
    #[track_caller]
    pub fn mask(&self, name: &str, domain: &Domain) -> Mask {
        Mask {
            value: self.leaf(Op::Mask, name, domain, 1, None, Location::caller()),
        }
    }

    /// A lane of `table` for every lane of `domain`, checked when bound.
    #[track_caller]
    pub fn index(&self, name: &str, domain: &Domain, table: &Domain) -> Index {
        let location = Location::caller();
        let [domain, table] =
            [domain, table].map(|domain| self.own_domain(domain, "index", name, location));
        self.check_name(name, location);
        let mut recording = self.recording.borrow_mut();
        recording.indices.push(IndexInfo {
            name: name.to_string(),
            domain,
            table,
        });
        Index {
            graph: self.stamp,
            id: recording.indices.len() - 1,
        }
    }

    /// A number known now.
    #[track_caller]
    pub fn constant<A: Kind>(&self, value: f64) -> Array<A> {
        let shape = Shape {
            domain: UNIFORM,
            channels: 1,
            axis: None,
        };
        let id = self.push(Op::Constant(value), vec![], shape, Location::caller());
        Array::from_id(self, id)
    }

    fn leaf<A>(
        &self,
        op: Op,
        name: &str,
        domain: &Domain,
        channels: usize,
        axis: Option<&Axis>,
        location: &'static Location<'static>,
    ) -> Array<A> {
        let names = || (format!("`{name}`"), "an axis".to_string());
        let axis = axis.filter(|axis| self.owns(axis.graph, "declaration", location, names));
        let shape = Shape {
            domain: self.own_domain(domain, "declaration", name, location),
            channels,
            axis: axis.map(|axis| axis.id),
        };
        self.check_name(name, location);
        let id = self.push(op, vec![], shape, location);
        self.recording.borrow_mut().nodes[id].name = Some(name.to_string());
        let array = Array::from_id(self, id);
        if channels == 0 {
            array.reject("declaration", location, "declare at least one channel");
        }
        array
    }

    fn new_domain(
        &self,
        name: &str,
        parent: Option<usize>,
        location: &'static Location<'static>,
    ) -> Domain {
        let mut recording = self.recording.borrow_mut();
        if recording.domains.iter().any(|domain| domain.name == name) {
            let error = duplicate("domain", name, location);
            recording.error.get_or_insert(error);
        }
        recording.domains.push(DomainInfo {
            name: name.to_string(),
            parent,
        });
        Domain {
            graph: self.stamp,
            id: recording.domains.len() - 1,
        }
    }

    /// Leaves and index arrays are bound by name, so names are unique.
    fn check_name(&self, name: &str, location: &'static Location<'static>) {
        let mut recording = self.recording.borrow_mut();
        let taken = recording
            .nodes
            .iter()
            .any(|node| node.name.as_deref() == Some(name))
            || recording.indices.iter().any(|index| index.name == name);
        if taken {
            let error = duplicate("the name", name, location);
            recording.error.get_or_insert(error);
        }
    }

    /// Whether this graph has the stamp. If not, that is a mistake in using what `names` gives: something of this graph, and
    /// something of another.
    pub(super) fn owns(
        &self,
        stamp: u64,
        op: &'static str,
        location: &'static Location<'static>,
        names: impl FnOnce() -> (String, String),
    ) -> bool {
        if stamp != self.stamp {
            let (lhs, rhs) = names();
            self.fail(GraphError::OtherGraph {
                op,
                lhs,
                rhs,
                location: location.to_string(),
            });
        }
        stamp == self.stamp
    }

    /// The position of a domain; that of the uniform one stands in for a domain of another graph.
    fn own_domain(
        &self,
        domain: &Domain,
        op: &'static str,
        name: &str,
        location: &'static Location<'static>,
    ) -> usize {
        let names = || (format!("`{name}`"), "a domain".to_string());
        match self.owns(domain.graph, op, location, names) {
            true => domain.id,
            false => UNIFORM,
        }
    }
}

fn duplicate(what: &'static str, name: &str, location: &'static Location<'static>) -> GraphError {
    GraphError::Duplicate {
        what,
        name: name.to_string(),
        location: location.to_string(),
    }
}
