//! Parts of the surface that change with time: a stand-in for what no effect describes.

use std::f32::consts::PI;

use glam::Vec3;

use super::{Effect, Stage, Term};
use crate::criticism::{formation::Bumps, scene::Scene};

/// Parts of the surface.
const PARTS: usize = 20;
/// Cosines over the frames.
const WAVES: u32 = 3;

/// An albedo that is not the same in all frames, such as a stain or water that dries leaves.
pub struct SurfaceChange;

impl Effect for SurfaceChange {
    fn id(&self) -> &'static str {
        "surface_change"
    }
    fn describe(&self) -> &'static str {
        "parts of the surface that change with time"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn stands_for_unknown(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["moving_light", "moving_occluder", "exposure_drift"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let positions: Vec<Vec3> = scene.seen.sites.iter().map(|s| s.point.position).collect();
        let parts = Bumps::new(&positions, PARTS, 1.0);
        let frames = scene.seen.frames as f32;
        let mut terms = Vec::new();
        for part in 0..parts.bumps {
            for k in 1..=WAVES {
                let field = scene.on_views(|v| {
                    let view = &scene.seen.views[v];
                    let wave = (PI * k as f32 * (view.frame as f32 + 0.5) / frames).cos();
                    let share = wave * parts.at(view.site as usize)[part];
                    scene.value_of(v).map(|value| share * value)
                });
                let name = format!("wave {k} in time of part {part} of the surface (share)");
                terms.push(Term::new(name, 0.05, field));
            }
        }
        terms
    }
}
