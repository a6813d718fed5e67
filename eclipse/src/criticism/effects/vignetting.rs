//! Light lost towards the corners of the image.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term, weighted};
use crate::criticism::scene::Scene;

/// 1 + a r² + b r⁴, with r = 1 in the corners.
pub struct Vignetting;

impl Effect for Vignetting {
    fn id(&self) -> &'static str {
        "vignetting"
    }
    fn describe(&self) -> &'static str {
        "the image darkens from its middle outwards"
    }
    fn stage(&self) -> Stage {
        Stage::Falloff
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["medium", "near_field_light", "veiling_glare"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let squared = |i: usize| {
            let camera = &scene.capture.frames[scene.seen.frame(i) as usize].camera;
            let [x, y] = scene.seen.at(i);
            let (dx, dy) = (x - camera.principal[0], y - camera.principal[1]);
            let (w, h) = (0.5 * camera.width as f32, 0.5 * camera.height as f32);
            (dx * dx + dy * dy) / (w * w + h * h)
        };
        vec![
            Term::new(
                "a: per r², r = 1 in the corners",
                0.3,
                scene.everywhere(|i| [squared(i); 3]),
            ),
            Term::new(
                "b: per r⁴",
                0.3,
                scene.everywhere(|i| [squared(i).powi(2); 3]),
            ),
        ]
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        match weighted(terms) {
            Some(sum) => value * sum.affine(1.0, 1.0),
            None => value.clone(),
        }
    }
}
