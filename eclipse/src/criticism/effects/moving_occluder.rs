//! Somebody or something that moves with the camera and stands in the light.

use rayon::prelude::*;
use render::occluder::shell_direction;

use super::{Effect, Stage, Term, support::CameraGrid};
use crate::criticism::scene::Scene;

/// 1 − m_t(ω), m ≥ 0: opacity of the cells of a grid that turns with the camera, on the shell at the camera's distance.
///
/// Opacity is linear in the image, so that its gradient does not vanish where nothing is blocked yet.
pub struct MovingOccluder;

impl Effect for MovingOccluder {
    fn id(&self) -> &'static str {
        "moving_occluder"
    }
    fn describe(&self) -> &'static str {
        "an unseen occluder moves with the camera and takes light away"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["exposure_drift", "moving_light", "occluder_bounce"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        blocked_light(scene, |texel, c| scene.radiance[3 * texel + c])
            .into_iter()
            .enumerate()
            .map(|(cell, mut field)| {
                field.iter_mut().for_each(|f| *f = -*f);
                let name = format!("opacity at {}", CameraGrid::name(cell));
                let scale = if CameraGrid::behind_camera(cell) {
                    0.5
                } else {
                    0.15
                };
                Term::new(name, scale, field).positive()
            })
            .collect()
    }
}

/// For every cell of the camera's grid, what light of radiance `light(texel, colour)` from it adds to each view.
pub(super) fn blocked_light(
    scene: &Scene<'_>,
    light: impl Fn(usize, usize) -> f32 + Sync,
) -> Vec<Vec<f32>> {
    let azimuths: Vec<[f32; 2]> = scene
        .seen
        .eyes
        .iter()
        .map(|eye| {
            let length = (eye.x * eye.x + eye.y * eye.y).sqrt().max(1e-9);
            [eye.x / length, eye.y / length]
        })
        .collect();
    let per_view: Vec<Vec<[f32; 3]>> = (0..scene.seen.views.len())
        .into_par_iter()
        .map(|v| {
            let view = &scene.seen.views[v];
            let point = scene.seen.sites[view.site as usize].point.position;
            let eye = scene.seen.eyes[view.frame as usize];
            let albedo = scene.albedo_of(v);
            let mut cells = vec![[0.0f32; 3]; CameraGrid::CELLS];
            for (texel, [d, s]) in scene.transport.row(v) {
                let from = shell_direction(point, scene.horizon.directions[texel], eye.length());
                let sum = &mut cells[CameraGrid::cell(from, azimuths[view.frame as usize])];
                for c in 0..3 {
                    sum[c] += (albedo[c] * d + s) * light(texel, c);
                }
            }
            cells
        })
        .collect();
    (0..CameraGrid::CELLS)
        .map(|cell| scene.on_views(|v| per_view[v][cell]))
        .collect()
}
