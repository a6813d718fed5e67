//! The scalars that programs run over, and what is picked by their type.

use pulp::Arch;

use crate::buffer::Buffer;
use crate::custom::{Call, Erased};
use crate::dual::Dual;
use crate::graph::{Node, Op};
use crate::linear_map::LinearMap;
use crate::op::{Element, RESULT};
use crate::real::Real;

/// A scalar that programs run over.
#[doc(hidden)]
pub trait Lane: Real {
    /// What a number is made of, as far as linear operators are concerned.
    type Part: Real;
    /// Applies a fixed linear operator to a `lanes x columns` array. `parts` is room that is kept between calls.
    #[allow(private_interfaces)]
    fn apply_map(
        map: &dyn LinearMap,
        transpose: bool,
        columns: usize,
        input: &[Self],
        output: &mut [Self],
        parts: &mut Buffer<Self::Part>,
    );
    /// Runs a user's operation.
    #[allow(private_interfaces)]
    fn call(op: &dyn Erased, call: Call<Self>);
}

macro_rules! lane {
    ($t:ident, $apply:ident, $transpose:ident, $dual:ident) => {
        impl Lane for $t {
            type Part = $t;
            #[allow(private_interfaces)]
            fn apply_map(
                map: &dyn LinearMap,
                transpose: bool,
                columns: usize,
                input: &[Self],
                output: &mut [Self],
                _: &mut Buffer<$t>,
            ) {
                if transpose {
                    map.$transpose(columns, input, output)
                } else {
                    map.$apply(columns, input, output)
                }
            }
            #[allow(private_interfaces)]
            fn call(op: &dyn Erased, call: Call<Self>) {
                op.$t(call)
            }
        }

        impl Lane for Dual<$t> {
            type Part = $t;
            #[allow(private_interfaces)]
            fn apply_map(
                map: &dyn LinearMap,
                transpose: bool,
                columns: usize,
                input: &[Self],
                output: &mut [Self],
                parts: &mut Buffer<$t>,
            ) {
                // The operator is linear: value and derivative go through it one after the other.
                let (n, m) = (input.len(), output.len());
                parts.grow(n + 2 * m);
                let (source, results) = parts.as_mut_slice()[..n + 2 * m].split_at_mut(n);
                let (values, derivatives) = results.split_at_mut(m);
                let plain = |map: &dyn LinearMap, x: &[$t], y: &mut [$t]| match transpose {
                    true => map.$transpose(columns, x, y),
                    false => map.$apply(columns, x, y),
                };
                source.iter_mut().zip(input).for_each(|(s, x)| *s = x.value);
                plain(map, source, values);
                source
                    .iter_mut()
                    .zip(input)
                    .for_each(|(s, x)| *s = x.derivative);
                plain(map, source, derivatives);
                for (i, out) in output.iter_mut().enumerate() {
                    *out = Dual::new(values[i], derivatives[i]);
                }
            }
            #[allow(private_interfaces)]
            fn call(op: &dyn Erased, call: Call<Self>) {
                op.$dual(call)
            }
        }
    };
}
lane!(f32, apply_f32, apply_transpose_f32, dual32);
lane!(f64, apply_f64, apply_transpose_f64, dual64);

/// An elementwise function: a primitive or a user's.
#[derive(Clone, Copy)]
pub(super) enum Function<'a> {
    Element(Element),
    Custom(&'a dyn Erased),
}

impl<'a> Function<'a> {
    /// The function of an elementwise node.
    #[inline(always)]
    pub fn of(node: &'a Node) -> Option<Self> {
        match &node.op {
            Op::Element(element) => Some(Function::Element(*element)),
            Op::Custom(op) => Some(Function::Custom(op.as_ref())),
            _ => None,
        }
    }

    /// What the partial derivative with respect to operand `i` reads.
    pub fn reads(self, i: usize) -> u8 {
        match self {
            Function::Element(element) => element.reads(i),
            Function::Custom(_) => !0 | RESULT,
        }
    }

    /// `y = f(x)`
    #[inline(always)]
    pub fn evaluate<R: Lane>(self, arch: Arch, x: &[&[R]], y: &mut [R]) {
        match self {
            Function::Element(element) => element.evaluate(arch, x, y),
            Function::Custom(op) => R::call(op, Call::Value { x, y }),
        }
    }

    /// `target (+)= (df/dx_i) source`
    #[inline(always)]
    pub fn pass<R: Lane>(
        self,
        arch: Arch,
        i: usize,
        x: &[&[R]],
        y: &[R],
        source: &[R],
        target: &mut [R],
        add: bool,
    ) {
        match self {
            Function::Element(element) => element.pass(arch, i, x, y, source, target, add),
            Function::Custom(op) => {
                let call = Call::Pass {
                    i,
                    x,
                    y,
                    source,
                    target,
                    add,
                };
                R::call(op, call)
            }
        }
    }
}
