//! The scalar types a program runs over.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};
use std::sync::Arc;

use pulp::Simd;

use crate::dual::Dual;
use crate::math;
use crate::packed::Packed;

/// A scalar that every primitive can be evaluated on: `f32`, `f64`, and the dual numbers over them.
///
/// Each primitive is written once against this trait, so that running it on dual numbers differentiates it.
/// Comparisons (`<`, `==`) look at the value only; [`Real::is_zero`] looks at the whole number.
pub trait Real:
    Packed
    + Send
    + Sync
    + 'static
    + Debug
    + Default
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The nearest representable value.
    fn from_f64(value: f64) -> Self;
    /// The value, without its derivative part.
    fn to_f64(self) -> f64;
    /// `self * b + c`, contracted to one rounding when `F` says that the hardware does so.
    fn mul_add<F: Fma>(self, b: Self, c: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// e to the power of `self`.
    fn exp<F: Fma>(self) -> Self;
    /// Natural logarithm.
    fn ln<F: Fma>(self) -> Self;
    /// Sine of an angle in radians.
    fn sin<F: Fma>(self) -> Self;
    /// Cosine of an angle in radians.
    fn cos<F: Fma>(self) -> Self;
    /// Arc tangent of `self / x` in the right quadrant.
    fn atan2(self, x: Self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Whether value and derivative are both exactly zero.
    fn is_zero(self) -> bool;
    /// Whether value and derivative are both finite.
    fn is_finite(self) -> bool;
}

/// A scalar that users bind: `f32` or `f64`.
pub trait Scalar: Real + crate::run::Engine {
    /// The dual number over this scalar, for Hessian-vector products.
    #[doc(hidden)]
    type Dual: crate::run::Engine;
    /// Joins a value and its derivative.
    #[doc(hidden)]
    fn join(value: Self, derivative: Self) -> Self::Dual;
    /// Takes a value and its derivative apart.
    #[doc(hidden)]
    fn split(dual: Self::Dual) -> (Self, Self);
    /// An array of single precision, itself if that is this type.
    #[doc(hidden)]
    fn shared(values: &Arc<[f32]>) -> Arc<[Self]>;
}

/// Whether the instructions being compiled contain a fused multiply-add.
pub trait Fma: Copy {
    /// True where `mul_add` is one instruction rather than a library call.
    const FUSED: bool;
}

impl<S: Simd> Fma for S {
    const FUSED: bool = !S::IS_SCALAR;
}

macro_rules! real {
    ($t:ident, $exp:path, $ln:path, $sin:path, $cos:path, $shared:path) => {
        impl Real for $t {
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn mul_add<F: Fma>(self, b: Self, c: Self) -> Self {
                if F::FUSED {
                    <$t>::mul_add(self, b, c)
                } else {
                    self * b + c
                }
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline(always)]
            fn exp<F: Fma>(self) -> Self {
                $exp(self)
            }
            #[inline(always)]
            fn ln<F: Fma>(self) -> Self {
                $ln(self)
            }
            #[inline(always)]
            fn sin<F: Fma>(self) -> Self {
                $sin(self)
            }
            #[inline(always)]
            fn cos<F: Fma>(self) -> Self {
                $cos(self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                <$t>::atan2(self, x)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                <$t>::abs(self)
            }
            #[inline(always)]
            fn is_zero(self) -> bool {
                self == 0.0
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                <$t>::is_finite(self)
            }
        }
        impl Scalar for $t {
            type Dual = Dual<$t>;
            fn join(value: Self, derivative: Self) -> Dual<$t> {
                Dual::new(value, derivative)
            }
            fn split(dual: Dual<$t>) -> (Self, Self) {
                (dual.value, dual.derivative)
            }
            fn shared(values: &Arc<[f32]>) -> Arc<[$t]> {
                $shared(values)
            }
        }
    };
}

real!(
    f32,
    math::exp::<F>,
    math::ln::<F>,
    math::sin::<F>,
    math::cos::<F>,
    Arc::clone
);
real!(f64, f64::exp, f64::ln, f64::sin, f64::cos, widened);

fn widened(values: &Arc<[f32]>) -> Arc<[f64]> {
    values.iter().map(|&value| f64::from(value)).collect()
}
