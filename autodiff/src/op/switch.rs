//! Piecewise functions: extremes, selection, comparisons. Kinks take the one-sided derivative stated at each.

use super::Primitive;
use crate::real::{Fma, Real};

/// Absolute value. Its derivative at 0 is 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Abs;

impl Primitive<1> for Abs {
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        a.abs()
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        {
            let zero = R::default();
            if a > zero {
                R::from_f64(1.0)
            } else if a < zero {
                R::from_f64(-1.0)
            } else {
                zero
            }
        }
    }
}

/// The smaller operand. A tie differentiates the first; a NaN first operand is returned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Min;

impl Primitive<2> for Min {
    const CHOOSES: bool = true;
    fn reads(self, i: usize) -> u8 {
        [0b11, 0b11][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        if b < a { b } else { a }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], _: R) -> R {
        match I {
            0 => {
                if b < a {
                    R::default()
                } else {
                    R::from_f64(1.0)
                }
            }
            _ => {
                if b < a {
                    R::from_f64(1.0)
                } else {
                    R::default()
                }
            }
        }
    }
}

/// The larger operand. A tie differentiates the first; a NaN first operand is returned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Max;

impl Primitive<2> for Max {
    const CHOOSES: bool = true;
    fn reads(self, i: usize) -> u8 {
        [0b11, 0b11][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        if b > a { b } else { a }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a, b]: [R; 2], _: R) -> R {
        match I {
            0 => {
                if b > a {
                    R::default()
                } else {
                    R::from_f64(1.0)
                }
            }
            _ => {
                if b > a {
                    R::from_f64(1.0)
                } else {
                    R::default()
                }
            }
        }
    }
}

/// `max(a, 0)`. Its derivative at 0 is 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Relu;

impl Primitive<1> for Relu {
    const CHOOSES: bool = true;
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        if a < R::default() { R::default() } else { a }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        if a > R::default() {
            R::from_f64(1.0)
        } else {
            R::default()
        }
    }
}

/// `a` held within constants. Its derivative is 1 on the closed interval and 0 outside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clamp {
    pub low: f64,
    pub high: f64,
}

impl Primitive<1> for Clamp {
    const CHOOSES: bool = true;
    fn reads(self, _: usize) -> u8 {
        0b1
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a]: [R; 1]) -> R {
        {
            let (low, high) = (R::from_f64(self.low), R::from_f64(self.high));
            let raised = if a < low { low } else { a };
            if raised > high { high } else { raised }
        }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [a]: [R; 1], _: R) -> R {
        if a < R::from_f64(self.low) || a > R::from_f64(self.high) {
            R::default()
        } else {
            R::from_f64(1.0)
        }
    }
}

/// `a` where the mask is set, `b` elsewhere.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Select;

impl Primitive<3> for Select {
    const CHOOSES: bool = true;
    fn reads(self, i: usize) -> u8 {
        [0, 0b1, 0b1][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [mask, a, b]: [R; 3]) -> R {
        if mask == R::default() { b } else { a }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [mask, _, _]: [R; 3], _: R) -> R {
        match I {
            0 => R::default(),
            1 => {
                if mask == R::default() {
                    R::default()
                } else {
                    R::from_f64(1.0)
                }
            }
            _ => {
                if mask == R::default() {
                    R::from_f64(1.0)
                } else {
                    R::default()
                }
            }
        }
    }
}

/// The mask of `a < b`; not differentiable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Less;

impl Primitive<2> for Less {
    const CHOOSES: bool = true;
    fn reads(self, i: usize) -> u8 {
        [0, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        if a < b {
            R::from_f64(1.0)
        } else {
            R::default()
        }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_, _]: [R; 2], _: R) -> R {
        match I {
            0 => R::default(),
            _ => R::default(),
        }
    }
}

/// The mask of `a <= b`; not differentiable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LessEqual;

impl Primitive<2> for LessEqual {
    const CHOOSES: bool = true;
    fn reads(self, i: usize) -> u8 {
        [0, 0][i]
    }
    #[inline(always)]
    fn eval<R: Real, F: Fma>(self, [a, b]: [R; 2]) -> R {
        if a <= b {
            R::from_f64(1.0)
        } else {
            R::default()
        }
    }
    #[inline(always)]
    fn partial<R: Real, F: Fma, const I: usize>(self, [_, _]: [R; 2], _: R) -> R {
        match I {
            0 => R::default(),
            _ => R::default(),
        }
    }
}
