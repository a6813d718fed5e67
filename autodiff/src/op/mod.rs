//! The elementwise primitives: each is written once, value and partial derivatives together, generic over [`Real`].
//!
//! One kernel evaluates `y = f(x0, x1, ..)`, another adds `(df/dxi) * source` to a destination. The second serves both
//! directions of differentiation: a tangent is pushed with it from operand to result, an adjoint pulled from result to operand.

mod arithmetic;
mod element;
pub(crate) mod kernel;
mod smooth;
mod switch;
pub(crate) mod tile;

pub(crate) use element::Element;

use crate::real::{Fma, Real};

/// The bit of [`Primitive::reads`] that stands for the result.
pub(crate) const RESULT: u8 = 0x80;

/// An elementwise function of `N` operands.
pub(crate) trait Primitive<const N: usize>: Copy {
    /// Whether partial derivatives are 0 or 1: the function is one of its operands, or a constant. An operand that was not
    /// chosen passes nothing on, not even a NaN.
    const CHOOSES: bool = false;
    /// What the partial derivative with respect to operand `i` reads: bit `j` for operand `j`, [`RESULT`] for the result.
    /// Reverse mode recomputes only what is read.
    fn reads(self, i: usize) -> u8;
    /// The value.
    fn eval<R: Real, F: Fma>(self, x: [R; N]) -> R;
    /// The partial derivative with respect to operand `I`, given the operands and the result `y`.
    fn partial<R: Real, F: Fma, const I: usize>(self, x: [R; N], y: R) -> R;
}
