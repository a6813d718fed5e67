//! A shape whose normals are off.

use glam::Vec3;
use rayon::prelude::*;
use render::math::Frame;

use super::{Effect, Stage, Term};
use crate::criticism::{
    formation::Bumps,
    glossy::{Arriving, Reflected},
    light::Light,
    scene::Scene,
};

/// δn(x), tangent to the surface, smooth over parts of it.
pub struct NormalError;

/// Parts of the surface that may be tilted.
const REGIONS: usize = 36;

impl Effect for NormalError {
    fn id(&self) -> &'static str {
        "normal_error"
    }
    fn describe(&self) -> &'static str {
        "parts of the surface are tilted against the given shape"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["finer_albedo", "finer_environment", "pose_error"]
    }
    fn shown_by(&self) -> &'static str {
        "turn the object under the same light, or measure its shape again: a wrong shape moves with the object and follows the light, albedo does not"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let slopes = slopes(scene);
        let positions: Vec<Vec3> = scene.seen.sites.iter().map(|s| s.point.position).collect();
        let regions = Bumps::new(&positions, REGIONS, 1.0);
        let mut terms = Vec::new();
        for k in 0..regions.bumps {
            for axis in 0..2 {
                let field = scene.on_views(|v| {
                    let bump = regions.at(scene.seen.views[v].site as usize)[k];
                    slopes[v][axis].map(|s| bump * s)
                });
                terms.push(Term::new(
                    format!("tilt {axis} of region {k} (radian)"),
                    0.05,
                    field,
                ));
            }
        }
        terms
    }
}

/// The change of every view's value when its normal is tilted by a radian along each of its [tangents](Frame).
pub fn slopes(scene: &Scene<'_>) -> Vec<[[f32; 3]; 2]> {
    const STEP: f32 = 0.03;
    (0..scene.seen.views.len())
        .into_par_iter()
        .map_init(<(Arriving, [Reflected; 2])>::default, |(light, by), v| {
            let site = scene.seen.views[v].site as usize;
            let normal = scene.seen.sites[site].point.normal;
            let axes = Frame::new(normal);
            let outgoing = scene.outgoing(v);
            let albedo = scene.albedo_of(v);
            light.replace(scene.horizon.row(scene.seen, &scene.seen.views[v]));
            [axes.tangent, axes.bitangent].map(|along: Vec3| {
                let tilted = [STEP, -STEP].map(|step| (normal + step * along).normalize());
                for (normal, by) in tilted.into_iter().zip(by.iter_mut()) {
                    light.see(normal, outgoing);
                    light.reflect(scene.lobe, by);
                }
                let mut sum = [0.0; 3];
                for (k, (&source, weight)) in light.source.iter().zip(&light.weight).enumerate() {
                    let incident = light.direction(k);
                    let cosine = normal.dot(incident).max(0.02);
                    let [(d1, s1), (d0, s0)] = [0, 1].map(|side: usize| {
                        let share = tilted[side].dot(incident).max(0.0) / cosine;
                        (share * by[side].diffuse[k], share * by[side].specular[k])
                    });
                    for c in 0..3 {
                        sum[c] += weight
                            * scene.radiance[3 * source as usize + c]
                            * (albedo[c] * (d1 - d0) + (s1 - s0))
                            / (2.0 * STEP);
                    }
                }
                sum
            })
        })
        .collect()
}
