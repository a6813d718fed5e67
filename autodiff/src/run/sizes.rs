//! Sizes bound when a workspace is made: lanes, axes, segments.

use std::ops::Range;
use std::sync::Arc;

use crate::error::RunError;
use crate::graph::Shape;
use crate::program::Program;

/// Sizes of the domains and axes of a program, and how to run it.
#[derive(Clone, Debug)]
pub struct Sizes {
    lanes: Vec<(String, usize)>,
    axes: Vec<(String, usize)>,
    counts: Vec<(String, usize)>,
    offsets: Vec<(String, Arc<[u32]>)>,
    pub(crate) block: usize,
    pub(crate) threads: Option<usize>,
}

impl Default for Sizes {
    fn default() -> Self {
        Self::new()
    }
}

impl Sizes {
    /// No sizes yet.
    pub fn new() -> Self {
        Sizes {
            lanes: Vec::new(),
            axes: Vec::new(),
            counts: Vec::new(),
            offsets: Vec::new(),
            block: 1024,
            threads: None,
        }
    }

    /// The number of lanes of a domain.
    pub fn lanes(mut self, domain: &str, lanes: usize) -> Self {
        self.lanes.push((domain.to_string(), lanes));
        self
    }

    /// The size of an axis, at least 1.
    pub fn axis(mut self, axis: &str, size: usize) -> Self {
        self.axes.push((axis.to_string(), size));
        self
    }

    /// The same number of lanes of `domain` for every lane of its parent.
    pub fn per_parent(mut self, domain: &str, count: usize) -> Self {
        self.counts.push((domain.to_string(), count));
        self
    }

    /// Segments of any length: lanes `offsets[p] .. offsets[p + 1]` of `domain` belong to lane `p` of its parent.
    pub fn offsets(mut self, domain: &str, offsets: impl Into<Arc<[u32]>>) -> Self {
        self.offsets.push((domain.to_string(), offsets.into()));
        self
    }

    /// How many elements of a value are worked on at once (1024): more than L1 holds is slower, few cost overhead. Results do
    /// not depend on it.
    pub fn block(mut self, elements: usize) -> Self {
        self.block = elements;
        self
    }

    /// How many threads of the current rayon pool to use at most. Results do not depend on it.
    pub fn threads(mut self, threads: usize) -> Self {
        self.threads = Some(threads);
        self
    }
}

/// How the lanes of a domain divide among those of its parent.
#[derive(Clone, Debug)]
pub(crate) enum Segments {
    Fixed(usize),
    Offsets(Arc<[u32]>),
}

impl Segments {
    /// The lanes of parent `p`.
    #[inline(always)]
    pub fn bounds(&self, p: usize) -> (usize, usize) {
        match self {
            Segments::Fixed(count) => (p * count, (p + 1) * count),
            Segments::Offsets(offsets) => (offsets[p] as usize, offsets[p + 1] as usize),
        }
    }

    /// Lanes of the longest segment.
    pub fn longest(&self, parents: usize) -> usize {
        match self {
            Segments::Fixed(count) => *count,
            Segments::Offsets(offsets) => {
                let lens = (0..parents).map(|p| (offsets[p + 1] - offsets[p]) as usize);
                lens.max().unwrap_or(0)
            }
        }
    }

    /// The parent of a lane.
    pub fn parent(&self, lane: usize) -> usize {
        match self {
            Segments::Fixed(count) => lane / (*count).max(1),
            Segments::Offsets(offsets) => offsets[1..].partition_point(|&end| end as usize <= lane),
        }
    }

    /// The parts of segments within `start .. start + len`.
    pub fn pieces(&self, start: usize, len: usize) -> Pieces<'_> {
        Pieces {
            segments: self,
            parent: if len == 0 { 0 } else { self.parent(start) },
            lane: start,
            end: start + len,
        }
    }
}

impl Pieces<'_> {
    /// The parts of segments in the `len` lanes that follow those before.
    #[inline(always)]
    pub fn advance(&mut self, len: usize) {
        // The segment that the last part belongs to may go on.
        self.parent = self.parent.saturating_sub(1);
        self.end = self.lane + len;
    }
}

/// Iterates over [`Piece`]s.
pub(crate) struct Pieces<'a> {
    segments: &'a Segments,
    parent: usize,
    lane: usize,
    end: usize,
}

/// The part of one segment that lies within a block.
pub(crate) struct Piece {
    pub parent: usize,
    /// Lanes, counted over the whole domain.
    pub lanes: Range<usize>,
    /// All lanes of the segment.
    pub segment: Range<usize>,
}

impl Iterator for Pieces<'_> {
    type Item = Piece;

    #[inline(always)]
    fn next(&mut self) -> Option<Piece> {
        while self.lane < self.end {
            let (start, end) = self.segments.bounds(self.parent);
            let parent = self.parent;
            self.parent += 1;
            if end <= self.lane {
                continue;
            }
            let lanes = self.lane..end.min(self.end);
            self.lane = lanes.end;
            return Some(Piece {
                parent,
                lanes,
                segment: start..end,
            });
        }
        None
    }
}

/// Sizes resolved against a program.
#[derive(Clone, Debug, Default)]
pub(crate) struct Extent {
    pub lanes: Vec<usize>,
    pub axes: Vec<usize>,
    pub segments: Vec<Option<Segments>>,
}

impl Extent {
    /// Length of the inner axis.
    pub fn axis(&self, axis: Option<usize>) -> usize {
        axis.map_or(1, |axis| self.axes[axis])
    }

    /// Elements of one channel.
    pub fn column(&self, shape: Shape) -> usize {
        self.lanes[shape.domain].saturating_mul(self.axis(shape.axis))
    }

    pub fn new(program: &Program, sizes: &Sizes) -> Result<Extent, RunError> {
        for (names, what) in [
            (names(&sizes.lanes), "domain"),
            (names(&sizes.counts), "domain"),
            (names(&sizes.offsets), "domain"),
        ] {
            for name in names {
                if !program.domains.iter().any(|domain| domain.name == name) {
                    return Err(RunError::Unknown {
                        what,
                        name,
                        known: list(program.domains.iter().map(|domain| domain.name.as_str())),
                    });
                }
            }
        }
        let mut extent = Extent {
            lanes: vec![1],
            axes: Vec::new(),
            segments: vec![None],
        };
        for name in &program.axes {
            let size = find(&sizes.axes, name).ok_or(RunError::MissingSize {
                what: "axis",
                name: name.clone(),
                hint: "`Sizes::axis`",
            })?;
            if *size == 0 {
                return Err(RunError::Sizes {
                    name: name.clone(),
                    problem: "an axis has at least one element".to_string(),
                });
            }
            extent.axes.push(*size);
        }
        for domain in &program.domains[1..] {
            let (lanes, segments) = extent.domain(program, sizes, domain)?;
            extent.lanes.push(lanes);
            extent.segments.push(segments);
        }
        extent.check_elements(program)?;
        Ok(extent)
    }

    /// Refuses values that no address reaches, so that their elements can be counted without a check.
    fn check_elements(&self, program: &Program) -> Result<(), RunError> {
        // Partial sums, padding and dual numbers of a value take less than this many times its elements.
        const MOST: usize = isize::MAX as usize / (1 << 10);
        for node in &program.nodes {
            let shape = node.shape;
            let sides = [self.lanes[shape.domain], self.axis(shape.axis)];
            let elements = sides
                .iter()
                .try_fold(shape.channels, |n, side| n.checked_mul(*side));
            if elements.is_none_or(|n| n > MOST) {
                return Err(RunError::Sizes {
                    name: program.domains[shape.domain].name.clone(),
                    problem: format!(
                        "{} x {} x {} elements of a value are more than can be addressed; the most is {MOST}",
                        shape.channels, sides[0], sides[1]
                    ),
                });
            }
        }
        Ok(())
    }

    fn domain(
        &self,
        program: &Program,
        sizes: &Sizes,
        domain: &crate::graph::DomainInfo,
    ) -> Result<(usize, Option<Segments>), RunError> {
        let name = &domain.name;
        let given = find(&sizes.lanes, name).copied();
        let Some(parent) = domain.parent else {
            let lanes = given.ok_or(RunError::MissingSize {
                what: "domain",
                name: name.clone(),
                hint: "`Sizes::lanes`",
            })?;
            return Ok((lanes, None));
        };
        let parents = self.lanes[parent];
        let parent_name = &program.domains[parent].name;
        let wrong = |problem: String| RunError::Sizes {
            name: name.clone(),
            problem,
        };
        let (lanes, segments) = if let Some(offsets) = find(&sizes.offsets, name) {
            if offsets.len() != parents + 1 {
                return Err(wrong(format!(
                    "`offsets` has {} entries, expected one more than the {parents} lanes of `{parent_name}`",
                    offsets.len()
                )));
            }
            if offsets[0] != 0 || offsets.windows(2).any(|pair| pair[0] > pair[1]) {
                return Err(wrong(
                    "`offsets` must start at 0 and never fall".to_string(),
                ));
            }
            (
                offsets[parents] as usize,
                Segments::Offsets(offsets.clone()),
            )
        } else if let Some(&count) = find(&sizes.counts, name) {
            let lanes = parents
                .checked_mul(count)
                .ok_or_else(|| wrong(format!("{parents} x {count} lanes do not fit in memory")))?;
            (lanes, Segments::Fixed(count))
        } else {
            return Err(RunError::MissingSize {
                what: "segments of domain",
                name: name.clone(),
                hint: "`Sizes::per_parent` or `Sizes::offsets`",
            });
        };
        match given {
            Some(given) if given != lanes => Err(wrong(format!(
                "`lanes` says {given}, but its segments hold {lanes}"
            ))),
            _ => Ok((lanes, Some(segments))),
        }
    }
}

fn names<T>(pairs: &[(String, T)]) -> Vec<String> {
    pairs.iter().map(|(name, _)| name.clone()).collect()
}

fn find<'a, T>(pairs: &'a [(String, T)], name: &str) -> Option<&'a T> {
    // The last size given counts.
    pairs
        .iter()
        .rev()
        .find(|pair| pair.0 == name)
        .map(|pair| &pair.1)
}

/// Names in a message.
pub(crate) fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> = names.map(|name| format!("`{name}`")).collect();
    if names.is_empty() {
        "none".to_string()
    } else {
        names.join(", ")
    }
}
