//! The scalars that programs run over, and what is picked by their type.

use pulp::Arch;

use crate::custom::{Call, Erased};
use crate::dual::Dual;
use crate::graph::{Node, Op};
use crate::linear_map::LinearMap;
use crate::op::{Element, RESULT};
use crate::real::Real;

/// A scalar that programs run over.
#[doc(hidden)]
pub trait Lane: Real {
    /// Applies a fixed linear operator to a `lanes x columns` array.
    fn apply_map(
        map: &dyn LinearMap,
        transpose: bool,
        columns: usize,
        input: &[Self],
        output: &mut [Self],
    );
    /// Runs a user's operation.
    #[allow(private_interfaces)]
    fn call(op: &dyn Erased, call: Call<Self>);
}

macro_rules! lane {
    ($t:ident, $apply:ident, $transpose:ident, $dual:ident) => {
        impl Lane for $t {
            fn apply_map(
                map: &dyn LinearMap,
                transpose: bool,
                columns: usize,
                input: &[Self],
                output: &mut [Self],
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
                $t::apply_map(map, transpose, columns, &values, &mut value);
                $t::apply_map(map, transpose, columns, &derivatives, &mut derivative);
                for (i, out) in output.iter_mut().enumerate() {
                    *out = Dual::new(value[i], derivative[i]);
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
