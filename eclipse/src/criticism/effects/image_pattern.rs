//! Values that differ over the image in any smooth way, anew in every frame: a stand-in for what no effect describes.

use std::f32::consts::PI;

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// Cosines down and across the image.
const WAVES: [(usize, &str, u32); 2] = [(1, "down", 6), (0, "across", 3)];

/// A gain made of low waves over the image, such as a shutter that rolls under lamps that flicker leaves.
pub struct ImagePattern;

impl Effect for ImagePattern {
    fn id(&self) -> &'static str {
        "image_pattern"
    }
    fn describe(&self) -> &'static str {
        "a pattern over the image, another in every frame"
    }
    fn stage(&self) -> Stage {
        Stage::Exposure
    }
    fn stands_for_unknown(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["exposure_drift", "vignetting", "moving_occluder"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let mut terms = Vec::new();
        for t in 0..scene.seen.frames as u32 {
            let image = &scene.capture.frames[t as usize].image;
            let size = [image.width as f32, image.height as f32];
            for (axis, along, most) in WAVES {
                for k in 1..=most {
                    let field = scene.on_views(|v| {
                        let view = &scene.seen.views[v];
                        if view.frame != t {
                            return [0.0; 3];
                        }
                        let wave = (PI * k as f32 * view.at[axis] / size[axis]).cos();
                        scene.value_of(v).map(|value| wave * value)
                    });
                    let name = format!("wave {k} {along} the image in frame {t} (share)");
                    terms.push(Term::new(name, 0.03, field).of(t));
                }
            }
        }
        terms
    }
}
