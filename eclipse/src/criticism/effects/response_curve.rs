//! Values that are not proportional to light.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term};
use crate::criticism::scene::Scene;

/// I · exp(γ₁ u + γ₂ u² + γ₃ u³) with u = ln(I / I₀): the first mode is I^{1+γ}, the others bend it.
pub struct ResponseCurve;

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
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        let Some(first) = terms.first() else {
            return value.clone();
        };
        // Levels a thousandth of the middle and less count as one: their logarithm means nothing.
        let u = (value.clone().clamp(1e-6, 1e6).ln() - &first.field).clamp(-4.0, 4.0);
        let mut power = u.clone();
        let mut exponent = &first.beta * &power;
        for term in &terms[1..] {
            power = power * &u;
            exponent = exponent + &term.beta * &power;
        }
        value * exponent.exp()
    }
}
