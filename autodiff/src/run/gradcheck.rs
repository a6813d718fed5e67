//! Checks the derivatives of a program, for those who write operations of their own.

use std::fmt;

use super::workspace::Workspace;
use crate::error::RunError;
use crate::graph::Op;
use crate::program::Program;

/// How to check: seeds and tolerances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GradCheck {
    /// Seed of the directions.
    pub seed: u64,
    /// Step of the differences, relative to the size of a parameter's elements.
    pub step: f64,
    /// How far differences and derivatives may be apart, relative to their size, beyond what rounding makes of differences.
    pub difference_tolerance: f64,
    /// How far forward and reverse may be apart.
    pub transpose_tolerance: f64,
}

impl Default for GradCheck {
    fn default() -> Self {
        GradCheck {
            seed: 1,
            step: 1e-4,
            difference_tolerance: 1e-6,
            transpose_tolerance: 1e-11,
        }
    }
}

/// What was found for one parameter, along a random direction. Errors are relative to the derivative; those against differences
/// are what is left after rounding of the values that were subtracted.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamCheck {
    /// The parameter.
    pub name: String,
    /// Directional derivative by fourth-order central differences.
    pub by_differences: f64,
    /// The same in forward mode.
    pub forward: f64,
    /// The same in reverse mode: the gradient times the direction.
    pub reverse: f64,
    /// Between forward mode and differences.
    pub difference_error: f64,
    /// Between forward and reverse mode (the dot-product test).
    pub transpose_error: f64,
    /// Between the Hessian-vector product and differences of gradients; `None` if an operation has first derivatives only.
    pub hessian_error: Option<f64>,
}

/// The result of [`Program::gradcheck`].
#[derive(Clone, Debug, PartialEq)]
pub struct GradReport {
    /// One entry for each parameter that outputs depend on.
    pub params: Vec<ParamCheck>,
    /// What was asked.
    pub asked: GradCheck,
}

impl GradReport {
    /// Whether all errors are within the tolerances.
    pub fn passed(&self) -> bool {
        self.params.iter().all(|param| self.is_sound(param))
    }

    fn is_sound(&self, param: &ParamCheck) -> bool {
        // Not a number compares as false.
        param.difference_error <= self.asked.difference_tolerance
            && param.transpose_error <= self.asked.transpose_tolerance
            && param
                .hessian_error
                .is_none_or(|error| error <= self.asked.difference_tolerance)
    }
}

impl fmt::Display for GradReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for param in &self.params {
            let verdict = match self.is_sound(param) {
                true => "ok",
                false => "WRONG",
            };
            write!(
                f,
                "{verdict}: `{}` differences {:.9e}, forward {:.9e}, reverse {:.9e}; errors {:.1e}, {:.1e}",
                param.name,
                param.by_differences,
                param.forward,
                param.reverse,
                param.difference_error,
                param.transpose_error
            )?;
            match param.hessian_error {
                Some(error) => writeln!(f, ", Hessian {error:.1e}")?,
                None => writeln!(f, ", first order only")?,
            }
        }
        Ok(())
    }
}

impl Program {
    /// Checks the derivatives of `output` at what is bound: forward mode against differences, reverse against forward mode
    /// (the dot-product test), Hessian-vector products against differences of gradients; each parameter by itself, along
    /// random directions and with a random cotangent. Parameters keep their values.
    ///
    /// Differences are wrong at kinks, and across [`crate::Array::detach`] by design: check away from the former, and with
    /// samples held fixed.
    ///
    /// ```
    /// use autodiff::{GradCheck, Graph, Sizes};
    ///
    /// let g = Graph::new();
    /// let lane = g.domain("lane");
    /// let x = g.param("x", &lane, 1);
    /// let program = g.compile(&[("y", &(x.sin() * x.exp()))])?;
    /// let mut ws = program.workspace::<f64>(&Sizes::new().lanes("lane", 3))?;
    /// ws.set("x", &[0.1, 0.7, -2.0])?;
    /// let report = program.gradcheck(&mut ws, "y", &GradCheck::default())?;
    /// assert!(report.passed(), "{report}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`Program::jvp`] and [`Program::vjp`].
    pub fn gradcheck(
        &self,
        ws: &mut Workspace<f64>,
        output: &str,
        asked: &GradCheck,
    ) -> Result<GradReport, RunError> {
        self.forward(ws)?;
        let weights = directions(asked.seed, ws.output(output)?.len());
        // Parameters that nothing depends on may be unbound.
        let nodes = self.nodes.iter().zip(&self.used);
        let used = nodes.filter(|(node, used)| **used && matches!(node.op, Op::Param));
        let names: Vec<String> = used.filter_map(|(node, _)| node.name.clone()).collect();
        let mut params = Vec::new();
        for (k, name) in names.iter().enumerate() {
            let at = ws.value(name)?.to_vec();
            let direction = directions(asked.seed + 1 + k as u64, at.len());
            let checked = self.check_param(ws, output, asked, name, &at, &direction, &weights);
            // The value goes back, whatever happened.
            ws.set(name, &at)?;
            params.push(checked?);
        }
        Ok(GradReport {
            params,
            asked: *asked,
        })
    }

    fn check_param(
        &self,
        ws: &mut Workspace<f64>,
        output: &str,
        asked: &GradCheck,
        name: &str,
        at: &[f64],
        direction: &[f64],
        weights: &[f64],
    ) -> Result<ParamCheck, RunError> {
        self.jvp(ws, &[(name, direction)])?;
        let forward = dot(weights, ws.tangent(output)?);
        self.vjp_with(ws, &[(output, weights)])?;
        let gradient = ws.gradient(name)?.to_vec();
        let reverse = dot(&gradient, direction);
        let size: f64 = gradient
            .iter()
            .zip(direction)
            .map(|(g, v)| (g * v).abs())
            .sum();
        let span = weights
            .iter()
            .zip(ws.output(output)?)
            .map(|(w, y)| (w * y).abs());
        let scale = span.sum::<f64>();

        let largest = at.iter().fold(1.0f64, |largest, x| largest.max(x.abs()));
        let h = asked.step * largest;
        let mut value = |step: f64| -> Result<f64, RunError> {
            ws.set(name, &moved(at, direction, step * h))?;
            self.forward(ws)?;
            Ok(dot(weights, ws.output(output)?))
        };
        let by_differences = stencil(&mut value)? / h;

        let mut product = |step: f64| -> Result<Vec<f64>, RunError> {
            ws.set(name, &moved(at, direction, step * h))?;
            self.vjp(ws, output)?;
            Ok(ws.gradient(name)?.to_vec())
        };
        let sides = [product(1.0)?, product(-1.0)?, product(2.0)?, product(-2.0)?];
        ws.set(name, at)?;
        let hessian_error = match self.hvp(ws, output, &[(name, direction)]) {
            Ok(()) => {
                let exact = ws.hessian_product(name)?;
                let by_differences = (0..at.len()).map(|i| {
                    (8.0 * (sides[0][i] - sides[1][i]) - (sides[2][i] - sides[3][i])) / (12.0 * h)
                });
                let error = by_differences.zip(exact).map(|(a, b)| (a - b).powi(2));
                let rounding = ROUNDING * norm(&sides[0]).max(norm(&sides[1])) / h;
                Some(relative(error.sum::<f64>().sqrt(), rounding, norm(exact)))
            }
            Err(RunError::FirstOrderOnly { .. }) => None,
            Err(error) => return Err(error),
        };
        Ok(ParamCheck {
            name: name.to_string(),
            by_differences,
            forward,
            reverse,
            difference_error: relative(
                (by_differences - forward).abs(),
                ROUNDING * scale / h,
                size,
            ),
            transpose_error: relative((forward - reverse).abs(), 0.0, size),
            hessian_error,
        })
    }
}

/// How far a value, or a gradient, may be off by rounding, relative to its size.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// What is left of an error beyond rounding, relative to the size of a derivative; NaN stays NaN.
fn relative(error: f64, rounding: f64, size: f64) -> f64 {
    match error <= rounding {
        true => 0.0,
        false => (error - rounding) / size.max(f64::MIN_POSITIVE),
    }
}

/// Fourth-order central difference, times the step.
fn stencil(value: &mut impl FnMut(f64) -> Result<f64, RunError>) -> Result<f64, RunError> {
    Ok((8.0 * (value(1.0)? - value(-1.0)?) - (value(2.0)? - value(-2.0)?)) / 12.0)
}

fn moved(at: &[f64], direction: &[f64], step: f64) -> Vec<f64> {
    let pairs = at.iter().zip(direction);
    pairs.map(|(x, v)| x + step * v).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// Reproducible numbers in (-1, 1), none near 0.
fn directions(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let number = |_| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let unit = (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        unit + 0.5f64.copysign(unit)
    };
    (0..n).map(number).collect()
}
