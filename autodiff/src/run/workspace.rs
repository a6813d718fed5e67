//! A workspace: what is bound to a program, and what running it leaves.

use std::sync::Arc;

use super::block::Whole;
use super::driver::{State, own};
use super::hessian::Curvature;
use super::sizes::{Extent, Sizes, list};
use crate::buffer::Buffer;
use crate::error::RunError;
use crate::graph::{NodeId, Op};
use crate::program::Program;
use crate::real::Scalar;

/// Sizes, bound arrays and results of a program, for one scalar type.
///
/// Arrays are `[channel][lane][axis]`, contiguous. Memory is allocated when the workspace is made and at the first pass of
/// each kind; later passes allocate nothing.
pub struct Workspace<S: Scalar> {
    pub(super) state: State<S>,
    pub(super) stamp: u64,
    /// Leaves that are bound, or need not be.
    bound: Vec<bool>,
    bound_index: Vec<bool>,
    /// Whether whole values are those of the bound arrays.
    pub(super) fresh: bool,
    /// Whether gradients, and tangents, have been computed.
    pub(super) has_gradient: bool,
    pub(super) has_tangent: bool,
    /// Stands for an index array that is not there.
    pub(super) no_index: Arc<[u32]>,
    names: Names,
    pub(super) sizes: Sizes,
    pub(super) curvature: Option<Box<Curvature<S>>>,
}

/// What can be bound and read, by name.
struct Names {
    leaves: Vec<(String, NodeId, Leaf, String)>,
    indices: Vec<(String, usize, usize, String)>,
    outputs: Vec<(String, NodeId)>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Leaf {
    Param,
    Input,
    Mask,
}

impl Program {
    /// A workspace with these sizes.
    ///
    /// # Errors
    /// A domain or axis without a size, contradicting sizes, an axis of no elements, a linear map of the wrong shape.
    pub fn workspace<S: Scalar>(&self, sizes: &Sizes) -> Result<Workspace<S>, RunError> {
        Ok(Workspace {
            state: S::state(self, self.extent(sizes)?, sizes),
            stamp: self.stamp,
            bound: self.used.iter().map(|used| !used).collect(),
            bound_index: self.used_indices.iter().map(|used| !used).collect(),
            fresh: false,
            has_gradient: false,
            has_tangent: false,
            no_index: Arc::from([]),
            names: Names::new(self),
            sizes: sizes.clone(),
            curvature: None,
        })
    }

    /// Gives a workspace other sizes in the memory that it has, as where every batch brings another number of samples.
    ///
    /// Parameters, inputs and masks stay bound if they are as long as before, and index arrays if their table is, too. Values,
    /// gradients and tangents are to be computed again. Memory that was needed once is kept ([`Workspace::bytes`]).
    ///
    /// # Errors
    /// As [`Program::workspace`], or a workspace of another program; the workspace then is as it was.
    pub fn resize<S: Scalar>(&self, ws: &mut Workspace<S>, sizes: &Sizes) -> Result<(), RunError> {
        if ws.stamp != self.stamp {
            return Err(RunError::OtherProgram);
        }
        let extent = self.extent(sizes)?;
        let (lengths, lanes) = (ws.state.lengths.clone(), ws.state.extent.lanes.clone());
        S::resize(&mut ws.state, self, extent, sizes);
        for (id, length) in lengths.iter().enumerate() {
            ws.bound[id] &= !self.used[id] || *length == ws.state.lengths[id];
        }
        for (id, index) in self.indices.iter().enumerate() {
            let same = |domain: usize| lanes[domain] == ws.state.extent.lanes[domain];
            let kept = same(index.domain) && same(index.table);
            ws.bound_index[id] &= !self.used_indices[id] || kept;
        }
        (ws.fresh, ws.has_gradient, ws.has_tangent) = (false, false, false);
        ws.sizes = sizes.clone();
        ws.curvature = None;
        Ok(())
    }

    /// What the sizes mean for the program's domains.
    fn extent(&self, sizes: &Sizes) -> Result<Extent, RunError> {
        let extent = Extent::new(self, sizes)?;
        for (id, node) in self.nodes.iter().enumerate() {
            let Op::Map(map) = &node.op else { continue };
            let input = self.nodes[node.inputs[0]].shape.domain;
            let shape = (extent.lanes[input], extent.lanes[node.shape.domain]);
            if map.shape() != shape {
                return Err(RunError::MapShape {
                    name: self.node_name(id),
                    map_in: map.shape().0,
                    map_out: map.shape().1,
                    domain_in: shape.0,
                    domain_out: shape.1,
                });
            }
        }
        Ok(extent)
    }
}

impl Names {
    fn new(program: &Program) -> Self {
        let leaves = program.nodes.iter().enumerate().filter_map(|(id, node)| {
            let kind = match node.op {
                Op::Param => Leaf::Param,
                Op::Input => Leaf::Input,
                Op::Mask => Leaf::Mask,
                _ => return None,
            };
            let name = node.name.clone().unwrap_or_default();
            Some((name, id, kind, program.shape_text(node.shape)))
        });
        let indices = program.indices.iter().map(|index| {
            let table = program.domains[index.table].name.clone();
            (index.name.clone(), index.domain, index.table, table)
        });
        Names {
            leaves: leaves.collect(),
            indices: indices.collect(),
            outputs: program.outputs.clone(),
        }
    }
}

impl<S: Scalar> Workspace<S> {
    /// Binds a copy of `values` to a parameter or input.
    ///
    /// # Errors
    /// An unknown name, or a wrong length.
    pub fn set(&mut self, name: &str, values: &[S]) -> Result<(), RunError> {
        let (id, len) = self.leaf(name, |kind| kind != Leaf::Mask, "parameter or input")?;
        self.check_len(name, id, len, values.len())?;
        let target = own(&mut self.state.values[id]);
        target.ensure(len);
        target.as_mut_slice().copy_from_slice(values);
        self.touch(id);
        Ok(())
    }

    /// Binds a shared array of single precision to a parameter or input, without a copy where that is the workspace's type.
    ///
    /// # Errors
    /// As [`Workspace::set`].
    pub fn bind_f32(&mut self, name: &str, values: &Arc<[f32]>) -> Result<(), RunError> {
        self.bind(name, S::shared(values))
    }

    /// Binds a shared array to a parameter or input, without a copy.
    ///
    /// # Errors
    /// As [`Workspace::set`].
    pub fn bind(&mut self, name: &str, values: Arc<[S]>) -> Result<(), RunError> {
        let (id, len) = self.leaf(name, |kind| kind != Leaf::Mask, "parameter or input")?;
        self.check_len(name, id, len, values.len())?;
        self.state.values[id] = Whole::Shared(values);
        self.touch(id);
        Ok(())
    }

    /// Binds a mask.
    ///
    /// # Errors
    /// As [`Workspace::set`].
    pub fn set_mask(&mut self, name: &str, values: &[bool]) -> Result<(), RunError> {
        let (id, len) = self.leaf(name, |kind| kind == Leaf::Mask, "mask")?;
        self.check_len(name, id, len, values.len())?;
        let target = own(&mut self.state.values[id]);
        target.ensure(len);
        for (t, &set) in target.as_mut_slice().iter_mut().zip(values) {
            *t = S::from_f64(set as u8 as f64);
        }
        self.touch(id);
        Ok(())
    }

    /// Binds a copy of an index array.
    ///
    /// # Errors
    /// As [`Workspace::set`]; an index out of range of its table.
    pub fn set_index(&mut self, name: &str, values: &[u32]) -> Result<(), RunError> {
        let id = self.check_index(name, values)?;
        // In place, if nobody else holds the array.
        match Arc::get_mut(&mut self.state.indices[id]) {
            Some(own) if own.len() == values.len() => own.copy_from_slice(values),
            _ => self.state.indices[id] = Arc::from(values),
        }
        self.touch_index(id);
        Ok(())
    }

    /// Binds a shared index array, without a copy.
    ///
    /// # Errors
    /// As [`Workspace::set_index`].
    pub fn bind_index(&mut self, name: &str, values: Arc<[u32]>) -> Result<(), RunError> {
        let id = self.check_index(name, &values)?;
        self.state.indices[id] = values;
        self.touch_index(id);
        Ok(())
    }

    /// The position of an index array that may hold these values.
    fn check_index(&self, name: &str, values: &[u32]) -> Result<usize, RunError> {
        let known = self.names.indices.iter().position(|index| index.0 == name);
        let Some(id) = known else {
            return Err(RunError::Unknown {
                what: "index",
                name: name.to_string(),
                known: list(self.names.indices.iter().map(|index| index.0.as_str())),
            });
        };
        let (_, domain, table, table_name) = &self.names.indices[id];
        let (expected, lanes) = (
            self.state.extent.lanes[*domain],
            self.state.extent.lanes[*table],
        );
        if values.len() != expected {
            return Err(RunError::Length {
                name: name.to_string(),
                shape: "one index per lane".to_string(),
                expected,
                found: values.len(),
            });
        }
        if let Some(lane) = values.iter().position(|&i| i as usize >= lanes) {
            return Err(RunError::IndexOutOfRange {
                name: name.to_string(),
                lane,
                value: values[lane] as u64,
                table: table_name.clone(),
                lanes,
            });
        }
        Ok(id)
    }

    /// The value of an output, `[channel][lane][axis]`, as of what is bound now.
    ///
    /// # Errors
    /// An unknown name; nothing has run since something was bound ([`Program::hvp`] computes no outputs).
    pub fn output(&self, name: &str) -> Result<&[S], RunError> {
        let id = self.output_id(name)?;
        match self.fresh {
            true => Ok(self.state.values[id].as_slice()),
            false => Err(not_computed("value", name, "`Program::forward`")),
        }
    }

    /// The tangent of an output, as long as the output, by the last [`Program::jvp`].
    ///
    /// # Errors
    /// An unknown name; no tangent has been computed before.
    pub fn tangent(&self, name: &str) -> Result<&[S], RunError> {
        let id = self.output_id(name)?;
        match self.has_tangent {
            true => Ok(self.state.tangents[id].as_slice()),
            false => Err(not_computed("tangent", name, "`Program::jvp`")),
        }
    }

    /// The gradient of a parameter, as long as the parameter, by the last [`Program::vjp`] or [`Program::gauss_newton`].
    ///
    /// # Errors
    /// An unknown name; no gradient has been computed before.
    pub fn gradient(&self, name: &str) -> Result<&[S], RunError> {
        let (id, _) = self.leaf(name, |kind| kind == Leaf::Param, "parameter")?;
        if !self.has_gradient {
            return Err(not_computed("gradient", name, "`Program::vjp`"));
        }
        Ok(self.state.adjoints[id].as_slice())
    }

    /// The array bound to a parameter or input; empty before it is bound.
    ///
    /// # Errors
    /// An unknown name.
    pub fn value(&self, name: &str) -> Result<&[S], RunError> {
        let (id, _) = self.leaf(name, |kind| kind != Leaf::Mask, "parameter or input")?;
        Ok(match self.bound[id] {
            true => self.state.values[id].as_slice(),
            // What was bound to other sizes.
            false => &[],
        })
    }

    /// Heap bytes held now; index arrays and shared arrays are not counted.
    pub fn bytes(&self) -> usize {
        let curvature = self.curvature.as_ref();
        self.state.bytes() + curvature.map_or(0, |curvature| curvature.bytes())
    }

    pub(super) fn output_id(&self, name: &str) -> Result<NodeId, RunError> {
        let found = self.names.outputs.iter().find(|output| output.0 == name);
        found
            .map(|output| output.1)
            .ok_or_else(|| RunError::Unknown {
                what: "output",
                name: name.to_string(),
                known: list(self.names.outputs.iter().map(|output| output.0.as_str())),
            })
    }

    pub(super) fn param(&self, name: &str) -> Result<(NodeId, usize), RunError> {
        self.leaf(name, |kind| kind == Leaf::Param, "parameter")
    }

    pub(super) fn check_len(
        &self,
        name: &str,
        id: NodeId,
        expected: usize,
        found: usize,
    ) -> Result<(), RunError> {
        if expected == found {
            return Ok(());
        }
        let leaf = self.names.leaves.iter().find(|leaf| leaf.1 == id);
        Err(RunError::Length {
            name: name.to_string(),
            shape: leaf.map_or_else(|| "the output".to_string(), |leaf| leaf.3.clone()),
            expected,
            found,
        })
    }

    /// Checks that everything is bound, and that the workspace belongs to the program.
    pub(super) fn check_ready(&self, program: &Program) -> Result<(), RunError> {
        if program.stamp != self.stamp {
            return Err(RunError::OtherProgram);
        }
        if let Some(leaf) = self.names.leaves.iter().find(|leaf| !self.bound[leaf.1]) {
            let call = match leaf.2 {
                Leaf::Mask => "set_mask",
                _ => "set",
            };
            return Err(RunError::Unbound {
                name: leaf.0.clone(),
                shape: leaf.3.clone(),
                call,
            });
        }
        if let Some(index) = self.bound_index.iter().position(|bound| !bound) {
            return Err(RunError::Unbound {
                name: self.names.indices[index].0.clone(),
                shape: "one index per lane".to_string(),
                call: "set_index",
            });
        }
        Ok(())
    }

    fn leaf(
        &self,
        name: &str,
        wanted: impl Fn(Leaf) -> bool,
        what: &'static str,
    ) -> Result<(NodeId, usize), RunError> {
        let mut candidates = self.names.leaves.iter().filter(|leaf| wanted(leaf.2));
        if let Some(leaf) = candidates.clone().find(|leaf| leaf.0 == name) {
            return Ok((leaf.1, self.lens(leaf.1)));
        }
        Err(RunError::Unknown {
            what,
            name: name.to_string(),
            known: list(candidates.by_ref().map(|leaf| leaf.0.as_str())),
        })
    }

    fn lens(&self, id: NodeId) -> usize {
        self.state.lengths[id]
    }

    fn touch(&mut self, id: NodeId) {
        self.bound[id] = true;
        self.fresh = false;
    }

    fn touch_index(&mut self, id: usize) {
        self.bound_index[id] = true;
        self.fresh = false;
    }

    /// The tangent array of a parameter, as long as the parameter.
    pub(super) fn tangent_of(&mut self, id: NodeId) -> &mut [S] {
        let len = self.lens(id);
        let buffer: &mut Buffer<S> = own(&mut self.state.tangents[id]);
        buffer.ensure(len);
        buffer.as_mut_slice()
    }
}

/// The error of asking for what has not been computed.
pub(super) fn not_computed(what: &'static str, name: &str, call: &'static str) -> RunError {
    RunError::NotComputed {
        what,
        name: name.to_string(),
        call,
    }
}
