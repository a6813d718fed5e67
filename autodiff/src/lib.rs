//! Automatic differentiation of array programs on the CPU: record once, run by blocks.
//!
//! Made for differentiable renderers, of which it knows nothing: values live on *domains* (pixels, samples, texels ..), change
//! domain by explicit operations (expand and segment sums, gathers, linear maps), and detached values cannot carry gradient
//! by accident. A compiled [`Program`] runs forward ([`Program::forward`]), in reverse ([`Program::vjp`]), along a direction
//! ([`Program::jvp`]), and as the Gauss-Newton product of both ([`Program::gauss_newton`]), in `f32` or `f64`. Results are
//! bit-identical for any number of threads and any block size.
//!
//! # A tour
//! ```
//! use autodiff::{Graph, Sizes};
//!
//! // Record: pixels have samples, samples look up texels.
//! let g = Graph::new();
//! let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
//! let sample = g.segments("sample", &pixel);
//! let albedo = g.param("albedo", &pixel, 3);
//! let environment = g.param("environment", &texel, 3);
//! let direction = g.index("direction", &sample, &texel);
//! let cosine = g.input("cosine", &sample, 1);
//! let visible = g.mask("visible", &sample);
//! let target = g.input("target", &pixel, 3);
//!
//! let light = visible.select_or_zero(&(environment.gather(&direction) * &cosine));
//! let residual = light.segment_mean() * &albedo - &target;
//! let loss = residual.square().sum();
//! let program = g.compile(&[("loss", &loss), ("residual", &residual)])?;
//!
//! // Bind: two pixels of three samples, four texels.
//! let sizes = Sizes::new().lanes("pixel", 2).lanes("texel", 4).per_parent("sample", 3);
//! let mut ws = program.workspace::<f32>(&sizes)?;
//! ws.set("albedo", &[0.5; 6])?;
//! ws.set("environment", &[1.0; 12])?;
//! ws.set("cosine", &[0.8; 6])?;
//! ws.set("target", &[0.3; 6])?;
//! ws.set_index("direction", &[0, 1, 2, 1, 1, 3])?;
//! ws.set_mask("visible", &[true, true, false, true, false, true])?;
//!
//! // Run.
//! program.vjp(&mut ws, "loss")?;
//! assert!((ws.output("loss")?[0] - 6.0 * (0.8 * 0.5 * 2.0 / 3.0 - 0.3f32).powi(2)).abs() < 1e-6);
//! assert_eq!(ws.gradient("environment")?[2], 0.0); // only a hidden sample looks there
//!
//! let step = [0.1; 6];
//! program.gauss_newton(&mut ws, "residual", &[("albedo", &step)], None)?;
//! assert_eq!(ws.gradient("albedo")?.len(), 6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Guides
//! - [`guide::detaching`]: what to detach, and the bias if you do not, measured.
//! - [`guide::migration`]: idioms of Dr.Jit, JAX and PyTorch.
//! - [`guide::speed`]: how fast it is, against what, and where the time goes.
//! - The examples make pictures: a soft shadow, photometric stereo, a Monte Carlo volume.
//!
//! # How it runs
//! A graph is simplified, cut into phases where a value must be known for all lanes before the next can be computed, and each
//! phase runs over blocks of lanes on all threads; elementwise operations, expansions, gathers and sums run tile by tile within
//! a block, so that what they hand to each other stays in L1. Vector instructions are chosen when the program runs: AVX-512 or
//! AVX2 where there are any, whatever the compiler was told.
//!
//! # Singularities and kinks
//! A derivative of exactly 0 contributes exactly 0, whatever it is multiplied with, in both directions and in every operation: the
//! branch of a [`Mask::select`] that is not taken contributes nothing, even if it holds a NaN, and a lane whose result is masked
//! adds nothing to the weights of a network. What is not masked is not clamped either; [`Program::find_non_finite`] tells where a
//! NaN or an infinity in an output began, [`Program::find_non_finite_gradient`] the same of a gradient, and
//! [`Program::find_singularities`] (strict mode) every place where a derivative was infinite, masked or not.
//!
//! Derivatives are those in reverse; forward they are the same, but for `x * y.recip()`: by `y` it is NaN forward, where the zero that
//! comes in is not seen to be one of `x`. Each row is a test, in both precisions, forward, in reverse and in second derivatives.
//!
//! | operation | value | derivative |
//! | --- | --- | --- |
//! | `sqrt` at 0; below | 0; NaN | infinite; NaN |
//! | `rsqrt` at 0; below | infinite; NaN | minus infinity; NaN |
//! | `recip`, and a number over 0 | infinite | minus infinity |
//! | `x / 0`: `x` not 0; 0 | infinite; NaN | infinite by `x`; by the divisor infinite; NaN |
//! | `x * y.recip()` where both are 0 | NaN | infinite by `x`, 0 by `y` |
//! | `ln` at 0; below | minus infinity; NaN | infinite; `1 / x` |
//! | `pow` at base 0: exponent below 0; 0; in (0, 1); 1; above | infinite; 1; 0; 0; 0 | by the base minus infinity; 0; infinite; 1; 0, by the exponent 0 |
//! | `pow` of a negative base: exponent 0; 1; others | 1; NaN; NaN | by the base 0; 1; NaN, by the exponent NaN |
//! | `powi` at 0: exponent 0; below | 1; infinite | 0; minus infinity |
//! | `exp` where it overflows; underflows | infinite; 0 | infinite; 0 |
//! | `ln` of infinity | infinite | 0 |
//! | `sigmoid` far from 0: below; above | 0; 1 | 0 |
//! | `softplus` far from 0: below; above | 0; `x` | 0; 1 |
//! | `sin`, `cos` of infinity | NaN | NaN |
//! | `x * y` of 0 and infinity | NaN | infinite by the one that is 0, 0 by the other |
//! | `acos` at -1 and 1; beyond | pi, 0; NaN | minus infinity; NaN |
//! | `atan2` at (0, 0) | 0 | NaN |
//! | `normalize` of the zero vector | NaN | infinite |
//! | `log_sum_exp` of minus infinities alone | NaN | NaN |
//! | `abs`, `relu` at 0 | 0 | 0 |
//! | `abs`, `relu`, `clamp` of NaN | NaN | 0, 0, 1 |
//! | `clamp` at a bound | the bound | 1 |
//! | `min`, `max` at a tie | either | all of it to the first operand |
//! | `min`, `max` of a NaN and a number | the first operand | all of it to the first operand |
//! | `select` by `lt`, `le` or `gt_scalar` of a NaN; by `!` of that | the second branch; the first | all of it to that branch |
//!
//! Mistakes in formulas are returned by [`Graph::compile`], with both operands and the place in the source; mistakes in what
//! is bound are returned when it is bound.

mod buffer;
mod custom;
mod dual;
mod error;
mod graph;
pub mod guide;
mod linear_map;
mod math;
mod op;
mod packed;
mod program;
mod real;
mod run;

pub use custom::{CustomOp, CustomVecOp, FirstOrderOnly};
pub use dual::Dual;
pub use error::{GraphError, RunError};
pub use graph::{
    Array, Axis, Detached, Differentiable, Domain, Fixed, Graph, Index, Join, Kind, Mask, Var,
};
pub use linear_map::LinearMap;
pub use program::Program;
pub use real::{Fma, Real, Scalar};
pub use run::{
    Explanation, GradCheck, GradReport, Memory, NodeCost, NonFinite, NonFiniteAdjoint, ParamCheck,
    Singularity, Sizes, Workspace,
};
