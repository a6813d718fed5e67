//! Gathers from whole tables and their adjoint, scatter-add into a chunk's private table.

use pulp::{Arch, Simd};

use crate::op::kernel::{Kernel, dispatch};
use crate::real::Real;

/// `target[lane] = table[index[lane]]` for one channel.
pub(super) fn gather<R: Real>(table: &[R], axis: usize, index: &[u32], target: &mut [R]) {
    if axis == 1 {
        for (t, &i) in target.iter_mut().zip(index) {
            *t = table[i as usize];
        }
    } else {
        for (t, &i) in target.chunks_exact_mut(axis).zip(index) {
            let i = i as usize * axis;
            t.copy_from_slice(&table[i..i + axis]);
        }
    }
}

/// `table[index[lane]] += source[lane]` for one channel, lanes in order. A source of exactly zero is left out.
pub(super) fn scatter<R: Real>(
    arch: Arch,
    table: &mut [R],
    axis: usize,
    index: &[u32],
    source: &[R],
) {
    if axis == 1 {
        for (s, &i) in source.iter().zip(index) {
            let t = &mut table[i as usize];
            *t = *t + *s;
        }
    } else {
        for (s, &i) in source.chunks_exact(axis).zip(index) {
            let i = i as usize * axis;
            super::rows::put(arch, &mut table[i..i + axis], s, true);
        }
    }
}

/// Corners looked up together by one call; more corners take several.
const CORNERS: usize = 4;

/// `target[lane] (+)= sum_k weight_k[lane] table[index_k[lane]]` for one channel.
pub(super) fn gather_weighted<R: Real>(
    arch: Arch,
    table: &[R],
    axis: usize,
    corners: &[(&[u32], &[R])],
    target: &mut [R],
    mut add: bool,
) {
    let mut groups = corners.chunks_exact(CORNERS);
    for group in groups.by_ref() {
        let corners: [_; CORNERS] = std::array::from_fn(|k| group[k]);
        dispatch(
            arch,
            Interpolate {
                table,
                axis,
                corners,
                target: &mut *target,
                add,
            },
        );
        add = true;
    }
    for &corner in groups.remainder() {
        dispatch(
            arch,
            Interpolate {
                table,
                axis,
                corners: [corner],
                target: &mut *target,
                add,
            },
        );
        add = true;
    }
}

struct Interpolate<'a, R, const N: usize> {
    table: &'a [R],
    axis: usize,
    corners: [(&'a [u32], &'a [R]); N],
    target: &'a mut [R],
    add: bool,
}

impl<R: Real, const N: usize> Kernel for Interpolate<'_, R, N> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let axis = self.axis;
        for (lane, target) in self.target.chunks_exact_mut(axis).enumerate() {
            let mut rows = [(&self.table[..0], R::default()); N];
            for k in 0..N {
                let i = self.corners[k].0[lane] as usize * axis;
                rows[k] = (&self.table[i..i + axis], self.corners[k].1[lane]);
            }
            let (packs, rest) = R::packs_mut::<S>(target);
            let first = axis - rest.len();
            for (j, target) in packs.iter_mut().enumerate() {
                let mut sum = if self.add {
                    *target
                } else {
                    R::splat(simd, R::default())
                };
                for (row, weight) in rows {
                    let row = R::packs::<S>(row).0;
                    sum = R::fma(simd, R::splat(simd, weight), row[j], sum);
                }
                *target = sum;
            }
            for (j, target) in rest.iter_mut().enumerate() {
                let mut sum = if self.add { *target } else { R::default() };
                for (row, weight) in rows {
                    sum = weight.mul_add::<S>(row[first + j], sum);
                }
                *target = sum;
            }
        }
    }
}

/// `table[index_k[lane]] += weight_k[lane] source[lane]` for one channel: lanes in order, corners in order within a lane.
pub(super) fn scatter_weighted<R: Real>(
    arch: Arch,
    table: &mut [R],
    axis: usize,
    corners: &[(&[u32], &[R])],
    source: &[R],
) {
    dispatch(
        arch,
        ScatterWeighted {
            table,
            axis,
            corners,
            source,
        },
    );
}

struct ScatterWeighted<'a, R> {
    table: &'a mut [R],
    axis: usize,
    corners: &'a [(&'a [u32], &'a [R])],
    source: &'a [R],
}

impl<R: Real> Kernel for ScatterWeighted<'_, R> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let axis = self.axis;
        for (lane, row) in self.source.chunks_exact(axis).enumerate() {
            let (source, source_rest) = R::packs::<S>(row);
            for (index, weight) in self.corners {
                let (i, weight) = (index[lane] as usize * axis, weight[lane]);
                let (target, rest) = R::packs_mut::<S>(&mut self.table[i..i + axis]);
                let factor = R::splat(simd, weight);
                for (t, x) in target.iter_mut().zip(source) {
                    *t = R::fma(simd, factor, *x, *t);
                }
                for (t, x) in rest.iter_mut().zip(source_rest) {
                    *t = weight.mul_add::<S>(*x, *t);
                }
            }
        }
    }
}

/// `target[lane] += <table[index[lane]], source[lane]>` for one channel: the adjoint of a weight.
pub(super) fn pull_weight<R: Real>(
    table: &[R],
    axis: usize,
    index: &[u32],
    source: &[R],
    target: &mut [R],
) {
    for (lane, row) in source.chunks_exact(axis).enumerate() {
        let i = index[lane] as usize * axis;
        for (x, s) in table[i..i + axis].iter().zip(row) {
            let product = if s.is_zero() { *s } else { *x * *s };
            target[lane] = target[lane] + product;
        }
    }
}
