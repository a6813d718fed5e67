//! Vector loops on contiguous rows, and sums whose order does not depend on how lanes are cut into blocks.

use pulp::{Arch, Simd};

use crate::op::kernel::{Kernel, dispatch};
use crate::real::Real;

/// Partial sums that a long sum of single elements is spread over, so that it vectorises. Element `i` of the sum goes to
/// partial sum `i % PARTIALS`, whatever block it comes in.
pub(super) const PARTIALS: usize = 16;

/// `target = source`, or `+=` when `add`.
pub(super) fn put<R: Real>(arch: Arch, target: &mut [R], source: &[R], add: bool) {
    if add {
        dispatch(arch, AddRow { target, source });
    } else {
        target.copy_from_slice(source);
    }
}

struct AddRow<'a, R> {
    target: &'a mut [R],
    source: &'a [R],
}

impl<R: Real> Kernel for AddRow<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        add_row(self.target, self.source);
    }
}

#[inline(always)]
fn add_row<R: Real>(target: &mut [R], source: &[R]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t = *t + *s;
    }
}

/// `target = value` everywhere, or `+=` when `add`.
#[inline(always)]
pub(super) fn put_value<R: Real>(target: &mut [R], value: R, add: bool) {
    if add {
        for t in target {
            *t = *t + value;
        }
    } else {
        target.fill(value);
    }
}

/// Adds elements `phase, phase + 1, ..` of a long sum to its partial sums.
pub(super) fn add_partials<R: Real>(arch: Arch, partial: &mut [R], phase: usize, source: &[R]) {
    dispatch(
        arch,
        AddPartials {
            partial,
            phase,
            source,
        },
    );
}

struct AddPartials<'a, R> {
    partial: &'a mut [R],
    phase: usize,
    source: &'a [R],
}

impl<R: Real> Kernel for AddPartials<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        spread(self.partial, self.phase, self.source);
    }
}

/// [`add_partials`], within a kernel.
#[inline(always)]
pub(super) fn spread<R: Real>(partial: &mut [R], phase: usize, source: &[R]) {
    let mut sums = [R::default(); PARTIALS];
    sums.copy_from_slice(&partial[..PARTIALS]);
    let first = phase % PARTIALS;
    let head = ((PARTIALS - first) % PARTIALS).min(source.len());
    let (start, rest) = source.split_at(head);
    for (i, x) in start.iter().enumerate() {
        sums[first + i] = sums[first + i] + *x;
    }
    let (whole, rest) = rest.as_chunks::<PARTIALS>();
    for chunk in whole {
        for i in 0..PARTIALS {
            sums[i] = sums[i] + chunk[i];
        }
    }
    for (i, x) in rest.iter().enumerate() {
        sums[i] = sums[i] + *x;
    }
    partial[..PARTIALS].copy_from_slice(&sums);
}

/// The total of partial sums, pairwise.
#[inline(always)]
pub(super) fn total<R: Real>(partial: &[R]) -> R {
    let mut sums = [R::default(); PARTIALS];
    sums.copy_from_slice(&partial[..PARTIALS]);
    pairwise(sums)
}

/// A step for each width, and a new array for each step: written in place, the halves would go through memory.
#[inline(always)]
fn pairwise<R: Real>(sums: [R; PARTIALS]) -> R {
    let mut eight = [R::default(); 8];
    for i in 0..8 {
        eight[i] = sums[i] + sums[i + 8];
    }
    let mut four = [R::default(); 4];
    for i in 0..4 {
        four[i] = eight[i] + eight[i + 4];
    }
    (four[0] + four[2]) + (four[1] + four[3])
}

/// [`spread`] from zero and [`total`] in one.
#[inline(always)]
pub(super) fn whole_sum<R: Real>(row: &[R]) -> R {
    let mut sums = [R::default(); PARTIALS];
    let (whole, rest) = row.as_chunks::<PARTIALS>();
    for chunk in whole {
        for i in 0..PARTIALS {
            sums[i] = sums[i] + chunk[i];
        }
    }
    for (sum, x) in sums.iter_mut().zip(rest) {
        *sum = *sum + *x;
    }
    pairwise(sums)
}

/// Sum of a whole row, in a fixed order.
pub(super) fn sum_row<R: Real>(arch: Arch, row: &[R]) -> R {
    let mut partial = [R::default(); PARTIALS];
    add_partials(arch, &mut partial, 0, row);
    total(&partial)
}
