//! The graph being recorded.

use std::cell::RefCell;
use std::panic::Location;
use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::array::Array;
use super::node::{DomainInfo, IndexInfo, Node, NodeId, Op, Shape, UNIFORM};
use crate::error::GraphError;
use crate::program::Program;

/// Records array operations; [`Graph::compile`] makes a [`Program`] of them.
///
/// Operations on the values of a graph cannot fail one by one, so that formulas read as formulas: the first mistake is kept,
/// with both operands and the place in the source, and [`Graph::compile`] returns it.
#[derive(Clone)]
pub struct Graph {
    pub(super) recording: Rc<RefCell<Recording>>,
    pub(super) stamp: u64,
}

/// What has been recorded.
#[derive(Clone, Default)]
pub(crate) struct Recording {
    pub nodes: Vec<Node>,
    pub domains: Vec<DomainInfo>,
    pub axes: Vec<String>,
    pub indices: Vec<IndexInfo>,
    pub error: Option<GraphError>,
}

impl Default for Graph {
    fn default() -> Self {
        Self::new()
    }
}

impl Graph {
    /// An empty graph.
    pub fn new() -> Self {
        static STAMP: AtomicU64 = AtomicU64::new(0);
        let recording = Recording {
            domains: vec![DomainInfo {
                name: "uniform".to_string(),
                parent: None,
            }],
            ..Recording::default()
        };
        Graph {
            recording: Rc::new(RefCell::new(recording)),
            stamp: STAMP.fetch_add(1, Ordering::Relaxed),
        }
    }

    /// Compiles the named outputs, and what they need, into a program. Formulas are rewritten where that saves work: products
    /// and sums join into one rounding, repeated subexpressions are computed once. What carries a label stays as it is.
    ///
    /// # Errors
    /// The first mistake made while recording; two outputs of one name.
    #[track_caller]
    pub fn compile<T: AsRef<Array<M>>, M>(
        &self,
        outputs: &[(&str, T)],
    ) -> Result<Program, GraphError> {
        self.compile_as(outputs, true, Location::caller())
    }

    /// [`Graph::compile`] without rewriting formulas: every operation runs as recorded, so that results differ from those of
    /// [`Graph::compile`] by rounding alone. For debugging, and to check the rewriting.
    ///
    /// # Errors
    /// As [`Graph::compile`].
    #[track_caller]
    pub fn compile_as_recorded<T: AsRef<Array<M>>, M>(
        &self,
        outputs: &[(&str, T)],
    ) -> Result<Program, GraphError> {
        self.compile_as(outputs, false, Location::caller())
    }

    fn compile_as<T: AsRef<Array<M>>, M>(
        &self,
        outputs: &[(&str, T)],
        simplify: bool,
        location: &'static Location<'static>,
    ) -> Result<Program, GraphError> {
        let mut names: Vec<(String, NodeId)> = Vec::new();
        for (name, value) in outputs {
            let value = value.as_ref();
            if value.graph.stamp != self.stamp {
                return Err(GraphError::OtherGraph {
                    op: "compile",
                    lhs: "the graph".to_string(),
                    rhs: value.graph.describe(value.id),
                    location: location.to_string(),
                });
            }
            if names.iter().any(|(known, _)| known == name) {
                return Err(GraphError::Duplicate {
                    what: "the output",
                    name: name.to_string(),
                    location: location.to_string(),
                });
            }
            names.push((name.to_string(), value.id));
        }
        let recording = self.recording.borrow();
        match &recording.error {
            Some(error) => Err(error.clone()),
            None => Ok(Program::new(&recording, names, simplify)),
        }
    }

    /// Appends a node and returns its position.
    pub(super) fn push(
        &self,
        op: Op,
        inputs: Vec<NodeId>,
        shape: Shape,
        location: &'static Location<'static>,
    ) -> NodeId {
        let mut recording = self.recording.borrow_mut();
        let active = match op {
            Op::Param => true,
            Op::Detach | Op::MaxAxis => false,
            _ => inputs.iter().any(|&i| recording.nodes[i].active),
        };
        recording.nodes.push(Node {
            op,
            inputs,
            shape,
            name: None,
            label: None,
            active,
            location,
        });
        recording.nodes.len() - 1
    }

    pub(super) fn shape(&self, id: NodeId) -> Shape {
        self.recording.borrow().nodes[id].shape
    }

    /// Keeps the first mistake.
    pub(super) fn fail(&self, error: GraphError) {
        let mut recording = self.recording.borrow_mut();
        recording.error.get_or_insert(error);
    }

    /// A domain's name, for messages.
    pub(super) fn domain_name(&self, domain: usize) -> String {
        self.recording.borrow().domains[domain].name.clone()
    }

    /// A node's label and shape, for messages.
    pub(super) fn describe(&self, id: NodeId) -> String {
        self.recording.borrow().describe(id)
    }

    /// The operand on `domain` and with `axis`: itself, or repeated over lanes and axis as far as that is unambiguous.
    pub(super) fn broadcast(
        &self,
        id: NodeId,
        domain: usize,
        axis: Option<usize>,
        location: &'static Location<'static>,
    ) -> NodeId {
        let mut id = id;
        let mut shape = self.shape(id);
        if shape.domain == UNIFORM && domain != UNIFORM {
            shape.domain = domain;
            id = self.reuse(Op::Splat, id, shape, location);
        }
        if shape.axis.is_none() && axis.is_some() {
            shape.axis = axis;
            id = self.reuse(Op::Repeat, id, shape, location);
        }
        id
    }

    /// The node that already applies `op` (a broadcast, expansion or gather) to `input` with this shape, or a new one.
    pub(super) fn reuse(
        &self,
        op: Op,
        input: NodeId,
        shape: Shape,
        location: &'static Location<'static>,
    ) -> NodeId {
        let found = self.recording.borrow().nodes.iter().position(|node| {
            node.inputs == [input] && node.shape == shape && node.op.same_lookup(&op)
        });
        found.unwrap_or_else(|| self.push(op, vec![input], shape, location))
    }
}

impl Recording {
    /// A shape in words: `sample x 3 x frame`.
    pub fn shape_text(&self, shape: Shape) -> String {
        let mut text = self.domains[shape.domain].name.clone();
        if shape.channels != 1 {
            text += &format!(" x {}", shape.channels);
        }
        if let Some(axis) = shape.axis {
            text += &format!(" x {}", self.axes[axis]);
        }
        text
    }

    /// Label, or operation, and shape of a node.
    pub fn describe(&self, id: NodeId) -> String {
        let node = &self.nodes[id];
        let name = match (node.called(), &node.op) {
            (Some(label), _) => format!("`{label}`"),
            (None, Op::Constant(value)) => format!("the constant {value}"),
            (None, op) => format!("a result of `{}`", op.name()),
        };
        format!("{name} ({})", self.shape_text(node.shape))
    }
}
