//! Names of a graph that carry no value: domains, axes, index arrays.

/// A domain: a set of lanes, whose number is bound when a workspace is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Domain {
    pub(crate) graph: u64,
    pub(crate) id: usize,
}

/// An inner axis, contiguous in memory, whose size is bound when a workspace is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    pub(crate) graph: u64,
    pub(crate) id: usize,
}

/// An array that gives, for each lane of one domain, a lane of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Index {
    pub(crate) graph: u64,
    pub(crate) id: usize,
}
