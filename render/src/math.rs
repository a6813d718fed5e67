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
    #[inline(always)]
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
    #[inline(always)]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.tangent * v.x + self.bitangent * v.y + self.normal * v.z
    }

    /// Local coordinates of the world vector `v`.
    #[inline(always)]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(
            v.dot(self.tangent),
            v.dot(self.bitangent),
            v.dot(self.normal),
        )
    }
}

/// The angle of the point (x, y) in radians, of [−π, π], within 4e-7 (Cephes' `atanf` after Moshier).
///
/// Directions are turned into map coordinates several times a sample, where the C library's call costs more than all else.
/// Choices are selections and there is one division, so that a loop over many samples becomes SIMD.
#[inline(always)]
pub fn fast_atan2(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ax < ay;
    let low = if steep { ax } else { ay };
    let high = if steep { ay } else { ax };
    // tan(π/8) splits the octant: beyond it atan r = π/4 + atan((r − 1)/(r + 1)).
    let far = low > 0.414_213_57 * high;
    let numerator = if far { low - high } else { low };
    let denominator = if far { low + high } else { high };
    // The origin has angle 0.
    let t = numerator / if high == 0.0 { 1.0 } else { denominator };
    let base = if far { FRAC_PI_4 } else { 0.0 };
    let z = t * t;
    let series = ((0.080_537_446 * z - 0.138_776_86) * z + 0.199_777_11) * z - 0.333_329_5;
    let octant = base + (series * z * t + t);
    let quadrant = if steep { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    half.copysign(y)
}

/// Sine and cosine of `turns` full turns, |turns| ≤ 2, within 3e-7. Without branches, as [`fast_atan2`].
#[inline(always)]
pub fn fast_sin_cos(turns: f32) -> (f32, f32) {
    // Quarters are exact to remove in turns; what is left is within π/4.
    let quarter = (4.0 * turns + 8.5) as i32 - 8;
    let x = (turns - 0.25 * quarter as f32) * std::f32::consts::TAU;
    let z = x * x;
    let sin = ((-1.951_529_6e-4 * z + 8.332_161e-3) * z - 0.166_666_55) * z * x + x;
    let cos = ((2.443_315_7e-5 * z - 1.388_731_6e-3) * z + 4.166_664_6e-2) * z * z - 0.5 * z + 1.0;
    // A quarter turns (sin, cos) into (cos, −sin).
    let odd = quarter & 1 != 0;
    let (s, c) = (if odd { cos } else { sin }, if odd { sin } else { cos });
    let negated =
        |value: f32, sign: i32| f32::from_bits(value.to_bits() ^ ((sign & 2) as u32) << 30);
    (negated(s, quarter), negated(c, quarter + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_angles_are_close_to_exact_ones() {
        for i in 0..=4000 {
            let turns = f64::from(i) / 1000.0 - 2.0;
            let (sin, cos) = fast_sin_cos(turns as f32);
            let (s, c) = (turns * std::f64::consts::TAU).sin_cos();
            // The argument itself is rounded to single precision.
            assert!(
                (f64::from(sin) - s).abs() < 8e-7 && (f64::from(cos) - c).abs() < 8e-7,
                "{turns}"
            );
            let angle = fast_atan2(2.5 * sin, 2.5 * cos);
            let exact = f64::from(sin).atan2(f64::from(cos));
            assert!(
                (f64::from(angle) - exact).abs() < 4e-7,
                "{turns} {angle} {exact}"
            );
        }
        assert_eq!(fast_atan2(0.0, 0.0), 0.0);
        assert_eq!(fast_atan2(0.0, -1.0), std::f32::consts::PI);
    }

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
