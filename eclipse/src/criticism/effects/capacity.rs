//! No physics, but more freedom for what the model has already: rivals that keep physics honest.

use glam::Vec3;
use rayon::prelude::*;
use render::{lat_long::LatLong, occluder::shell_direction};

use super::{Effect, Stage, Term};
use crate::criticism::{formation::Bumps, light::Light, scene::Scene};

/// Albedo that varies over shorter distances than the texture of the model.
pub struct FinerAlbedo;

/// An environment with more contrast at its finest levels than the prior allows.
pub struct FinerEnvironment;

/// Light taken away from any part of the sky in any frame.
pub struct FinerOccluders;

/// Known lamps whose light varies over the object in any smooth way, anew in every frame.
pub struct FinerLamps;

/// Parts of the surface that a lamp may light more or less.
const LAMP_PARTS: usize = 10;

impl Effect for FinerAlbedo {
    fn id(&self) -> &'static str {
        "finer_albedo"
    }
    fn describe(&self) -> &'static str {
        "texture finer than the model's"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn is_capacity(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["emission", "normal_error", "interreflection"]
    }
    fn shown_by(&self) -> &'static str {
        "take a photograph from nearer: texture that the model has no room for is then as large as its places"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let positions: Vec<Vec3> = scene.seen.sites.iter().map(|s| s.point.position).collect();
        let bumps = Bumps::new(&positions, 420, 1.0);
        // Every second one is far from the texture's own, which are the first of the same sequence.
        (220..bumps.bumps)
            .map(|k| {
                let field = scene.on_views(|v| {
                    let b = bumps.at(scene.seen.views[v].site as usize)[k];
                    [0, 1, 2].map(|c| b * scene.diffuse[3 * v + c])
                });
                Term::new(format!("albedo of bump {k}"), 0.05, field)
            })
            .collect()
    }
}

impl Effect for FinerEnvironment {
    fn id(&self) -> &'static str {
        "finer_environment"
    }
    fn describe(&self) -> &'static str {
        "light with finer detail than the model's"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn is_capacity(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["near_field_light", "normal_error", "specular_lobe"]
    }
    fn shown_by(&self) -> &'static str {
        "photograph a mirror ball in place of the object: its image is the light"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // The brightest texels of the model may be brighter or darker each on their own: fine detail is where light is.
        let Some(grid) = scene.horizon.grid() else {
            return Vec::new();
        };
        let power = |t: usize| {
            let sum: f32 = (0..3).map(|c| scene.radiance[3 * t + c]).sum();
            sum * grid.solid_angle(t / grid.columns)
        };
        let mut texels: Vec<usize> = (0..grid.len()).collect();
        texels.sort_unstable_by(|&a, &b| power(b).total_cmp(&power(a)).then(a.cmp(&b)));
        texels.truncate(64);
        texels
            .into_iter()
            .map(|t| {
                let mut light = vec![0.0; scene.radiance.len()];
                light[3 * t..3 * t + 3].copy_from_slice(&scene.radiance[3 * t..3 * t + 3]);
                let field = scene.lit_by(&light);
                Term::new(format!("radiance of texel {t} (log)"), 0.5, field)
            })
            .collect()
    }
}

impl Effect for FinerOccluders {
    fn id(&self) -> &'static str {
        "finer_occluders"
    }
    fn describe(&self) -> &'static str {
        "light blocked anywhere, anew in every frame"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn is_capacity(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["exposure_drift", "moving_occluder", "moving_light"]
    }
    fn shown_by(&self) -> &'static str {
        "put a mirror ball beside the object in every frame: it shows who stands where"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // Six parts of the sky in every frame.
        let coarse = LatLong::new(2, 3);
        let parts: Vec<Vec<[f32; 3]>> = (0..scene.seen.views.len())
            .into_par_iter()
            .map(|v| {
                let view = &scene.seen.views[v];
                let point = scene.seen.sites[view.site as usize].point.position;
                let radius = scene.seen.eyes[view.frame as usize].length();
                let albedo = scene.albedo_of(v);
                let mut sums = vec![[0.0f32; 3]; coarse.len()];
                for (texel, [d, s]) in scene.transport.row(v) {
                    let from = shell_direction(point, scene.horizon.directions[texel], radius);
                    let sum = &mut sums[coarse.nearest(from)];
                    for c in 0..3 {
                        sum[c] += (albedo[c] * d + s) * scene.radiance[3 * texel + c];
                    }
                }
                sums
            })
            .collect();
        let mut terms = Vec::new();
        for t in 0..scene.seen.frames as u32 {
            for part in 0..coarse.len() {
                let field = scene.on_views(|v| {
                    if scene.seen.views[v].frame == t {
                        parts[v][part].map(|x| -x)
                    } else {
                        [0.0; 3]
                    }
                });
                let name = format!("opacity of part {part} of the sky in frame {t}");
                terms.push(Term::new(name, 0.15, field).positive().of(t));
            }
        }
        terms
    }
}

impl Effect for FinerLamps {
    fn id(&self) -> &'static str {
        "finer_lamps"
    }
    fn describe(&self) -> &'static str {
        "lamps' light varies over the object, anew in every frame"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn is_capacity(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["lamp_direction", "exposure_drift", "near_field_light"]
    }
    fn shown_by(&self) -> &'static str {
        "photograph a white board in place of the object under every lamp: how the light varies over it is the lamp's"
    }
    fn under(&self, light: Light) -> bool {
        light == Light::Lamps
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        if scene.horizon.light() != Light::Lamps {
            return Vec::new();
        }
        let positions: Vec<Vec3> = scene.seen.sites.iter().map(|s| s.point.position).collect();
        let parts = Bumps::new(&positions, LAMP_PARTS, 1.0);
        let frames =
            (0..scene.seen.frames as u32).flat_map(|t| (0..parts.bumps).map(move |part| (t, part)));
        frames
            .map(|(t, part)| {
                let field = scene.on_views(|v| {
                    let view = &scene.seen.views[v];
                    if view.frame != t {
                        return [0.0; 3];
                    }
                    let share = parts.at(view.site as usize)[part];
                    scene.value_of(v).map(|value| share * value)
                });
                let name = format!("light of lamp {t} on part {part} of the surface (share)");
                Term::new(name, 0.1, field).of(t)
            })
            .collect()
    }
}
