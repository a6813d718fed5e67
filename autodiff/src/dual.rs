//! Dual numbers: a value and its derivative in one direction.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::linear_map::LinearMap;
use crate::real::{Fma, Real};

/// A value and its derivative along one direction, `value + derivative * epsilon` with `epsilon^2 = 0`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Dual<S> {
    /// The value.
    pub value: S,
    /// Its derivative.
    pub derivative: S,
}

/// What a Hessian-vector product needs to know of the dual number over `S`.
pub trait DualNumber<S>: Real {
    /// Joins a value and its derivative.
    fn join(value: S, derivative: S) -> Self;
    /// The derivative part.
    fn derivative(self) -> S;
    /// The value part.
    fn value(self) -> S;
}

impl<S> Dual<S> {
    #[inline(always)]
    fn new(value: S, derivative: S) -> Self {
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

macro_rules! dual {
    ($t:ident) => {
        impl DualNumber<$t> for Dual<$t> {
            #[inline(always)]
            fn join(value: $t, derivative: $t) -> Self {
                Dual::new(value, derivative)
            }
            #[inline(always)]
            fn derivative(self) -> $t {
                self.derivative
            }
            #[inline(always)]
            fn value(self) -> $t {
                self.value
            }
        }

        impl Real for Dual<$t> {
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                Dual::new(value as $t, 0.0)
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self.value as f64
            }
            #[inline(always)]
            fn mul_add<F: Fma>(self, b: Self, c: Self) -> Self {
                self * b + c
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                let root = self.value.sqrt();
                Dual::new(root, scale(self.derivative, 0.5 / root))
            }
            #[inline(always)]
            fn exp<F: Fma>(self) -> Self {
                let power = Real::exp::<F>(self.value);
                Dual::new(power, scale(self.derivative, power))
            }
            #[inline(always)]
            fn ln<F: Fma>(self) -> Self {
                Dual::new(
                    Real::ln::<F>(self.value),
                    scale(self.derivative, 1.0 / self.value),
                )
            }
            #[inline(always)]
            fn sin<F: Fma>(self) -> Self {
                Dual::new(
                    Real::sin::<F>(self.value),
                    scale(self.derivative, Real::cos::<F>(self.value)),
                )
            }
            #[inline(always)]
            fn cos<F: Fma>(self) -> Self {
                Dual::new(
                    Real::cos::<F>(self.value),
                    scale(self.derivative, -Real::sin::<F>(self.value)),
                )
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                let square = self.value * self.value + x.value * x.value;
                let slope = self.derivative * x.value - self.value * x.derivative;
                Dual::new(self.value.atan2(x.value), scale(slope, 1.0 / square))
            }
            #[inline(always)]
            fn abs(self) -> Self {
                if self.value < 0.0 { -self } else { self }
            }
            #[inline(always)]
            fn is_zero(self) -> bool {
                self.value == 0.0 && self.derivative == 0.0
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                self.value.is_finite() && self.derivative.is_finite()
            }
            fn apply_map(
                map: &dyn LinearMap,
                transpose: bool,
                columns: usize,
                input: &[Self],
                output: &mut [Self],
            ) {
                // The operator is linear: value and derivative go through it side by side.
                let values: Vec<$t> = input.iter().map(|x| x.value).collect();
                let derivatives: Vec<$t> = input.iter().map(|x| x.derivative).collect();
                let mut value = vec![0.0; output.len()];
                let mut derivative = vec![0.0; output.len()];
                <$t>::apply_map(map, transpose, columns, &values, &mut value);
                <$t>::apply_map(map, transpose, columns, &derivatives, &mut derivative);
                for (i, out) in output.iter_mut().enumerate() {
                    *out = Dual::new(value[i], derivative[i]);
                }
            }
        }
    };
}
dual!(f32);
dual!(f64);
