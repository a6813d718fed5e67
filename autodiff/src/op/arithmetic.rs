//! Arithmetic: sums, products, quotients and whole powers.

use super::{Primitive, RESULT};
use crate::real::{Fma, Real};

/// `a + b`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Add;

impl Primitive<2> for Add {
    fn reads(self, i: usize) -> u8 {
        [0, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a + b
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_, _]: [R; 2], _: R) -> R {
        match I {
            0 => R::from_f64(1.0),
            _ => R::from_f64(1.0),
        }
    }
}

/// `a - b`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sub;

impl Primitive<2> for Sub {
    fn reads(self, i: usize) -> u8 {
        [0, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a - b
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_, _]: [R; 2], _: R) -> R {
        match I {
            0 => R::from_f64(1.0),
            _ => R::from_f64(-1.0),
        }
    }
}

/// `a * b`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mul;

impl Primitive<2> for Mul {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b01][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a * b
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], _: R) -> R {
        match I {
            0 => b,
            _ => a,
        }
    }
}

/// `a / b`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Div;

impl Primitive<2> for Div {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b10 | RESULT][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a / b
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_, b]: [R; 2], y: R) -> R {
        match I {
            // One quotient serves both where they are computed together.
            0 => R::from_f64(1.0) / b,
            _ => -y * (R::from_f64(1.0) / b),
        }
    }
}

/// `a * b + c`
#[derive(Clone, Copy, Debug)]
pub(crate) struct MulAdd;

impl Primitive<3> for MulAdd {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b01, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b, c]: [R; 3]) -> R {
        a.mul_add::<F>(b, c)
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b, _]: [R; 3], _: R) -> R {
        match I {
            0 => b,
            1 => a,
            _ => R::from_f64(1.0),
        }
    }
}

/// `c - a * b`
#[derive(Clone, Copy, Debug)]
pub(crate) struct NegMulAdd;

impl Primitive<3> for NegMulAdd {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b01, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b, c]: [R; 3]) -> R {
        (-a).mul_add::<F>(b, c)
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b, _]: [R; 3], _: R) -> R {
        match I {
            0 => -b,
            1 => -a,
            _ => R::from_f64(1.0),
        }
    }
}

/// `a * b - c`
#[derive(Clone, Copy, Debug)]
pub(crate) struct MulSub;

impl Primitive<3> for MulSub {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b01, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b, c]: [R; 3]) -> R {
        a.mul_add::<F>(b, -c)
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b, _]: [R; 3], _: R) -> R {
        match I {
            0 => b,
            1 => a,
            _ => R::from_f64(-1.0),
        }
    }
}

/// `a * b + offset` with a constant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Product {
    pub offset: f64,
}

impl Primitive<2> for Product {
    fn reads(self, i: usize) -> u8 {
        [0b10, 0b01][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        a.mul_add::<F>(b, R::from_f64(self.offset))
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], _: R) -> R {
        match I {
            0 => b,
            _ => a,
        }
    }
}

/// `-a`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Neg;

impl Primitive<1> for Neg {
    fn reads(self, _: usize) -> u8 {
        0
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        -a
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_]: [R; 1], _: R) -> R {
        R::from_f64(-1.0)
    }
}

/// `scale * a + offset` with constants.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Affine {
    pub scale: f64,
    pub offset: f64,
}

impl Primitive<1> for Affine {
    fn reads(self, _: usize) -> u8 {
        0
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.mul_add::<F>(R::from_f64(self.scale), R::from_f64(self.offset))
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_]: [R; 1], _: R) -> R {
        R::from_f64(self.scale)
    }
}

/// `1 / a`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Recip;

impl Primitive<1> for Recip {
    fn reads(self, _: usize) -> u8 {
        RESULT
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        R::from_f64(1.0) / a
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_]: [R; 1], y: R) -> R {
        -y * y
    }
}

/// `a^2`
#[derive(Clone, Copy, Debug)]
pub(crate) struct Square;

impl Primitive<1> for Square {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a * a
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        a + a
    }
}

/// `a^5`, as in the Schlick approximation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fifth;

impl Primitive<1> for Fifth {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        {
            let square = a * a;
            square * square * a
        }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        {
            let square = a * a;
            R::from_f64(5.0) * square * square
        }
    }
}
