//! Vectors of scalars, for the few kernels whose loops the compiler does not vectorise by itself.

use pulp::Simd;

use crate::dual::Dual;
use crate::real::Real;

/// A scalar that packs into vector registers. Dual numbers are packs of one.
#[doc(hidden)]
pub trait Packed: Copy {
    /// Whether packs are wider than one scalar.
    const PACKED: bool;
    /// A vector register of scalars.
    type Pack<S: Simd>: Copy;
    /// A slice as packs, and the rest.
    fn packs<S: Simd>(x: &[Self]) -> (&[Self::Pack<S>], &[Self]);
    /// A mutable slice as packs, and the rest.
    fn packs_mut<S: Simd>(x: &mut [Self]) -> (&mut [Self::Pack<S>], &mut [Self]);
    /// The same scalar in all places.
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Pack<S>;
    /// A slice shorter than a register, and zeros.
    fn load_part<S: Simd>(simd: S, x: &[Self]) -> Self::Pack<S>;
    /// Writes the first elements of a register to a slice shorter than it.
    fn store_part<S: Simd>(simd: S, x: &mut [Self], pack: Self::Pack<S>);
    /// `a * b + c`
    fn fma<S: Simd>(simd: S, a: Self::Pack<S>, b: Self::Pack<S>, c: Self::Pack<S>)
    -> Self::Pack<S>;
    /// `a + b`
    fn plus<S: Simd>(simd: S, a: Self::Pack<S>, b: Self::Pack<S>) -> Self::Pack<S>;
    /// The sum of all places.
    fn sum<S: Simd>(simd: S, a: Self::Pack<S>) -> Self;
}

macro_rules! packed {
    ($t:ty, $pack:ident, $as:ident, $as_mut:ident, $splat:ident, $load:ident, $store:ident, $fma:ident, $add:ident, $sum:ident) => {
        impl Packed for $t {
            const PACKED: bool = true;
            type Pack<S: Simd> = S::$pack;
            #[inline(always)]
            fn packs<S: Simd>(x: &[Self]) -> (&[S::$pack], &[Self]) {
                S::$as(x)
            }
            #[inline(always)]
            fn packs_mut<S: Simd>(x: &mut [Self]) -> (&mut [S::$pack], &mut [Self]) {
                S::$as_mut(x)
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, x: Self) -> S::$pack {
                simd.$splat(x)
            }
            #[inline(always)]
            fn load_part<S: Simd>(simd: S, x: &[Self]) -> S::$pack {
                simd.$load(x)
            }
            #[inline(always)]
            fn store_part<S: Simd>(simd: S, x: &mut [Self], pack: S::$pack) {
                simd.$store(x, pack)
            }
            #[inline(always)]
            fn fma<S: Simd>(simd: S, a: S::$pack, b: S::$pack, c: S::$pack) -> S::$pack {
                simd.$fma(a, b, c)
            }
            #[inline(always)]
            fn plus<S: Simd>(simd: S, a: S::$pack, b: S::$pack) -> S::$pack {
                simd.$add(a, b)
            }
            #[inline(always)]
            fn sum<S: Simd>(simd: S, a: S::$pack) -> Self {
                simd.$sum(a)
            }
        }
    };
}
packed!(
    f32,
    f32s,
    as_simd_f32s,
    as_mut_simd_f32s,
    splat_f32s,
    partial_load_f32s,
    partial_store_f32s,
    mul_add_e_f32s,
    add_f32s,
    reduce_sum_f32s
);
packed!(
    f64,
    f64s,
    as_simd_f64s,
    as_mut_simd_f64s,
    splat_f64s,
    partial_load_f64s,
    partial_store_f64s,
    mul_add_e_f64s,
    add_f64s,
    reduce_sum_f64s
);

impl<T: Real> Packed for Dual<T> {
    const PACKED: bool = false;
    type Pack<S: Simd> = Self;
    #[inline(always)]
    fn packs<S: Simd>(x: &[Self]) -> (&[Self], &[Self]) {
        (x, &[])
    }
    #[inline(always)]
    fn packs_mut<S: Simd>(x: &mut [Self]) -> (&mut [Self], &mut [Self]) {
        (x, &mut [])
    }
    #[inline(always)]
    fn splat<S: Simd>(_: S, x: Self) -> Self {
        x
    }
    #[inline(always)]
    fn load_part<S: Simd>(_: S, x: &[Self]) -> Self {
        // A register holds one number: no slice is shorter, except an empty one.
        x.first().copied().unwrap_or_default()
    }
    #[inline(always)]
    fn store_part<S: Simd>(_: S, x: &mut [Self], pack: Self) {
        x.iter_mut().for_each(|x| *x = pack);
    }
    #[inline(always)]
    fn fma<S: Simd>(_: S, a: Self, b: Self, c: Self) -> Self {
        a * b + c
    }
    #[inline(always)]
    fn plus<S: Simd>(_: S, a: Self, b: Self) -> Self {
        a + b
    }
    #[inline(always)]
    fn sum<S: Simd>(_: S, a: Self) -> Self {
        a
    }
}
