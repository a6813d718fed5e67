//! Values that depend on how the surface faces the camera in any way: a stand-in for what no effect describes.

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// Hats over the cosine between normal and camera.
const HATS: usize = 6;
/// The least cosine there is.
const LEAST: f32 = 0.3;

/// A share of the value, and light of its own, by the cosine between normal and camera, as a lamp on the camera, dust or a coat
/// leave them.
pub struct ViewDependence;

impl Effect for ViewDependence {
    fn id(&self) -> &'static str {
        "view_dependence"
    }
    fn describe(&self) -> &'static str {
        "values that follow how the surface faces the camera"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn stands_for_unknown(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["specular_lobe", "medium", "defocus"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let typical = scene.typical();
        let hat = |v: usize, k: usize| {
            let normal = scene.seen.sites[scene.seen.views[v].site as usize]
                .point
                .normal;
            let facing = normal.dot(scene.outgoing(v));
            let at = (facing - LEAST) / (1.0 - LEAST) * (HATS - 1) as f32;
            (1.0 - (at - k as f32).abs()).max(0.0)
        };
        (0..HATS)
            .flat_map(|k| {
                let share = scene.on_views(|v| scene.value_of(v).map(|value| hat(v, k) * value));
                let added = scene.on_views(|v| [hat(v, k) * typical; 3]);
                let cosine = LEAST + (1.0 - LEAST) * k as f32 / (HATS - 1) as f32;
                [
                    Term::new(format!("share at n·v = {cosine:.2}"), 0.05, share),
                    Term::new(
                        format!("light (of the middle value) at n·v = {cosine:.2}"),
                        0.05,
                        added,
                    ),
                ]
            })
            .collect()
    }
}
