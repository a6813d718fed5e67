//! Light that travels below the surface.

use rayon::prelude::*;

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// Diffuse light spread over the surface: blurred minus as it arrives, for two reaches.
pub struct Translucency;

impl Effect for Translucency {
    fn id(&self) -> &'static str {
        "translucency"
    }
    fn describe(&self) -> &'static str {
        "light spreads below the surface and softens shadows"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["finer_albedo", "defocus", "emission"]
    }
    fn shown_by(&self) -> &'static str {
        "cast a sharp shadow across the object: light beneath the surface blurs its edge, while texture stays sharp"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let sites = &scene.seen.sites;
        let arriving: Vec<[f32; 3]> = (0..sites.len())
            .map(|s| {
                let views = scene.seen.offsets[s]..scene.seen.offsets[s + 1];
                let count = views.len().max(1) as f32;
                [0, 1, 2].map(|c| {
                    let sum: f32 = views.clone().map(|v| scene.diffuse[3 * v + c]).sum();
                    sum / count
                })
            })
            .collect();
        [0.06f32, 0.15]
            .into_iter()
            .map(|share| {
                let reach = share * scene.radius;
                let spread: Vec<[f32; 3]> = sites
                    .par_iter()
                    .map(|site| {
                        let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
                        for (other, light) in sites.iter().zip(&arriving) {
                            let d = other.point.position.distance(site.point.position) / reach;
                            let weight = (-d).exp();
                            if weight > 1e-4 {
                                total += weight;
                                (0..3).for_each(|c| sum[c] += weight * light[c]);
                            }
                        }
                        sum.map(|s| s / total.max(1e-9))
                    })
                    .collect();
                let field = scene.on_views(|v| {
                    let site = scene.seen.views[v].site as usize;
                    let albedo = scene.albedo_of(v);
                    [0, 1, 2].map(|c| albedo[c] * (spread[site][c] - arriving[site][c]))
                });
                let name = format!("share of light that travels {share} radii");
                Term::new(name, 0.3, field).positive()
            })
            .collect()
    }
}
