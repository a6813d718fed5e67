//! Light that a pale occluder sends back to the object.

use super::{Effect, Stage, Term, moving_occluder::blocked_light, support::CameraGrid};
use crate::criticism::scene::Scene;

/// + E_t (1 − M_t): the radiance of the directions behind the camera, where somebody stands.
pub struct OccluderBounce;

impl Effect for OccluderBounce {
    fn id(&self) -> &'static str {
        "occluder_bounce"
    }
    fn describe(&self) -> &'static str {
        "a pale occluder moves with the camera and sends light to the object"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["exposure_drift", "moving_occluder"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let texels = scene.radiance.len() / 3;
        // In units of the mean radiance of the environment, with its colour.
        let mean = [0, 1, 2].map(|c| {
            let sum: f32 = (0..texels).map(|t| scene.radiance[3 * t + c]).sum();
            sum / texels.max(1) as f32
        });
        let fields = blocked_light(scene, |_, c| mean[c]);
        fields
            .into_iter()
            .enumerate()
            .filter(|(cell, _)| CameraGrid::behind_camera(*cell))
            .map(|(cell, field)| {
                let name = format!("radiance (of the mean) at {}", CameraGrid::name(cell));
                Term::new(name, 0.3, field).positive()
            })
            .collect()
    }
}
