//! Elementwise operations supplied by the user.

use std::sync::Arc;

use crate::dual::Dual;
use crate::real::{Fma, Real};

/// An elementwise function of `N` operands, written once and differentiated by running it on dual numbers.
///
/// Use it with [`crate::Graph::custom`]. Kinks and singularities are those of the formula; an incoming derivative of exactly 0
/// contributes exactly 0 whatever the partial derivative is.
pub trait CustomOp<const N: usize>: Send + Sync + 'static {
    /// The name shown in messages.
    fn name(&self) -> &'static str;
    /// The value. Deterministic, and without side effects: it is recomputed at will.
    fn eval<R: Real, F: Fma>(&self, x: [R; N]) -> R;
}

/// `M` elementwise functions of the same `N` operands, written together: a vector for each lane.
///
/// Use it with [`crate::Graph::custom_vec`]. Each result is a [`CustomOp`] of its own, which runs the whole of `eval` and keeps its
/// part, on the way back once for each operand: a gradient through all of them runs it `M (1 + N)` times on a lane, and `M` times
/// more where values are computed again. Results that nothing needs cost nothing. Where what they share is dear, record that first,
/// by primitives or as a [`CustomOp`], and have the results take it as an operand.
pub trait CustomVecOp<const N: usize, const M: usize>: Send + Sync + 'static {
    /// The name shown in messages.
    fn name(&self) -> &'static str;
    /// The values. Deterministic, and without side effects: they are recomputed at will.
    fn eval<R: Real, F: Fma>(&self, x: [R; N]) -> [R; M];
}

/// An elementwise function whose first derivatives alone are known: Hessian-vector products through it are an error.
///
/// Use it with [`crate::Graph::custom_first_order`].
pub trait FirstOrderOnly<const N: usize>: Send + Sync + 'static {
    /// The name shown in messages.
    fn name(&self) -> &'static str;
    /// The value.
    fn eval(&self, x: [f64; N]) -> f64;
    /// The partial derivative with respect to each operand, given the value `y`.
    fn partials(&self, x: [f64; N], y: f64) -> [f64; N];
}

/// A user's operation without its type, for each scalar that programs run over.
pub(crate) trait Erased: Send + Sync {
    fn name(&self) -> &'static str;
    fn is_first_order(&self) -> bool;
    fn f32(&self, call: Call<f32>);
    fn f64(&self, call: Call<f64>);
    fn dual32(&self, call: Call<Dual<f32>>);
    fn dual64(&self, call: Call<Dual<f64>>);
}

/// What an operation is asked for on a row of lanes.
pub(crate) enum Call<'a, R> {
    /// `y = f(x)`
    Value { x: &'a [&'a [R]], y: &'a mut [R] },
    /// `target (+)= (df/dx_i) source`
    Pass {
        i: usize,
        x: &'a [&'a [R]],
        y: &'a [R],
        source: &'a [R],
        target: &'a mut [R],
        add: bool,
    },
}

/// One result of a [`CustomVecOp`].
pub(crate) struct Component<T, const N: usize, const M: usize> {
    pub op: Arc<T>,
    pub at: usize,
}

impl<T: CustomVecOp<N, M>, const N: usize, const M: usize> CustomOp<N> for Component<T, N, M> {
    fn name(&self) -> &'static str {
        self.op.name()
    }
    fn eval<R: Real, F: Fma>(&self, x: [R; N]) -> R {
        self.op.eval::<R, F>(x)[self.at]
    }
}

/// Adapts a [`CustomOp`].
pub(crate) struct Smooth<T, const N: usize>(pub T);
/// Adapts a [`FirstOrderOnly`].
pub(crate) struct Limited<T, const N: usize>(pub T);

#[derive(Clone, Copy)]
struct Plain;
impl Fma for Plain {
    const FUSED: bool = false;
}

fn lane<R: Real, const N: usize>(x: &[&[R]], lane: usize) -> [R; N] {
    std::array::from_fn(|j| x[j][lane])
}

fn answer<R: Real, const N: usize>(
    call: Call<R>,
    value: impl Fn([R; N]) -> R,
    partial: impl Fn(usize, [R; N], R) -> R,
) {
    match call {
        Call::Value { x, y } => {
            for (k, y) in y.iter_mut().enumerate() {
                *y = value(lane(x, k));
            }
        }
        Call::Pass {
            i,
            x,
            y,
            source,
            target,
            add,
        } => {
            for (k, target) in target.iter_mut().enumerate() {
                let term = if source[k].is_zero() {
                    R::default()
                } else {
                    source[k] * partial(i, lane(x, k), y[k])
                };
                *target = if add { *target + term } else { term };
            }
        }
    }
}

impl<T: CustomOp<N>, const N: usize> Smooth<T, N> {
    fn call<R: Real>(&self, call: Call<R>) {
        let partial = |i: usize, x: [R; N], _: R| {
            let seeded = std::array::from_fn(|j| {
                let seed = if i == j { 1.0 } else { 0.0 };
                Dual::new(x[j], R::from_f64(seed))
            });
            self.0.eval::<Dual<R>, Plain>(seeded).derivative
        };
        answer(call, |x| self.0.eval::<R, Plain>(x), partial);
    }
}

impl<T: CustomOp<N>, const N: usize> Erased for Smooth<T, N> {
    fn name(&self) -> &'static str {
        self.0.name()
    }
    fn is_first_order(&self) -> bool {
        false
    }
    fn f32(&self, call: Call<f32>) {
        self.call(call)
    }
    fn f64(&self, call: Call<f64>) {
        self.call(call)
    }
    fn dual32(&self, call: Call<Dual<f32>>) {
        self.call(call)
    }
    fn dual64(&self, call: Call<Dual<f64>>) {
        self.call(call)
    }
}

impl<T: FirstOrderOnly<N>, const N: usize> Limited<T, N> {
    fn call<R: Real>(&self, call: Call<R>) {
        let value = |x: [R; N]| R::from_f64(self.0.eval(x.map(R::to_f64)));
        let partial = |i: usize, x: [R; N], y: R| {
            R::from_f64(self.0.partials(x.map(R::to_f64), y.to_f64())[i])
        };
        answer(call, value, partial);
    }
}

impl<T: FirstOrderOnly<N>, const N: usize> Erased for Limited<T, N> {
    fn name(&self) -> &'static str {
        self.0.name()
    }
    fn is_first_order(&self) -> bool {
        true
    }
    fn f32(&self, call: Call<f32>) {
        self.call(call)
    }
    fn f64(&self, call: Call<f64>) {
        self.call(call)
    }
    // Second derivatives are refused before a program runs on dual numbers.
    fn dual32(&self, call: Call<Dual<f32>>) {
        self.call(call)
    }
    fn dual64(&self, call: Call<Dual<f64>>) {
        self.call(call)
    }
}
