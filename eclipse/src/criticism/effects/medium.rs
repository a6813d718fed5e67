//! Air that is not clear.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term};
use crate::criticism::scene::Scene;

/// e^{−σ d} and airlight: what is further is dimmer, and paler. Neither is ever negative: no air sharpens.
pub struct Medium;

impl Effect for Medium {
    fn id(&self) -> &'static str {
        "medium"
    }
    fn describe(&self) -> &'static str {
        "haze between the object and the camera"
    }
    fn stage(&self) -> Stage {
        Stage::Medium
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["vignetting", "black_level", "veiling_glare"]
    }
    fn shown_by(&self) -> &'static str {
        "photograph the object in the middle of the image from twice the distance: haze doubles"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let mut distances: Vec<f64> = (0..scene.seen.views.len())
            .map(|v| f64::from(scene.seen.distance(&scene.seen.views[v])))
            .collect();
        let middle = crate::criticism::statistics::median(&mut distances) as f32;
        if middle.is_nan() {
            return Vec::new();
        }
        // In object radii, from the middle distance: a constant loss is the exposure's.
        let depth = |v: usize| (scene.seen.distance(&scene.seen.views[v]) - middle) / scene.radius;
        let airlight = 0.5 * scene.typical();
        let mut terms = vec![
            Term::new(
                "extinction (per radius of the object)",
                0.05,
                scene.on_views(|v| [-depth(v); 3]),
            )
            .positive(),
        ];
        for (c, name) in ["red", "green", "blue"].iter().enumerate() {
            let field = scene.on_views(|v| {
                let mut rgb = [0.0; 3];
                rgb[c] = airlight * depth(v);
                rgb
            });
            terms.push(Term::new(format!("airlight, {name}"), 0.05, field).positive());
        }
        terms
    }
    fn is_of_one_sum(&self) -> bool {
        false
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        let Some((first, air)) = terms.split_first() else {
            return value.clone();
        };
        let dimmed = value * (&first.beta * &first.field).exp();
        air.iter()
            .fold(dimmed, |out, term| out + &term.beta * &term.field)
    }
}
