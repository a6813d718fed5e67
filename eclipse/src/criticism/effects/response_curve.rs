//! Values that are not proportional to light.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term, camera_map::CameraMap};
use crate::{capture::Capture, criticism::scene::Scene};

/// I · exp(γ₁ u + γ₂ u² + γ₃ u³) with u = ln(I / I₀): the first mode is I^{1+γ}, the others bend it.
pub struct ResponseCurve;

/// Beyond this many units of log level from the middle the exponent no longer changes.
const REACH: f64 = 4.0;

impl Effect for ResponseCurve {
    fn id(&self) -> &'static str {
        "response_curve"
    }
    fn describe(&self) -> &'static str {
        "photographs' values are not proportional to light"
    }
    fn stage(&self) -> Stage {
        Stage::Response
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["clipping", "finer_albedo", "specular_lobe", "emission"]
    }
    fn shown_by(&self) -> &'static str {
        "take one view at three exposures from a tripod, or as a raw file: values that are not in proportion to the exposure are the curve's"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // The field holds ln I₀: light at which nothing changes.
        let log = scene.typical().ln();
        let field = || vec![log; scene.size()];
        vec![
            Term::new("γ: exponent 1 + γ", 0.2, field()),
            Term::new("second mode (per unit of log² level)", 0.05, field()),
            Term::new("third mode (per unit of log³ level)", 0.02, field()),
        ]
    }
    fn is_of_the_camera(&self) -> bool {
        true
    }
    fn camera_numbers(&self, terms: &[Term], beta: &[f64]) -> Vec<f64> {
        let middle = terms.first().and_then(|term| term.field.first());
        let middle = middle.map(|&log| f64::from(log));
        beta.iter().copied().chain(middle).collect()
    }
    fn camera_map(&self, _capture: &Capture, numbers: &[f64]) -> Option<CameraMap> {
        let &[g1, g2, g3, middle] = numbers else {
            return None;
        };
        let exponent = move |u: f64| u * (g1 + u * (g2 + u * g3));
        let curve = Curve::new(&|u| u + exponent(u));
        let log = move |v: f32| f64::from(v.max(1e-6)).ln() - middle;
        Some(CameraMap::pixelwise(
            move |_, _, rgb| rgb.map(|v| v * exponent(log(v).clamp(-REACH, REACH)).exp() as f32),
            move |_, _, rgb| {
                rgb.map(|v| {
                    let recorded = log(v);
                    v * (curve.inverse(recorded) - recorded).exp() as f32
                })
            },
        ))
    }
    fn is_of_one_sum(&self) -> bool {
        false
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        let Some(first) = terms.first() else {
            return value.clone();
        };
        // Levels a thousandth of the middle and less count as one: their logarithm means nothing.
        let u = (value.clone().clamp(1e-6, 1e6).ln() - &first.field).clamp(-REACH, REACH);
        let mut power = u.clone();
        let mut exponent = &first.beta * &power;
        for term in &terms[1..] {
            power = power * &u;
            exponent = exponent + &term.beta * &power;
        }
        value * exponent.exp()
    }
}

/// An increasing function on ±[`REACH`], of slope one outside, as a table.
struct Curve {
    values: Vec<f64>,
}

/// Entries of a [`Curve`].
const ENTRIES: usize = 4097;

impl Curve {
    fn new(of: &dyn Fn(f64) -> f64) -> Self {
        let mut values: Vec<f64> = (0..ENTRIES).map(|k| of(Self::place(k as f64))).collect();
        // What turns back would have no inverse: it stays level there.
        for k in 1..ENTRIES {
            values[k] = values[k].max(values[k - 1] + 1e-9);
        }
        Self { values }
    }

    fn place(entry: f64) -> f64 {
        REACH * (2.0 * entry / (ENTRIES - 1) as f64 - 1.0)
    }

    fn inverse(&self, value: f64) -> f64 {
        let above = self.values.partition_point(|&v| v < value);
        match above {
            0 => -REACH + value - self.values[0],
            ENTRIES => REACH + value - self.values[ENTRIES - 1],
            _ => {
                let (low, high) = (self.values[above - 1], self.values[above]);
                Self::place((above - 1) as f64 + (value - low) / (high - low))
            }
        }
    }
}
