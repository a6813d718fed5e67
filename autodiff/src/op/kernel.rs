//! The loops over lanes that every elementwise primitive shares.

use pulp::{Arch, Scalar, Simd, WithSimd};

use super::Primitive;
use crate::real::{Fma, Real};

/// A loop to be compiled for every instruction set; the best one present is chosen when it runs.
///
/// The compiler vectorises plain loops over slices; it needs the slices as arguments of the function that holds the loop, to
/// know that they do not overlap.
pub(crate) trait Kernel {
    /// Whether vector instructions are worth compiling for.
    const PACKED: bool;
    /// The loop; must be `#[inline(always)]`, as must all that it calls.
    fn run<S: Simd>(self, simd: S);
}

struct Dispatch<K>(K);

impl<K: Kernel> WithSimd for Dispatch<K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.run(simd)
    }
}

/// Runs a kernel with the instruction set `arch`.
#[inline(always)]
pub(crate) fn dispatch<K: Kernel>(arch: Arch, kernel: K) {
    if K::PACKED {
        arch.dispatch(Dispatch(kernel))
    } else {
        kernel.run(Scalar)
    }
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
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let [x0, x1, x2] = three(self.x);
        evaluate_loop::<R, S, P, N>(self.primitive, x0, x1, x2, self.y);
    }
}

#[inline(always)]
fn evaluate_loop<R: Real, F: Fma, P: Primitive<N>, const N: usize>(
    primitive: P,
    x0: &[R],
    x1: &[R],
    x2: &[R],
    y: &mut [R],
) {
    let n = y.len();
    let (x0, x1, x2) = (&x0[..n], &x1[..n], &x2[..n]);
    for i in 0..n {
        y[i] = primitive.eval::<R, F>(operands(x0[i], x1[i], x2[i]));
    }
}

/// Operands as three slices; absent ones repeat the first.
#[inline(always)]
fn three<R, const N: usize>(x: [&[R]; N]) -> [&[R]; 3] {
    [
        x[0],
        x[if N > 1 { 1 } else { 0 }],
        x[if N > 2 { 2 } else { 0 }],
    ]
}

/// The first `N` of three operands.
#[inline(always)]
pub(super) fn operands<R: Real, const N: usize>(x0: R, x1: R, x2: R) -> [R; N] {
    let mut x = [x0; N];
    if N > 1 {
        x[1] = x1;
    }
    if N > 2 {
        x[2] = x2;
    }
    x
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
    let pass = Pass {
        primitive,
        x,
        y,
        source,
        target,
        add,
    };
    match i {
        0 => dispatch(arch, Operand::<_, 0>(pass)),
        1 if N > 1 => dispatch(arch, Operand::<_, 1>(pass)),
        _ if N > 2 => dispatch(arch, Operand::<_, 2>(pass)),
        _ => {}
    }
}

struct Pass<'a, R, P, const N: usize> {
    primitive: P,
    x: [&'a [R]; N],
    y: &'a [R],
    source: &'a [R],
    target: &'a mut [R],
    add: bool,
}

struct Operand<T, const I: usize>(T);

impl<R: Real, P: Primitive<N>, const N: usize, const I: usize> Kernel
    for Operand<Pass<'_, R, P, N>, I>
{
    const PACKED: bool = R::PACKED;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let pass = self.0;
        let [x0, x1, x2] = three(pass.x);
        pass_loop::<R, S, P, N, I>(
            pass.primitive,
            x0,
            x1,
            x2,
            pass.y,
            pass.source,
            pass.target,
            pass.add,
        );
    }
}

#[inline(always)]
fn pass_loop<R: Real, F: Fma, P: Primitive<N>, const N: usize, const I: usize>(
    primitive: P,
    x0: &[R],
    x1: &[R],
    x2: &[R],
    y: &[R],
    source: &[R],
    target: &mut [R],
    add: bool,
) {
    let n = target.len();
    let (x0, x1, x2) = (&x0[..n], &x1[..n], &x2[..n]);
    let (y, source) = (&y[..n], &source[..n]);
    if add {
        for i in 0..n {
            let x = operands(x0[i], x1[i], x2[i]);
            target[i] = target[i] + term::<R, F, P, N, I>(primitive, x, y[i], source[i]);
        }
    } else {
        for i in 0..n {
            let x = operands(x0[i], x1[i], x2[i]);
            target[i] = term::<R, F, P, N, I>(primitive, x, y[i], source[i]);
        }
    }
}

/// One contribution to a derivative. A function and not a closure: a closure that is called in two places is not inlined, and
/// then compiled without the instruction set of its loop.
#[inline(always)]
pub(super) fn term<R: Real, F: Fma, P: Primitive<N>, const N: usize, const I: usize>(
    primitive: P,
    x: [R; N],
    y: R,
    source: R,
) -> R {
    if P::CHOOSES {
        let chosen = !primitive.partial::<R, F, I>(x, y).is_zero();
        return if chosen { source } else { R::default() };
    }
    // The branch of a selection that was not taken may hold an infinite partial: 0 * infinity must not spread.
    if source.is_zero() {
        R::default()
    } else {
        source * primitive.partial::<R, F, I>(x, y)
    }
}
