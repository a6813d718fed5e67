//! Dual numbers: a value and its derivative in one direction.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::real::{Fma, Real};

/// A value and its derivative along one direction, `value + derivative * epsilon` with `epsilon^2 = 0`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Dual<S> {
    /// The value.
    pub value: S,
    /// Its derivative.
    pub derivative: S,
}

impl<S> Dual<S> {
    #[inline(always)]
    /// A value with its derivative.
    pub fn new(value: S, derivative: S) -> Self {
        Dual { value, derivative }
    }
}

impl<S: PartialEq> PartialEq for Dual<S> {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<S: PartialOrd> PartialOrd for Dual<S> {
    #[inline(always)]
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        self.value.partial_cmp(&other.value)
    }
}

impl<S: Real> Add for Dual<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Dual::new(self.value + b.value, self.derivative + b.derivative)
    }
}

impl<S: Real> Sub for Dual<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Dual::new(self.value - b.value, self.derivative - b.derivative)
    }
}

impl<S: Real> Mul for Dual<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Dual::new(
            self.value * b.value,
            self.derivative * b.value + self.value * b.derivative,
        )
    }
}

impl<S: Real> Div for Dual<S> {
    type Output = Self;
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        let quotient = self.value / b.value;
        Dual::new(
            quotient,
            (self.derivative - quotient * b.derivative) / b.value,
        )
    }
}

impl<S: Real> Neg for Dual<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Dual::new(-self.value, -self.derivative)
    }
}

/// A derivative of exactly zero stays zero, however singular the factor.
#[inline(always)]
fn scale<S: Real>(derivative: S, factor: S) -> S {
    if derivative.is_zero() {
        derivative
    } else {
        derivative * factor
    }
}

impl<S: Real> Real for Dual<S> {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        Dual::new(S::from_f64(value), S::default())
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self.value.to_f64()
    }
    #[inline(always)]
    fn mul_add<F: Fma>(self, b: Self, c: Self) -> Self {
        self * b + c
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        Dual::new(root, scale(self.derivative, S::from_f64(0.5) / root))
    }
    #[inline(always)]
    fn exp<F: Fma>(self) -> Self {
        let power = self.value.exp::<F>();
        Dual::new(power, scale(self.derivative, power))
    }
    #[inline(always)]
    fn ln<F: Fma>(self) -> Self {
        let slope = S::from_f64(1.0) / self.value;
        Dual::new(self.value.ln::<F>(), scale(self.derivative, slope))
    }
    #[inline(always)]
    fn sin<F: Fma>(self) -> Self {
        let slope = self.value.cos::<F>();
        Dual::new(self.value.sin::<F>(), scale(self.derivative, slope))
    }
    #[inline(always)]
    fn cos<F: Fma>(self) -> Self {
        let slope = -self.value.sin::<F>();
        Dual::new(self.value.cos::<F>(), scale(self.derivative, slope))
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        let slope = self.derivative * x.value - self.value * x.derivative;
        let angle = self.value.atan2(x.value);
        Dual::new(angle, scale(slope, S::from_f64(1.0) / square))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        if self.value < S::default() {
            -self
        } else {
            self
        }
    }
    #[inline(always)]
    fn is_zero(self) -> bool {
        self.value.is_zero() && self.derivative.is_zero()
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        self.value.is_finite() && self.derivative.is_finite()
    }
}
