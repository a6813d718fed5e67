//! The loops over lanes that every elementwise primitive shares.

use pulp::{Arch, Simd, WithSimd};

use super::Primitive;
use crate::real::{Fma, Fused, Real, Unfused};

/// A loop to be compiled for every instruction set; the best one present is chosen when it runs.
pub(crate) trait Kernel {
    /// The loop; must be `#[inline(always)]`, as must all that it calls.
    fn run<F: Fma>(self);
}

struct Dispatch<K>(K);

impl<K: Kernel> WithSimd for Dispatch<K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        if S::IS_SCALAR {
            self.0.run::<Unfused>()
        } else {
            self.0.run::<Fused>()
        }
    }
}

/// Runs a kernel with the instruction set `arch`.
#[inline(always)]
pub(crate) fn dispatch(arch: Arch, kernel: impl Kernel) {
    arch.dispatch(Dispatch(kernel))
}

/// `y = f(x)`.
pub(super) fn evaluate<R: Real, P: Primitive<N>, const N: usize>(
    arch: Arch,
    primitive: P,
    x: [&[R]; N],
    y: &mut [R],
) {
    dispatch(arch, Evaluate { primitive, x, y })
}

struct Evaluate<'a, R, P, const N: usize> {
    primitive: P,
    x: [&'a [R]; N],
    y: &'a mut [R],
}

impl<R: Real, P: Primitive<N>, const N: usize> Kernel for Evaluate<'_, R, P, N> {
    #[inline(always)]
    fn run<F: Fma>(self) {
        let n = self.y.len();
        let x: [&[R]; N] = std::array::from_fn(|j| &self.x[j][..n]);
        for i in 0..n {
            let operands = std::array::from_fn(|j| x[j][i]);
            self.y[i] = self.primitive.eval::<R, F>(operands);
        }
    }
}

/// `target (+)= (df/dx_i) source`.
pub(super) fn pass<R: Real, P: Primitive<N>, const N: usize>(
    arch: Arch,
    primitive: P,
    i: usize,
    x: [&[R]; N],
    y: &[R],
    source: &[R],
    target: &mut [R],
    add: bool,
) {
    match i {
        0 => dispatch(
            arch,
            Pass::<R, P, N, 0> {
                primitive,
                x,
                y,
                source,
                target,
                add,
            },
        ),
        1 if N > 1 => dispatch(
            arch,
            Pass::<R, P, N, 1> {
                primitive,
                x,
                y,
                source,
                target,
                add,
            },
        ),
        _ if N > 2 => dispatch(
            arch,
            Pass::<R, P, N, 2> {
                primitive,
                x,
                y,
                source,
                target,
                add,
            },
        ),
        _ => {}
    }
}

struct Pass<'a, R, P, const N: usize, const I: usize> {
    primitive: P,
    x: [&'a [R]; N],
    y: &'a [R],
    source: &'a [R],
    target: &'a mut [R],
    add: bool,
}

impl<R: Real, P: Primitive<N>, const N: usize, const I: usize> Kernel for Pass<'_, R, P, N, I> {
    #[inline(always)]
    fn run<F: Fma>(self) {
        let n = self.target.len();
        let x: [&[R]; N] = std::array::from_fn(|j| &self.x[j][..n]);
        let (y, source) = (&self.y[..n], &self.source[..n]);
        let term = |i: usize| {
            let operands = std::array::from_fn(|j| x[j][i]);
            let product = source[i] * self.primitive.partial::<R, F, I>(operands, y[i]);
            // The branch of a selection that was not taken may hold an infinite partial: 0 * infinity must not spread.
            if source[i].is_zero() {
                R::default()
            } else {
                product
            }
        };
        if self.add {
            for i in 0..n {
                self.target[i] = self.target[i] + term(i);
            }
        } else {
            for i in 0..n {
                self.target[i] = term(i);
            }
        }
    }
}
