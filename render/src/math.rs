//! Small geometry shared by everything: a scalar trait, orthonormal frames, unit-interval numbers.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use glam::Vec3;

/// The scalars that the reference formulas are written for: `f32` and `f64`.
pub trait Float:
    Copy
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + 'static
{
    /// Zero.
    const ZERO: Self;
    /// One.
    const ONE: Self;
    /// The nearest value to `x`.
    fn from_f64(x: f64) -> Self;
    /// This value as `f64`.
    fn to_f64(self) -> f64;
    /// The larger of two values.
    fn max(self, other: Self) -> Self;
}

macro_rules! float {
    ($t:ty) => {
        impl Float for $t {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            #[inline(always)]
            fn from_f64(x: f64) -> Self {
                x as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                <$t>::max(self, other)
            }
        }
    };
}
float!(f32);
float!(f64);

/// An orthonormal frame whose z axis is a given unit normal.
///
/// Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017: continuous but for the pole z = −1, and
/// without a branch that would lose precision next to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First tangent.
    pub tangent: Vec3,
    /// Second tangent.
    pub bitangent: Vec3,
    /// The normal: the local z axis.
    pub normal: Vec3,
}

impl Frame {
    /// The frame around the unit vector `normal`.
    pub fn new(normal: Vec3) -> Self {
        let sign = 1.0_f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(
                1.0 + sign * normal.x * normal.x * a,
                sign * b,
                -sign * normal.x,
            ),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// World coordinates of the local vector `v`.
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.tangent * v.x + self.bitangent * v.y + self.normal * v.z
    }

    /// Local coordinates of the world vector `v`.
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(
            v.dot(self.tangent),
            v.dot(self.bitangent),
            v.dot(self.normal),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_right_handed_and_invertible() {
        for normal in [
            Vec3::Z,
            -Vec3::Z,
            Vec3::X,
            Vec3::new(1e-4, -1e-4, -1.0).normalize(),
            Vec3::new(0.3, -0.8, 0.2).normalize(),
        ] {
            let f = Frame::new(normal);
            assert!((f.tangent.cross(f.bitangent) - normal).length() < 1e-5);
            let v = Vec3::new(0.2, -0.5, 0.7);
            assert!((f.to_local(f.to_world(v)) - v).length() < 1e-6);
        }
    }
}
