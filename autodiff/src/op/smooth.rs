//! Smooth functions: roots, exponentials, trigonometry.

use super::{Primitive, RESULT};
use crate::real::{Fma, Real};

/// Square root. Its derivative at 0 is infinite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sqrt;

impl Primitive<1> for Sqrt {
    fn reads(self, _: usize) -> u8 {
        RESULT
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.sqrt()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_]: [R; 1], y: R) -> R {
        R::from_f64(0.5) / y
    }
}

/// `1 / sqrt(a)`. Infinite at 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rsqrt;

impl Primitive<1> for Rsqrt {
    fn reads(self, _: usize) -> u8 {
        0b1 | RESULT
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        R::from_f64(1.0) / a.sqrt()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], y: R) -> R {
        R::from_f64(-0.5) * y / a
    }
}

/// `e^a`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exp;

impl Primitive<1> for Exp {
    fn reads(self, _: usize) -> u8 {
        RESULT
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.exp::<F>()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_]: [R; 1], y: R) -> R {
        y
    }
}

/// Natural logarithm. Minus infinity at 0, NaN below.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ln;

impl Primitive<1> for Ln {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.ln::<F>()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        R::from_f64(1.0) / a
    }
}

/// Sine of radians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sin;

impl Primitive<1> for Sin {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.sin::<F>()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        a.cos::<F>()
    }
}

/// Cosine of radians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cos;

impl Primitive<1> for Cos {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.cos::<F>()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        -a.sin::<F>()
    }
}

/// Arc cosine. Its derivative at -1 and 1 is infinite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Acos;

impl Primitive<1> for Acos {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        {
            let sine = ((R::from_f64(1.0) - a) * (R::from_f64(1.0) + a)).sqrt();
            sine.atan2(a)
        }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        R::from_f64(-1.0) / ((R::from_f64(1.0) - a) * (R::from_f64(1.0) + a)).sqrt()
    }
}

/// Arc tangent of `a / b` in the right quadrant. Its derivative at (0, 0) is NaN.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Atan2;

impl Primitive<2> for Atan2 {
    fn reads(self, i: usize) -> u8 {
        [0b11, 0b11][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a.atan2(b)
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], _: R) -> R {
        match I {
            0 => b / (a * a + b * b),
            _ => -a / (a * a + b * b),
        }
    }
}

/// `a^b` for `a >= 0`, as `exp(b ln a)`; NaN for negative `a`. `a^0` is 1, for any `a`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pow;

impl Primitive<2> for Pow {
    fn reads(self, i: usize) -> u8 {
        [0b11, 0b11 | RESULT][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        let power = (b * a.ln::<F>()).exp::<F>();
        // For positive `a`, an exponent of 0 that moves has its derivative.
        let positive = a > R::default();
        let fixed = b.is_zero() || (b == R::default() && !positive);
        if fixed { R::from_f64(1.0) } else { power }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], y: R) -> R {
        if I == 0 {
            let lower = b - R::from_f64(1.0);
            let positive = a > R::default();
            if b.is_zero() || (b == R::default() && !positive) {
                R::default()
            } else {
                b * self.eval::<R, F>([a, lower])
            }
        } else if a == R::default() {
            // For positive b, x^b tends to 0 faster than ln x to minus infinity.
            R::default()
        } else {
            y * a.ln::<F>()
        }
    }
}

/// The logistic function `1 / (1 + e^-a)`. Its derivative is the product of both tails, which keeps its relative
/// precision where the value rounds to 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sigmoid;

impl Primitive<1> for Sigmoid {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        let one = R::from_f64(1.0);
        one / (one + (-a).exp::<F>())
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        let one = R::from_f64(1.0);
        let tail = (-a.abs()).exp::<F>();
        let sum = one + tail;
        tail / (sum * sum)
    }
}

/// `ln(1 + e^a)`, without overflow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Softplus;

impl Primitive<1> for Softplus {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        let zero = R::default();
        let ramp = if a > zero { a } else { zero };
        // NaN fails the comparison, but survives in the tail.
        ramp + (R::from_f64(1.0) + (-a.abs()).exp::<F>()).ln::<F>()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        Sigmoid.eval::<R, F>([a])
    }
}
