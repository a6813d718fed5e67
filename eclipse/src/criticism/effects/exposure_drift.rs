//! Exposure and white balance that differ between frames.

use autodiff::Var;

use super::{Effect, Recorded, Stage, Term, camera_map::CameraMap, weighted};
use crate::{capture::Capture, criticism::scene::Scene};

/// e^{g_t,c}: a gain of each frame, and two of its colours.
pub struct ExposureDrift;

/// Name, usual strength and weights of a frame's numbers: luminance, red against blue, green against the others.
const COLOURS: [(&str, f64, [f32; 3]); 3] = [
    ("gain", 0.1, [1.0, 1.0, 1.0]),
    ("red against blue", 0.03, [1.0, 0.0, -1.0]),
    ("green against the rest", 0.03, [-0.5, 1.0, -0.5]),
];

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
    fn shown_by(&self) -> &'static str {
        "take the same views with exposure and white balance locked, or with a gray card in each that nothing shades"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
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
    fn is_of_the_camera(&self) -> bool {
        true
    }
    fn camera_map(&self, capture: &Capture, numbers: &[f64]) -> Option<CameraMap> {
        if numbers.len() != COLOURS.len() * capture.frames.len() {
            return None;
        }
        let gain = |of_frame: &[f64]| -> [f32; 3] {
            std::array::from_fn(|c| {
                let parts = COLOURS.iter().zip(of_frame);
                let log: f64 = parts.map(|((_, _, rgb), g)| g * f64::from(rgb[c])).sum();
                log.exp() as f32
            })
        };
        let gains: Vec<[f32; 3]> = numbers.chunks_exact(COLOURS.len()).map(gain).collect();
        Some(CameraMap::gains(move |frame, _| gains[frame]))
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        match weighted(terms) {
            Some(sum) => value * sum.exp(),
            None => value.clone(),
        }
    }
}
