//! A constant that the sensor adds to every value.

use super::{Effect, Stage, Term, camera_map::CameraMap};
use crate::{capture::Capture, criticism::scene::Scene};

/// + b_c.
pub struct BlackLevel;

impl Effect for BlackLevel {
    fn id(&self) -> &'static str {
        "black_level"
    }
    fn describe(&self) -> &'static str {
        "a constant is added to all values"
    }
    fn stage(&self) -> Stage {
        Stage::Offset
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["veiling_glare", "emission", "medium"]
    }
    fn shown_by(&self) -> &'static str {
        "take one photograph with the lens covered: what it holds is the sensor's"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let scale = 0.05 * f64::from(scene.typical());
        ["red", "green", "blue"]
            .iter()
            .enumerate()
            .map(|(k, name)| {
                let mut rgb = [0.0; 3];
                rgb[k] = 1.0;
                Term::new(format!("{name} (value)"), scale, scene.everywhere(|_| rgb))
            })
            .collect()
    }
    fn is_of_the_camera(&self) -> bool {
        true
    }
    fn camera_map(&self, _capture: &Capture, numbers: &[f64]) -> Option<CameraMap> {
        let &[r, g, b] = numbers else { return None };
        let offset = [r, g, b].map(|v| v as f32);
        Some(CameraMap::pixelwise(
            move |_, _, rgb| std::array::from_fn(|c| rgb[c] + offset[c]),
            move |_, _, rgb| std::array::from_fn(|c| rgb[c] - offset[c]),
        ))
    }
}
