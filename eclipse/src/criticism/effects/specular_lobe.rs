//! A gloss that the baseline's material lacks.

use rayon::prelude::*;

use super::{Effect, Stage, Term};
use crate::criticism::{
    light::Light,
    scene::Scene,
    transport::{Lobe, reflect},
};

/// Light reflected by lobes of three widths; the number is the reflectance at normal incidence.
pub struct SpecularLobe;

impl Effect for SpecularLobe {
    fn id(&self) -> &'static str {
        "specular_lobe"
    }
    fn describe(&self) -> &'static str {
        "the surface is glossier than the model's"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["finer_environment", "response_curve", "clipping"]
    }
    fn shown_by(&self) -> &'static str {
        "take one view through a polarising filter at two angles: gloss changes with the angle, what is diffuse does not"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // A model that has a lobe fits it with light and texture; a second one would only correct what it is too coarse for.
        if scene.lobe.is_some() {
            return Vec::new();
        }
        [0.15f32, 0.3, 0.6]
            .into_iter()
            .map(|alpha| {
                // The lobe's response to κ, from two reflectances: it is linear but for Schlick's edge.
                let (none, some) = (Lobe { alpha, kappa: 0.0 }, Lobe { alpha, kappa: 0.04 });
                let views: Vec<[f32; 3]> = (0..scene.seen.views.len())
                    .into_par_iter()
                    .map(|v| {
                        let site = scene.seen.views[v].site as usize;
                        let normal = scene.seen.sites[site].point.normal;
                        let outgoing = scene.outgoing(v);
                        let albedo = scene.albedo_of(v);
                        let mut sum = [0.0; 3];
                        let row = scene.horizon.row(scene.seen, &scene.seen.views[v]);
                        for (texel, weight, incident) in row {
                            let (d0, s0) = reflect(Some(none), normal, incident, outgoing);
                            let (d1, s1) = reflect(Some(some), normal, incident, outgoing);
                            for c in 0..3 {
                                sum[c] += weight
                                    * scene.radiance[3 * texel + c]
                                    * (albedo[c] * (d1 - d0) + (s1 - s0))
                                    / 0.04;
                            }
                        }
                        sum
                    })
                    .collect();
                let field = scene.on_views(|v| views[v]);
                let name = format!("reflectance κ of a lobe of width α = {alpha}");
                Term::new(name, 0.04, field).positive()
            })
            .collect()
    }
}
