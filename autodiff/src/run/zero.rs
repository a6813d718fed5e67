//! The zero rule in sums of products: a derivative of exactly 0 contributes exactly 0, whatever it is multiplied with.
//!
//! Loops over whole rows multiply without looking; they check the few factors that could spoil a sum, or what comes out, so that
//! finite data pay next to nothing. Where something is not finite, the same products are summed again, in the same order, with
//! [`add_product`].

use pulp::Simd;

use crate::real::{Fma, Real};

/// Which factor of a product is a derivative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Derivative {
    Neither,
    First,
    Second,
}

impl Derivative {
    /// The same for the product with its factors exchanged.
    pub fn exchanged(self) -> Self {
        match self {
            Derivative::Neither => Derivative::Neither,
            Derivative::First => Derivative::Second,
            Derivative::Second => Derivative::First,
        }
    }
}

/// `sum + a * b`; `sum` where the derivative among both factors is exactly 0.
#[inline(always)]
pub(super) fn add_product<R: Real, F: Fma>(a: R, b: R, sum: R, derivative: Derivative) -> R {
    let nothing = match derivative {
        Derivative::Neither => false,
        Derivative::First => a.is_zero(),
        Derivative::Second => b.is_zero(),
    };
    if nothing { sum } else { a.mul_add::<F>(b, sum) }
}

/// `a`, a derivative, times `b`.
#[inline(always)]
pub(super) fn times<R: Real>(a: R, b: R) -> R {
    if a.is_zero() { R::default() } else { a * b }
}

/// Whether all elements are finite. To be called within a kernel.
#[inline(always)]
pub(super) fn all_finite<R: Real, S: Simd>(simd: S, x: &[R]) -> bool {
    // A number times 0 is 0 if it is finite, and NaN if not.
    let zero = R::splat(simd, R::default());
    let (packs, rest) = R::packs::<S>(x);
    let (fours, few) = packs.as_chunks::<4>();
    let mut found = [zero; 4];
    for four in fours {
        for i in 0..4 {
            found[i] = R::fma(simd, zero, four[i], found[i]);
        }
    }
    for pack in few {
        found[0] = R::fma(simd, zero, *pack, found[0]);
    }
    let pairs = [
        R::plus(simd, found[0], found[1]),
        R::plus(simd, found[2], found[3]),
    ];
    let mut sum = R::sum(simd, R::plus(simd, pairs[0], pairs[1]));
    for x in rest {
        sum = sum + R::default() * *x;
    }
    sum.is_finite()
}

/// Whether all registers hold finite numbers. To be called within a kernel.
#[inline(always)]
pub(super) fn are_finite<R: Real, S: Simd, const N: usize, const T: usize>(
    simd: S,
    registers: &[[R::Pack<S>; T]; N],
) -> bool {
    let zero = R::splat(simd, R::default());
    let mut found = [zero; T];
    for row in registers {
        for t in 0..T {
            found[t] = R::fma(simd, zero, row[t], found[t]);
        }
    }
    let mut sum = found[0];
    for t in 1..T {
        sum = R::plus(simd, sum, found[t]);
    }
    R::sum(simd, sum).is_finite()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;
    use crate::op::kernel::{Kernel, dispatch};

    struct Check<'a, R>(&'a [R], &'a mut bool);

    impl<R: Real> Kernel for Check<'_, R> {
        const PACKED: bool = R::PACKED;
        #[inline(always)]
        fn run<S: Simd>(self, simd: S) {
            *self.1 = all_finite(simd, self.0);
        }
    }

    fn check<R: Real>(x: &[R]) -> bool {
        let mut finite = false;
        dispatch(pulp::Arch::new(), Check(x, &mut finite));
        finite
    }

    fn every_place<R: Real>(spoilt: [R; 3]) {
        for n in [0, 1, 7, 16, 33, 129, 200] {
            let mut x = vec![R::from_f64(-3.0); n];
            assert!(check(&x));
            for i in 0..n {
                for bad in spoilt {
                    let good = std::mem::replace(&mut x[i], bad);
                    assert!(!check(&x), "{i} of {n}");
                    x[i] = good;
                }
            }
        }
    }

    #[test]
    fn what_is_not_finite_is_found_wherever_it_is() {
        every_place([f32::NAN, f32::INFINITY, f32::NEG_INFINITY]);
        every_place([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
        let dual = |value, derivative| Dual::<f64>::new(value, derivative);
        every_place([
            dual(f64::NAN, 0.0),
            dual(1.0, f64::INFINITY),
            dual(f64::NEG_INFINITY, 1.0),
        ]);
        assert!(check(&[f32::MAX; 100]) && check(&[f64::MAX; 100]));
    }
}
