//! A constant that the sensor adds to every value.

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

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
}
