//! Scatters into large tables, by stable bucketing.
//!
//! Chunks have private copies of small tables. Of a table that is large for its lookups, copies would take more memory, and more
//! time to clear and to add up, than the lookups themselves. There a chunk keeps what each lane passes back, sorts its lanes by
//! the range of rows that they go to, and the ranges are added up in parallel, each by one thread, in the order of lanes: the
//! same bits for any number of threads and any size of blocks.

use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use super::chunk::{Chunk, SCATTERING, chunks};
use super::driver::unlocked;
use super::interpolation::Corner;
use super::lookup::row_width;
use super::sizes::Extent;
use super::zero::times;
use crate::graph::{CORNERS, NodeId, Op};
use crate::program::{Phase, Program, Pull, PullKind};
use crate::real::Real;

/// Elements of a range of rows: of one channel, and few enough to stay in L2.
const RANGE: usize = 1 << 14;
/// How many times as large as what lanes keep private copies have to be. By `cargo bench -p autodiff --bench kernels -- tables`, 6
/// is even for single rows of three channels and 2 for four weighted ones, with one thread and with two.
const WORTHWHILE: usize = 4;

/// How lanes are kept and sorted whose adjoints go to one large table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bucketing {
    channels: usize,
    axis: usize,
    /// Rows that a lane adds to.
    corners: usize,
    /// Whether they have weights, which are kept as well.
    weighted: bool,
    /// Rows of the table.
    table: usize,
}

impl Bucketing {
    /// None where private copies are the better way; depends on the sizes alone.
    pub fn of(program: &Program, extent: &Extent, phase: &Phase, pull: &Pull) -> Option<Self> {
        if pull.kind != PullKind::Table {
            return None;
        }
        let shape = program.nodes[pull.target].shape;
        let (channels, axis) = (shape.channels, extent.axis(shape.axis));
        let user = &program.nodes[pull.user].op;
        let bucketing = Bucketing {
            channels,
            axis,
            corners: indices_of(user).len(),
            weighted: matches!(user, Op::GatherWeighted(_)),
            table: extent.lanes[shape.domain],
        };
        let lanes = extent.lanes[phase.domain];
        let copies = bucketing
            .table
            .saturating_mul(row_width(channels, axis))
            .saturating_mul(chunks(program, extent, phase));
        let entries = lanes.saturating_mul(bucketing.corners);
        let kept = bucketing.kept_len(lanes).saturating_add(entries);
        let countable = u32::try_from(entries).is_ok();
        (countable && copies / WORTHWHILE >= kept).then_some(bucketing)
    }

    /// Elements that `lanes` lanes keep: adjoints, channel by channel, then weights, corner by corner.
    pub fn kept_len(&self, lanes: usize) -> usize {
        let weights = if self.weighted { self.corners } else { 0 };
        (self.channels * self.axis + weights).saturating_mul(lanes)
    }

    /// Numbers that sort `lanes` lanes: where each range of rows begins, then the lanes' corners in order.
    pub fn sorted_len(&self, lanes: usize) -> usize {
        self.ranges() + 1 + self.corners * lanes
    }

    fn ranges(&self) -> usize {
        self.table.div_ceil(self.range())
    }

    /// Rows of a range.
    fn range(&self) -> usize {
        (RANGE / self.axis).max(1)
    }

    /// Keeps the adjoints `g` of some lanes of a chunk of `all` lanes, from its `first` on; channels of `g` are `pitch` apart.
    pub fn keep<R: Real>(
        &self,
        kept: &mut [R],
        (all, first, lanes): (usize, usize, usize),
        (g, pitch): (&[R], usize),
        corners: &[Corner<R>],
    ) {
        let (all, first, len) = (all * self.axis, first * self.axis, lanes * self.axis);
        for c in 0..self.channels {
            let target = &mut kept[c * all + first..][..len];
            target.copy_from_slice(&g[c * pitch..][..len]);
        }
        let weights = &mut kept[self.channels * all..];
        let (all, first) = (all / self.axis, first / self.axis);
        for (k, (_, weight)) in corners.iter().enumerate() {
            weights[k * all + first..][..lanes].copy_from_slice(&weight[..lanes]);
        }
    }

    /// Whether anything that a chunk of `lanes` lanes keeps adds what is not finite to the table.
    pub fn spoils<R: Real>(&self, kept: &[R], lanes: usize) -> bool {
        let kept = Kept::new(self, kept, lanes);
        let mut corners = (0..lanes).flat_map(|lane| (0..self.corners).map(move |k| (lane, k)));
        corners.any(|(lane, k)| {
            let mut adjoint = (0..self.channels).flat_map(|c| kept.row(c, lane));
            adjoint.any(|g| !times(*g, kept.weight(lane, k)).is_finite())
        })
    }

    /// Sorts the corners of a chunk's lanes by range, stably: counts, first positions, places. The first lane is the first of
    /// each index array.
    fn sort(&self, indices: &[&[u32]], sorted: &mut [u32]) {
        let ranges = self.ranges();
        let (starts, order) = sorted.split_at_mut(ranges + 1);
        let range = self.range();
        starts.fill(0);
        for index in indices {
            for &row in *index {
                starts[row as usize / range] += 1;
            }
        }
        let mut next = 0;
        for start in &mut *starts {
            next += std::mem::replace(start, next);
        }
        let lanes = indices.first().map_or(0, |index| index.len());
        for lane in 0..lanes {
            for (k, index) in indices.iter().enumerate() {
                let place = &mut starts[index[lane] as usize / range];
                order[*place as usize] = (lane * self.corners + k) as u32;
                *place += 1;
            }
        }
        // Each start has moved on to the next one.
        starts.copy_within(..ranges, 1);
        starts[0] = 0;
    }

    /// Sorts what chunks kept for pull `at` of the table's `user`, and writes, or adds, all of it to `target`.
    pub fn assemble<R: Real>(
        &self,
        (program, arrays): (&Program, &[Arc<[u32]>]),
        user: NodeId,
        (chunks, at): (&mut [Mutex<Chunk<R>>], usize),
        target: &mut [R],
        add: bool,
    ) {
        let indices = |chunk: &Chunk<R>| {
            let mut found: [&[u32]; CORNERS] = [&[]; CORNERS];
            for (found, &number) in found.iter_mut().zip(indices_of(&program.nodes[user].op)) {
                *found = &arrays[number][chunk.span.lanes.clone()];
            }
            found
        };
        chunks.par_iter_mut().for_each(|chunk| {
            let chunk = unlocked(chunk);
            let mut sorted = std::mem::take(&mut chunk.sorted[at]);
            self.sort(&indices(chunk)[..self.corners], &mut sorted);
            chunk.sorted[at] = sorted;
        });
        // Read by all threads at once, which locks would keep from each other.
        let mut sorted = [None; SCATTERING];
        for (sorted, chunk) in sorted.iter_mut().zip(chunks) {
            *sorted = Some(&*unlocked(chunk));
        }
        let (channel_len, part_len) = (self.table * self.axis, self.range() * self.axis);
        for (c, target) in target.chunks_mut(channel_len.max(1)).enumerate() {
            let parts = target.par_chunks_mut(part_len).enumerate();
            parts.for_each(|(range, part)| {
                if !add {
                    part.fill(R::default());
                }
                for chunk in sorted.into_iter().flatten() {
                    self.add_range(chunk, at, &indices(chunk), (c, range), part);
                }
            });
        }
    }

    /// Adds one channel of what a chunk's lanes pass to a range of rows.
    fn add_range<R: Real>(
        &self,
        chunk: &Chunk<R>,
        at: usize,
        indices: &[&[u32]],
        (channel, range): (usize, usize),
        part: &mut [R],
    ) {
        let kept = Kept::new(self, chunk.pull[at].as_slice(), chunk.span.lanes.len());
        let (starts, order) = chunk.sorted[at].split_at(self.ranges() + 1);
        let first = range * self.range();
        for &entry in &order[starts[range] as usize..starts[range + 1] as usize] {
            let (lane, k) = (entry as usize / self.corners, entry as usize % self.corners);
            let row = (indices[k][lane] as usize - first) * self.axis;
            let targets = &mut part[row..row + self.axis];
            let weight = kept.weight(lane, k);
            for (target, g) in targets.iter_mut().zip(kept.row(channel, lane)) {
                *target = *target + times(*g, weight);
            }
        }
    }
}

/// The index arrays of a lookup, one for each row that a lane reads.
fn indices_of(op: &Op) -> &[usize] {
    match op {
        Op::Gather(index) => std::slice::from_ref(index),
        Op::GatherWeighted(indices) => indices,
        _ => &[],
    }
}

/// What the lanes of a chunk keep.
struct Kept<'a, R> {
    adjoints: &'a [R],
    weights: &'a [R],
    axis: usize,
    lanes: usize,
}

impl<'a, R: Real> Kept<'a, R> {
    fn new(bucketing: &Bucketing, kept: &'a [R], lanes: usize) -> Self {
        let axis = bucketing.axis;
        let (adjoints, weights) = kept.split_at(bucketing.channels * axis * lanes);
        Kept {
            adjoints,
            weights,
            axis,
            lanes,
        }
    }

    /// One channel of a lane's adjoint.
    #[inline(always)]
    fn row(&self, channel: usize, lane: usize) -> &'a [R] {
        let start = (channel * self.lanes + lane) * self.axis;
        &self.adjoints[start..start + self.axis]
    }

    /// The weight of a corner; one where there are no weights.
    #[inline(always)]
    fn weight(&self, lane: usize, corner: usize) -> R {
        match self.weights {
            [] => R::from_f64(1.0),
            weights => weights[corner * self.lanes + lane],
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Graph, Program, Sizes, Workspace};

    const LANES: usize = 9000;
    const AXIS: usize = 3;

    /// Lookups in one table, single and weighted, so that several chunks add to several ranges.
    fn program(along: bool) -> Program {
        let g = Graph::new();
        let (lane, row) = (g.domain("lane"), g.domain("row"));
        let frames = g.axis("frames");
        let table = match along {
            true => g.param_along("table", &row, 1, &frames),
            false => g.param("table", &row, 3),
        };
        let [i, j] = ["i", "j"].map(|name| g.index(name, &lane, &row));
        let weight = g.input("weight", &lane, 1);
        let share = g.input("share", &lane, 1);
        let found = table.gather(&i) + table.gather_weighted(&[(&i, &weight), (&j, &weight)]);
        let loss = (found * &share).sum();
        g.compile(&[("loss", &loss)]).unwrap()
    }

    fn number(i: usize) -> f64 {
        (i * 7919 % 1009) as f64 / 512.0
    }

    fn workspace(program: &Program, rows: usize, block: usize, weight: f64) -> Workspace<f64> {
        let sizes = Sizes::new().lanes("lane", LANES).lanes("row", rows);
        let sizes = sizes.axis("frames", AXIS).block(block);
        let mut ws = program.workspace::<f64>(&sizes).unwrap();
        ws.set("table", &vec![1.0; AXIS * rows]).unwrap();
        for (name, factor) in [("i", 31), ("j", 77)] {
            let index = |lane: usize| (lane * factor % rows.min(60_000)) as u32;
            let index: Vec<u32> = (0..LANES).map(index).collect();
            ws.set_index(name, &index).unwrap();
        }
        ws.set("weight", &[weight; LANES]).unwrap();
        let mut shares: Vec<f64> = (0..LANES).map(number).collect();
        shares[17] = 0.0;
        ws.set("share", &shares).unwrap();
        ws
    }

    #[test]
    fn large_tables_get_what_small_ones_do() {
        for along in [false, true] {
            let program = program(along);
            let run = |rows: usize, block: usize| {
                let mut ws = workspace(&program, rows, block, 0.25);
                program.vjp(&mut ws, "loss").unwrap();
                let used = ws.state.bucketings.iter().flatten().any(Option::is_some);
                assert_eq!(used, rows > 10_000, "{rows} rows");
                ws.gradient("table").unwrap().to_vec()
            };
            let large = run(200_000, 512);
            assert_eq!(large, run(200_000, 64));
            let rows = 200_000;
            let mut expected = vec![0.0; AXIS * rows];
            let channel = |c: usize, row: usize| match along {
                true => row * AXIS + c,
                false => c * rows + row,
            };
            for lane in (0..LANES).filter(|&lane| lane != 17) {
                let [i, j] = [31, 77].map(|factor| lane * factor % 60_000);
                for c in 0..AXIS {
                    expected[channel(c, i)] += 1.25 * number(lane);
                    expected[channel(c, j)] += 0.25 * number(lane);
                }
            }
            for (x, y) in large.iter().zip(&expected) {
                assert!((x - y).abs() <= 1e-13 * y.abs(), "{x} for {y}");
            }
            assert!(run(900, 512).iter().sum::<f64>() > 0.0);
        }
    }

    #[test]
    fn an_adjoint_of_zero_passes_a_weight_that_is_not_finite() {
        let program = program(false);
        let mut ws = workspace(&program, 200_000, 512, 0.25);
        let mut weights = [0.25; LANES];
        weights[17] = f64::NAN;
        ws.set("weight", &weights).unwrap();
        program.vjp(&mut ws, "loss").unwrap();
        assert!(ws.gradient("table").unwrap().iter().all(|x| x.is_finite()));
        assert!(
            program
                .find_non_finite_gradient(&mut ws, "loss")
                .unwrap()
                .is_none()
        );
        weights[18] = f64::INFINITY;
        ws.set("weight", &weights).unwrap();
        let found = program.find_non_finite_gradient(&mut ws, "loss").unwrap();
        assert!(found.is_some());
    }
}
