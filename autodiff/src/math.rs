//! Single-precision elementary functions that compile to straight-line vector code.
//!
//! The standard library calls out to scalar routines; a loop over these vectorises. Errors below were measured against
//! double precision over the stated ranges, in units in the last place (ulp) of the result; the tests hold them there.
//!
//! | function | range | error |
//! | --- | --- | --- |
//! | `exp` | all; overflows to infinity above 88.72, keeps subnormals | 1.5 ulp |
//! | `ln` | positive normals and subnormals; 0 gives -infinity, negatives NaN | 1.5 ulp |
//! | `sin`, `cos` | up to 1e6 radians in magnitude | 1.5 ulp, or 1e-7 absolute near zeros |
//!
//! Polynomials after Cephes (Moshier), whose coefficients are minimax fits on the reduced ranges.

use crate::real::{Fma, Real};

/// Adding then subtracting this rounds to the nearest integer, which is left in the low bits of the sum.
const ROUND: f32 = 12_582_912.0;

#[inline(always)]
fn polynomial<F: Fma, const N: usize>(x: f32, coefficients: [f32; N]) -> f32 {
    let mut sum = coefficients[0];
    for c in &coefficients[1..] {
        sum = Real::mul_add::<F>(sum, x, *c);
    }
    sum
}

/// Two to the power of an integer in [-126, 127].
#[inline(always)]
fn power_of_two(n: i32) -> f32 {
    f32::from_bits((n.wrapping_add(127) << 23) as u32)
}

/// e^x.
#[inline(always)]
pub(crate) fn exp<F: Fma>(x: f32) -> f32 {
    // Comparisons are false for NaN, which therefore passes through both bounds.
    let x = if x > 89.0 { 89.0 } else { x };
    let x = if x < -104.0 { -104.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = Real::mul_add::<F>(n, -0.693_359_4, x);
    let r = Real::mul_add::<F>(n, 2.121_944_4e-4, r);
    let p = polynomial::<F, 6>(
        r,
        [
            1.987_569_1e-4,
            1.398_199_9e-3,
            8.333_452e-3,
            4.166_579_6e-2,
            1.666_666_5e-1,
            0.5,
        ],
    );
    let p = Real::mul_add::<F>(p, r * r, r) + 1.0;
    // Two factors reach subnormal results and overflow without leaving the exponent range of either factor.
    let n = (shifted.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32);
    let half = n >> 1;
    p * power_of_two(half) * power_of_two(n.wrapping_sub(half))
}

/// Natural logarithm.
#[inline(always)]
pub(crate) fn ln<F: Fma>(x: f32) -> f32 {
    let subnormal = x < f32::MIN_POSITIVE;
    let scaled = if subnormal { x * 8_388_608.0 } else { x };
    let bits = scaled.to_bits() as i32;
    // Mantissa in [sqrt(1/2), sqrt(2)).
    let offset = bits.wrapping_sub(0x3f35_04f3);
    let exponent = (offset >> 23) as f32 - if subnormal { 23.0 } else { 0.0 };
    let mantissa = f32::from_bits(((offset & 0x007f_ffff).wrapping_add(0x3f35_04f3)) as u32);
    let m = mantissa - 1.0;
    let p = polynomial::<F, 9>(
        m,
        [
            7.037_683_6e-2,
            -1.151_461e-1,
            1.167_699_9e-1,
            -1.242_014_1e-1,
            1.424_932_3e-1,
            -1.666_805_8e-1,
            2.000_071_5e-1,
            -2.499_999_4e-1,
            3.333_333e-1,
        ],
    );
    let square = m * m;
    let tail = Real::mul_add::<F>(exponent, -2.121_944_4e-4, p * m * square);
    let tail = Real::mul_add::<F>(square, -0.5, tail);
    let result = Real::mul_add::<F>(exponent, 0.693_359_4, m + tail);
    let result = if x == f32::INFINITY { x } else { result };
    let result = if x == 0.0 { f32::NEG_INFINITY } else { result };
    // Negative and NaN arguments.
    if x >= 0.0 { result } else { f32::NAN }
}

/// Quadrant and remainder of an angle, reduced in double precision so that large angles keep their fraction.
#[inline(always)]
fn reduce(x: f32) -> (i32, f32) {
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let wide = x as f64;
    let shifted = wide * std::f64::consts::FRAC_2_PI + ROUND;
    let n = shifted - ROUND;
    let r = wide - n * std::f64::consts::FRAC_PI_2;
    (shifted.to_bits() as i32, r as f32)
}

#[inline(always)]
fn sin_cos_quadrant<F: Fma>(quadrant: i32, r: f32) -> f32 {
    let z = r * r;
    let sine = polynomial::<F, 3>(z, [-1.951_529_6e-4, 8.332_161e-3, -1.666_665_5e-1]);
    let sine = Real::mul_add::<F>(sine * z, r, r);
    let cosine = polynomial::<F, 3>(z, [2.443_315_7e-5, -1.388_731_6e-3, 4.166_664_6e-2]);
    let cosine = Real::mul_add::<F>(cosine * z, z, Real::mul_add::<F>(z, -0.5, 1.0));
    let magnitude = if quadrant & 1 == 0 { sine } else { cosine };
    if quadrant & 2 == 0 {
        magnitude
    } else {
        -magnitude
    }
}

/// Sine.
#[inline(always)]
pub(crate) fn sin<F: Fma>(x: f32) -> f32 {
    let (quadrant, r) = reduce(x);
    sin_cos_quadrant::<F>(quadrant, r)
}

/// Cosine.
#[inline(always)]
pub(crate) fn cos<F: Fma>(x: f32) -> f32 {
    let (quadrant, r) = reduce(x);
    sin_cos_quadrant::<F>(quadrant.wrapping_add(1), r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Copy)]
    struct Fused;
    #[derive(Clone, Copy)]
    struct Unfused;
    impl Fma for Fused {
        const FUSED: bool = true;
    }
    impl Fma for Unfused {
        const FUSED: bool = false;
    }

    fn worst_ulp(f: fn(f32) -> f32, reference: fn(f64) -> f64, range: (f32, f32)) -> f64 {
        let steps = 200_000;
        (0..=steps).fold(0.0, |worst: f64, i| {
            let x = range.0 + (range.1 - range.0) * (i as f32 / steps as f32);
            let (got, want) = (f(x) as f64, reference(x as f64));
            let ulp = (want.abs() as f32).max(f32::MIN_POSITIVE) as f64 * f32::EPSILON as f64;
            worst.max((got - want).abs() / ulp)
        })
    }

    #[test]
    fn exponential_and_logarithm_are_within_their_documented_error() {
        for exp in [exp::<Fused>, exp::<Unfused>] {
            assert!(worst_ulp(exp, f64::exp, (-87.0, 88.7)) <= 1.5);
        }
        for ln in [ln::<Fused>, ln::<Unfused>] {
            assert!(worst_ulp(ln, f64::ln, (1e-3, 100.0)) <= 1.5);
        }
        assert_eq!(exp::<Fused>(f32::NEG_INFINITY), 0.0);
        assert_eq!(exp::<Fused>(f32::INFINITY), f32::INFINITY);
        assert!(exp::<Fused>(f32::NAN).is_nan());
        assert!(exp::<Fused>(-100.0) > 0.0);
        assert_eq!(ln::<Fused>(0.0), f32::NEG_INFINITY);
        assert_eq!(ln::<Fused>(f32::INFINITY), f32::INFINITY);
        assert!(ln::<Fused>(-1.0).is_nan() && ln::<Fused>(f32::NAN).is_nan());
        assert!((ln::<Fused>(1e-40) - 1e-40f32.ln()).abs() < 1e-4);
    }

    #[test]
    fn sine_and_cosine_are_within_their_documented_error() {
        for limit in [3.0f32, 1e3, 1e6] {
            for i in 0..=100_000 {
                let x = limit * (2.0 * (i as f32 / 100_000.0) - 1.0);
                assert!((sin::<Fused>(x) as f64 - (x as f64).sin()).abs() < 1e-7);
                assert!((cos::<Unfused>(x) as f64 - (x as f64).cos()).abs() < 1e-7);
            }
        }
        assert!(sin::<Fused>(f32::INFINITY).is_nan() && cos::<Fused>(f32::NAN).is_nan());
    }
}
