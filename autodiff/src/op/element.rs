//! The closed list of elementwise primitives, as recorded in a graph.

use pulp::Arch;

use super::Primitive;
use super::arithmetic::{
    Add, Affine, Div, Fifth, Mul, MulAdd, MulSub, Neg, NegMulAdd, Product, Recip, Square, Sub,
};
use super::kernel::{evaluate, pass};
use super::smooth::{Acos, Atan2, Cos, Exp, Ln, Pow, Rsqrt, Sigmoid, Sin, Softplus, Sqrt};
use super::switch::{Abs, Clamp, Less, LessEqual, Max, Min, Relu, Select};
use crate::real::Real;

/// An elementwise primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Element {
    Neg,
    Recip,
    Square,
    Fifth,
    Sqrt,
    Rsqrt,
    Exp,
    Ln,
    Sin,
    Cos,
    Acos,
    Sigmoid,
    Softplus,
    Abs,
    Relu,
    Add,
    Sub,
    Mul,
    Div,
    Atan2,
    Pow,
    Min,
    Max,
    Less,
    LessEqual,
    MulAdd,
    NegMulAdd,
    MulSub,
    Select,
    Product { offset: f64 },
    Affine { scale: f64, offset: f64 },
    Clamp { low: f64, high: f64 },
}

/// Runs `$body` with `$p` bound to the primitive and `$n` to a constant of its number of operands.
macro_rules! with_primitive {
    ($element:expr, |$p:ident, $n:ident| $body:expr) => {
        with_primitive!(@ $element, $p, $n, $body,
            1 [Neg Recip Square Fifth Sqrt Rsqrt Exp Ln Sin Cos Acos Sigmoid Softplus Abs Relu]
            2 [Add Sub Mul Div Atan2 Pow Min Max Less LessEqual]
            3 [MulAdd NegMulAdd MulSub Select])
    };
    (@ $element:expr, $p:ident, $n:ident, $body:expr, $($arity:literal [$($name:ident)*])*) => {
        match $element {
            $($(Element::$name => {
                let $p = $name;
                const $n: usize = $arity;
                $body
            })*)*
            Element::Affine { scale, offset } => {
                let $p = Affine { scale, offset };
                const $n: usize = 1;
                $body
            }
            Element::Product { offset } => {
                let $p = Product { offset };
                const $n: usize = 2;
                $body
            }
            Element::Clamp { low, high } => {
                let $p = Clamp { low, high };
                const $n: usize = 1;
                $body
            }
        }
    };
}

pub(super) use with_primitive;

impl Element {
    /// How many operands it has.
    pub fn arity(self) -> usize {
        with_primitive!(self, |p, N| {
            let _ = p;
            N
        })
    }

    /// What the partial derivative with respect to operand `i` reads.
    pub fn reads(self, i: usize) -> u8 {
        with_primitive!(self, |p, _N| p.reads(i))
    }

    /// `y = f(x)`; `x` has an array for each operand, each as long as `y`.
    pub fn evaluate<R: Real>(self, arch: Arch, x: &[&[R]], y: &mut [R]) {
        with_primitive!(self, |p, N| evaluate::<R, _, N>(
            arch,
            p,
            operands::<R, N>(x),
            y
        ))
    }

    /// `target = (df/dxi) source`, or `+=` when `add`, where a `source` of exactly zero contributes exactly zero.
    pub fn pass<R: Real>(
        self,
        arch: Arch,
        i: usize,
        x: &[&[R]],
        y: &[R],
        source: &[R],
        target: &mut [R],
        add: bool,
    ) {
        with_primitive!(self, |p, N| {
            let x = operands::<R, N>(x);
            pass::<R, _, N>(arch, p, i, x, y, source, target, add)
        })
    }

    /// The name shown in messages.
    pub fn name(self) -> &'static str {
        match self {
            Element::Affine { .. } => "affine",
            Element::Clamp { .. } => "clamp",
            Element::Neg => "neg",
            Element::Recip => "recip",
            Element::Square => "square",
            Element::Fifth => "pow5",
            Element::Sqrt => "sqrt",
            Element::Rsqrt => "rsqrt",
            Element::Exp => "exp",
            Element::Ln => "ln",
            Element::Sin => "sin",
            Element::Cos => "cos",
            Element::Acos => "acos",
            Element::Sigmoid => "sigmoid",
            Element::Softplus => "softplus",
            Element::Abs => "abs",
            Element::Relu => "relu",
            Element::Add => "add",
            Element::Sub => "sub",
            Element::Mul => "mul",
            Element::Div => "div",
            Element::Atan2 => "atan2",
            Element::Pow => "pow",
            Element::Min => "min",
            Element::Max => "max",
            Element::Less => "lt",
            Element::LessEqual => "le",
            Element::MulAdd => "mul_add",
            Element::NegMulAdd => "neg_mul_add",
            Element::MulSub => "mul_sub",
            Element::Product { .. } => "product",
            Element::Select => "select",
        }
    }
}

/// The first `N` operands.
fn operands<'a, R, const N: usize>(x: &[&'a [R]]) -> [&'a [R]; N] {
    std::array::from_fn(|i| x[i])
}
