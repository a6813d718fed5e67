//! Elementwise operations on recorded values.

use std::ops::{Add, Div, Mul, Neg, Sub};
use std::panic::Location;

use super::array::{Array, Detached, Join, Kind, Mask};
use super::node::{Op, Shape};
use crate::op::Element;

macro_rules! binary_operator {
    ($trait:ident, $method:ident) => {
        binary_operator!(@ $trait, $method, &Array<A>, &Array<B>);
        binary_operator!(@ $trait, $method, &Array<A>, Array<B>);
        binary_operator!(@ $trait, $method, Array<A>, &Array<B>);
        binary_operator!(@ $trait, $method, Array<A>, Array<B>);
    };
    (@ $trait:ident, $method:ident, $lhs:ty, $rhs:ty) => {
        impl<A: Join<B>, B: Kind> $trait<$rhs> for $lhs {
            type Output = Array<A::Out>;
            #[track_caller]
            fn $method(self, rhs: $rhs) -> Self::Output {
                self.binary(&rhs, Element::$trait, Location::caller())
            }
        }
    };
}
binary_operator!(Add, add);
binary_operator!(Sub, sub);
binary_operator!(Mul, mul);
binary_operator!(Div, div);

macro_rules! scalar_operator {
    ($trait:ident, $method:ident, |$a:ident, $s:ident| $right:expr, |$t:ident, $b:ident| $left:expr) => {
        impl<A: Kind> $trait<f64> for &Array<A> {
            type Output = Array<A>;
            #[track_caller]
            fn $method(self, $s: f64) -> Array<A> {
                let $a = self;
                $right
            }
        }
        impl<A: Kind> $trait<f64> for Array<A> {
            type Output = Array<A>;
            #[track_caller]
            fn $method(self, s: f64) -> Array<A> {
                (&self).$method(s)
            }
        }
        impl<B: Kind> $trait<&Array<B>> for f64 {
            type Output = Array<B>;
            #[track_caller]
            fn $method(self, $b: &Array<B>) -> Array<B> {
                let $t = self;
                $left
            }
        }
        impl<B: Kind> $trait<Array<B>> for f64 {
            type Output = Array<B>;
            #[track_caller]
            fn $method(self, rhs: Array<B>) -> Array<B> {
                self.$method(&rhs)
            }
        }
    };
}
scalar_operator!(Add, add, |a, s| a.affine(1.0, s), |s, b| b.affine(1.0, s));
scalar_operator!(Sub, sub, |a, s| a.affine(1.0, -s), |s, b| b.affine(-1.0, s));
scalar_operator!(Mul, mul, |a, s| a.affine(s, 0.0), |s, b| b.affine(s, 0.0));
scalar_operator!(Div, div, |a, s| a.affine(1.0 / s, 0.0), |s, b| b
    .recip()
    .affine(s, 0.0));

impl<A: Kind> Neg for &Array<A> {
    type Output = Array<A>;
    #[track_caller]
    fn neg(self) -> Array<A> {
        self.unary(Element::Neg, Location::caller())
    }
}

impl<A: Kind> Neg for Array<A> {
    type Output = Array<A>;
    #[track_caller]
    fn neg(self) -> Array<A> {
        self.unary(Element::Neg, Location::caller())
    }
}

macro_rules! unary_methods {
    ($($(#[$doc:meta])* $method:ident $element:ident;)*) => {
        $(
            $(#[$doc])*
            #[track_caller]
            pub fn $method(&self) -> Array<A> {
                self.unary(Element::$element, Location::caller())
            }
        )*
    };
}

impl<A: Kind> Array<A> {
    unary_methods! {
        /// Square root. The derivative at 0 is infinite.
        sqrt Sqrt;
        /// `1 / sqrt(x)`. Infinite at 0.
        rsqrt Rsqrt;
        /// `1 / x`.
        recip Recip;
        /// `e^x`.
        exp Exp;
        /// Natural logarithm. Minus infinity at 0, NaN below.
        ln Ln;
        /// Sine of radians.
        sin Sin;
        /// Cosine of radians.
        cos Cos;
        /// Arc cosine, in [0, pi]. The derivative at -1 and 1 is infinite.
        acos Acos;
        /// Absolute value. The derivative at 0 is 0.
        abs Abs;
        /// `1 / (1 + e^-x)`.
        sigmoid Sigmoid;
        /// `max(x, 0)`. The derivative at 0 is 0.
        relu Relu;
        /// `ln(1 + e^x)`.
        softplus Softplus;
        /// `x^2`.
        square Square;
    }

    /// `scale * x + offset`.
    #[track_caller]
    pub fn affine(&self, scale: f64, offset: f64) -> Array<A> {
        self.unary(Element::Affine { scale, offset }, Location::caller())
    }

    /// `x` held within `[low, high]`. The derivative is 1 on the closed interval, 0 outside.
    #[track_caller]
    pub fn clamp(&self, low: f64, high: f64) -> Array<A> {
        self.unary(Element::Clamp { low, high }, Location::caller())
    }

    /// `x^n` for a whole `n`, by repeated squaring. `x^0` is 1 for all finite `x`.
    #[track_caller]
    pub fn powi(&self, n: i32) -> Array<A> {
        let location = Location::caller();
        if n < 0 {
            // The power of the reciprocal: of the reciprocal of a power, derivatives at 0 are infinity times 0.
            let (below, times) = (self.unary(Element::Recip, location), n.unsigned_abs());
            return match times {
                1 => below,
                // i32::MIN has no opposite.
                _ => below.powi(times.min(i32::MAX as u32) as i32),
            };
        }
        match n.unsigned_abs() {
            0 => self.unary(
                Element::Affine {
                    scale: 0.0,
                    offset: 1.0,
                },
                location,
            ),
            1 => self.clone(),
            2 => self.unary(Element::Square, location),
            5 => self.unary(Element::Fifth, location),
            even if even % 2 == 0 => self
                .powi((even / 2) as i32)
                .unary(Element::Square, location),
            odd => self.raw(&self.powi((odd - 1) as i32), Element::Mul, location),
        }
    }

    /// `x^exponent` for `x >= 0`, NaN below; `x^0` is 1. The derivative by the exponent at `x = 0` is 0.
    #[track_caller]
    pub fn pow<B: Kind>(&self, exponent: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        self.binary(exponent, Element::Pow, Location::caller())
    }

    /// The angle of the point `(x, self)`, in (-pi, pi].
    #[track_caller]
    pub fn atan2<B: Kind>(&self, x: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        self.binary(x, Element::Atan2, Location::caller())
    }

    /// The smaller of two values; a tie, or a NaN on either side, gives and differentiates `self`.
    #[track_caller]
    pub fn min<B: Kind>(&self, other: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        self.binary(other, Element::Min, Location::caller())
    }

    /// The larger of two values; a tie, or a NaN on either side, gives and differentiates `self`.
    #[track_caller]
    pub fn max<B: Kind>(&self, other: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        self.binary(other, Element::Max, Location::caller())
    }

    /// `self * b + c`, with one rounding where the hardware has it.
    #[track_caller]
    pub fn mul_add<B: Kind, C: Kind>(
        &self,
        b: &Array<B>,
        c: &Array<C>,
    ) -> Array<<A::Out as Join<C>>::Out>
    where
        A: Join<B>,
        A::Out: Join<C>,
    {
        Array::<A>::elementwise(
            &self.graph,
            Element::MulAdd,
            &[(&self.graph, self.id), (&b.graph, b.id), (&c.graph, c.id)],
            Location::caller(),
        )
    }

    /// Where `self < other`.
    #[track_caller]
    pub fn lt<B: Kind>(&self, other: &Array<B>) -> Mask {
        Mask {
            value: self.raw(other, Element::Less, Location::caller()),
        }
    }

    /// Where `self <= other`.
    #[track_caller]
    pub fn le<B: Kind>(&self, other: &Array<B>) -> Mask {
        Mask {
            value: self.raw(other, Element::LessEqual, Location::caller()),
        }
    }

    /// Where `self > limit`.
    #[track_caller]
    pub fn gt_scalar(&self, limit: f64) -> Mask {
        let limit: Detached = self.graph.constant(limit);
        limit.lt(self)
    }

    /// One channel.
    #[track_caller]
    pub fn channel(&self, i: usize) -> Array<A> {
        let shape = self.shape();
        if i >= shape.channels {
            self.reject(
                "channel",
                Location::caller(),
                format!(
                    "there is no channel {i} of {}: take one of 0 to {}",
                    shape.channels,
                    shape.channels.saturating_sub(1)
                ),
            );
            return self.clone();
        }
        self.derive(
            Op::Channel(i),
            Shape {
                channels: 1,
                ..shape
            },
            Location::caller(),
        )
    }

    /// Sum over channels.
    #[track_caller]
    pub fn sum_channels(&self) -> Array<A> {
        let shape = Shape {
            channels: 1,
            ..self.shape()
        };
        self.derive(Op::SumChannels, shape, Location::caller())
    }

    /// Sum over channels of the product.
    #[track_caller]
    pub fn dot<B: Kind>(&self, other: &Array<B>) -> Array<A::Out>
    where
        A: Join<B>,
    {
        let operands = [(&self.graph, self.id), (&other.graph, other.id)];
        let multiply = Op::Element(Element::Mul);
        let location = Location::caller();
        let product: Array<A::Out> =
            Array::<A>::broadcast_together(&self.graph, multiply, "dot", &operands, location);
        product.sum_channels()
    }

    /// The vector of channels divided by its length; NaN for the zero vector.
    #[track_caller]
    pub fn normalize(&self) -> Array<A> {
        let inverse: Array<A> = self
            .unary(Element::Square, Location::caller())
            .sum_channels()
            .rsqrt();
        self.raw(&inverse, Element::Mul, Location::caller())
    }

    /// Channels of all `parts`, one after another.
    #[track_caller]
    pub fn stack(parts: &[&Array<A>]) -> Array<A> {
        let location = Location::caller();
        let Some(first) = parts.first() else {
            let graph = super::Graph::new();
            let nothing: Array<A> = graph.constant(0.0);
            nothing.reject("stack", location, "give at least one value");
            return nothing;
        };
        // Domain and axis broadcast as in arithmetic.
        let operands: Vec<_> = parts.iter().map(|part| (&part.graph, part.id)).collect();
        let common = first
            .graph
            .common_shape("stack", &operands, false, location);
        let Some(shape) = common else {
            return (*first).clone();
        };
        let inputs: Vec<_> = parts
            .iter()
            .map(|part| {
                first
                    .graph
                    .broadcast(part.id, shape.domain, shape.axis, location)
            })
            .collect();
        let channels = parts.iter().map(|part| part.channels()).sum();
        let id = first
            .graph
            .push(Op::Stack, inputs, Shape { channels, ..shape }, location);
        Array::from_id(&first.graph, id)
    }

    pub(super) fn unary(&self, element: Element, location: &'static Location<'static>) -> Array<A> {
        self.derive(Op::Element(element), self.shape(), location)
    }

    fn binary<B: Kind>(
        &self,
        other: &Array<B>,
        element: Element,
        location: &'static Location<'static>,
    ) -> Array<A::Out>
    where
        A: Join<B>,
    {
        self.raw(other, element, location)
    }

    /// A binary operation whose kind the caller knows.
    fn raw<B, N>(
        &self,
        other: &Array<B>,
        element: Element,
        location: &'static Location<'static>,
    ) -> Array<N> {
        Array::<A>::elementwise(
            &self.graph,
            element,
            &[(&self.graph, self.id), (&other.graph, other.id)],
            location,
        )
    }
}
