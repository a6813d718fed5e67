//! Interpolated lookups: weighted sums of rows of a table, and their adjoints.

use pulp::{Arch, Simd};

use super::lookup::Rows;
use super::zero::{Derivative, add_product};
use crate::op::kernel::{Kernel, dispatch};
use crate::real::{Fma, Real};

/// An index array and the weights of its rows.
pub(super) type Corner<'a, R> = (&'a [u32], &'a [R]);

/// Corners looked up together by one call; more corners take several.
const CORNERS: usize = 4;

/// `block[lane] (+)= sum_k weight_k[lane] table[index_k[lane]]`; the weights, or else the table, may be derivatives.
pub(super) fn gather_weighted<R: Real>(
    arch: Arch,
    table: &[R],
    rows: Rows,
    lanes: usize,
    corners: &[Corner<R>],
    block: &mut [R],
    first: bool,
    derivative: Derivative,
) {
    for channel in 0..rows.channels {
        let start = channel * rows.pitch;
        let target = &mut block[start..start + lanes * rows.axis];
        let mut add = !first;
        let mut groups = corners.chunks_exact(CORNERS);
        for group in groups.by_ref() {
            let corners: [_; CORNERS] = std::array::from_fn(|k| group[k]);
            let target = &mut *target;
            dispatch(
                arch,
                Interpolate {
                    table,
                    rows,
                    channel,
                    corners,
                    target,
                    add,
                    derivative,
                },
            );
            add = true;
        }
        for &corner in groups.remainder() {
            let (corners, target) = ([corner], &mut *target);
            dispatch(
                arch,
                Interpolate {
                    table,
                    rows,
                    channel,
                    corners,
                    target,
                    add,
                    derivative,
                },
            );
            add = true;
        }
    }
}

struct Interpolate<'a, R, const N: usize> {
    table: &'a [R],
    rows: Rows,
    channel: usize,
    corners: [Corner<'a, R>; N],
    target: &'a mut [R],
    add: bool,
    /// Of weight and row.
    derivative: Derivative,
}

impl<R: Real, const N: usize> Interpolate<'_, R, N> {
    /// Whether the weights of a lane ask for the zero rule.
    #[inline(always)]
    fn is_risky(&self, lane: usize) -> bool {
        let mut risky = false;
        for (_, weight) in &self.corners {
            risky |= match self.derivative {
                Derivative::Neither => false,
                Derivative::First => weight[lane].is_zero(),
                Derivative::Second => !weight[lane].is_finite(),
            };
        }
        risky
    }

    /// One lane by the zero rule.
    #[inline(always)]
    fn one_by_one<F: Fma>(&mut self, lane: usize) {
        let (axis, offset) = (self.rows.axis, self.channel * self.rows.axis);
        let target = &mut self.target[lane * axis..(lane + 1) * axis];
        if !self.add {
            target.fill(R::default());
        }
        for (index, weight) in &self.corners {
            let row = &self.table[index[lane] as usize * self.rows.width() + offset..][..axis];
            for (target, x) in target.iter_mut().zip(row) {
                *target = add_product::<R, F>(weight[lane], *x, *target, self.derivative);
            }
        }
    }
}

impl<R: Real, const N: usize> Kernel for Interpolate<'_, R, N> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let (axis, width) = (self.rows.axis, self.rows.width());
        let offset = self.channel * axis;
        let mut corners = self.corners;
        let lanes = self.target.len() / axis;
        for k in 0..N {
            corners[k] = (&corners[k].0[..lanes], &corners[k].1[..lanes]);
        }
        if axis == 1 {
            for lane in 0..lanes {
                let target = self.target[lane];
                let mut sum = if self.add { target } else { R::default() };
                for (index, weight) in corners {
                    let x = self.table[index[lane] as usize * width + offset];
                    sum = weight[lane].mul_add::<S>(x, sum);
                }
                if self.derivative != Derivative::Neither && !sum.is_finite() {
                    self.one_by_one::<S>(lane);
                } else {
                    self.target[lane] = sum;
                }
            }
            return;
        }
        for lane in 0..lanes {
            if self.derivative != Derivative::Neither && self.is_risky(lane) {
                self.one_by_one::<S>(lane);
                continue;
            }
            let target = &mut self.target[lane * axis..(lane + 1) * axis];
            let mut rows = [(&self.table[..0], R::default()); N];
            for k in 0..N {
                let i = corners[k].0[lane] as usize * width + offset;
                rows[k] = (&self.table[i..i + axis], corners[k].1[lane]);
            }
            let (packs, rest) = R::packs_mut::<S>(target);
            let (n, zero) = (packs.len(), R::splat(simd, R::default()));
            let (row, part) = R::packs::<S>(&self.table[..0]);
            let mut parts = [(row, part, zero); N];
            for k in 0..N {
                let (row, part) = R::packs::<S>(rows[k].0);
                parts[k] = (&row[..n], part, R::splat(simd, rows[k].1));
            }
            for (j, target) in packs.iter_mut().enumerate() {
                let mut sum = if self.add { *target } else { zero };
                for (row, _, weight) in parts {
                    sum = R::fma(simd, weight, row[j], sum);
                }
                *target = sum;
            }
            if !rest.is_empty() {
                let mut sum = if self.add {
                    R::load_part(simd, rest)
                } else {
                    zero
                };
                for (_, part, weight) in parts {
                    sum = R::fma(simd, weight, R::load_part(simd, part), sum);
                }
                R::store_part(simd, rest, sum);
            }
        }
    }
}

/// `table[index_k[lane]] += weight_k[lane] block[lane]`, a derivative: lanes in order, corners in order within a lane.
pub(super) fn scatter_weighted<R: Real>(
    arch: Arch,
    table: &mut [R],
    rows: Rows,
    lanes: usize,
    corners: &[Corner<R>],
    block: &[R],
) {
    for channel in 0..rows.channels {
        let start = channel * rows.pitch;
        let source = &block[start..start + lanes * rows.axis];
        let table = &mut *table;
        dispatch(
            arch,
            ScatterWeighted {
                table,
                rows,
                channel,
                corners,
                source,
            },
        );
    }
}

struct ScatterWeighted<'a, R> {
    table: &'a mut [R],
    rows: Rows,
    channel: usize,
    corners: &'a [Corner<'a, R>],
    source: &'a [R],
}

impl<R: Real> Kernel for ScatterWeighted<'_, R> {
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let (axis, width) = (self.rows.axis, self.rows.width());
        let offset = self.channel * axis;
        for (lane, row) in self.source.chunks_exact(axis).enumerate() {
            let (source, source_rest) = R::packs::<S>(row);
            for (index, weight) in self.corners {
                let (i, weight) = (index[lane] as usize * width + offset, weight[lane]);
                if !weight.is_finite() {
                    for (target, x) in self.table[i..i + axis].iter_mut().zip(row) {
                        *target = add_product::<R, S>(weight, *x, *target, Derivative::Second);
                    }
                    continue;
                }
                let (target, rest) = R::packs_mut::<S>(&mut self.table[i..i + axis]);
                let factor = R::splat(simd, weight);
                for (t, x) in target.iter_mut().zip(source) {
                    *t = R::fma(simd, factor, *x, *t);
                }
                if !rest.is_empty() {
                    let x = R::load_part(simd, source_rest);
                    let sum = R::fma(simd, factor, x, R::load_part(simd, rest));
                    R::store_part(simd, rest, sum);
                }
            }
        }
    }
}

/// `target[lane] (+)= <table[index[lane]], block[lane]>`: the adjoint of a weight.
pub(super) fn pull_weight<R: Real>(
    table: &[R],
    rows: Rows,
    index: &[u32],
    block: &[R],
    target: &mut [R],
    add: bool,
) {
    for (lane, (&i, target)) in index.iter().zip(target).enumerate() {
        let start = i as usize * rows.width();
        let row = &table[start..start + rows.channels * rows.axis];
        let mut sum = R::default();
        for (c, row) in row.chunks_exact(rows.axis).enumerate() {
            let start = c * rows.pitch + lane * rows.axis;
            for (x, g) in row.iter().zip(&block[start..start + rows.axis]) {
                if !g.is_zero() {
                    sum = sum + *x * *g;
                }
            }
        }
        *target = if add { *target + sum } else { sum };
    }
}
