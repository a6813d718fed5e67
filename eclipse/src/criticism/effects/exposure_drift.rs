//! Exposure and white balance that differ between frames.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term, weighted};
use crate::criticism::scene::Scene;

/// e^{g_t,c}: a gain of each frame, and two of its colours.
pub struct ExposureDrift;

impl Effect for ExposureDrift {
    fn id(&self) -> &'static str {
        "exposure_drift"
    }
    fn describe(&self) -> &'static str {
        "exposure or white balance differs between frames"
    }
    fn stage(&self) -> Stage {
        Stage::Exposure
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["moving_occluder", "moving_light", "response_curve"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // Luminance, red against blue, green against the others.
        const COLOURS: [(&str, f64, [f32; 3]); 3] = [
            ("gain", 0.1, [1.0, 1.0, 1.0]),
            ("red against blue", 0.03, [1.0, 0.0, -1.0]),
            ("green against the rest", 0.03, [-0.5, 1.0, -0.5]),
        ];
        (0..scene.seen.frames as u32)
            .flat_map(|t| {
                COLOURS.map(|(name, scale, rgb)| {
                    let field = scene.everywhere(|i| {
                        if scene.seen.frame(i) == t {
                            rgb
                        } else {
                            [0.0; 3]
                        }
                    });
                    Term::new(format!("{name} of frame {t} (log)"), scale, field).of(t)
                })
            })
            .collect()
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        match weighted(terms) {
            Some(sum) => value * sum.exp(),
            None => value.clone(),
        }
    }
}
