//! Light that the object itself gives off.

use super::{Effect, Stage, Term};
use crate::criticism::{formation::Bumps, light::Light, scene::Scene};

/// + e(x) ≥ 0: a colour everywhere, and more or less of it around points of the surface.
pub struct Emission;

/// Regions that may glow on their own.
const REGIONS: usize = 16;

impl Effect for Emission {
    fn id(&self) -> &'static str {
        "emission"
    }
    fn describe(&self) -> &'static str {
        "the object gives off light of its own"
    }
    fn stage(&self) -> Stage {
        Stage::Material
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &[
            "finer_albedo",
            "interreflection",
            "black_level",
            "translucency",
        ]
    }
    fn shown_by(&self) -> &'static str {
        "take one view in the dark: what can still be seen glows"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let typical = scene.typical();
        let scale = 0.2 * f64::from(typical);
        let mut terms: Vec<Term> = ["red", "green", "blue"]
            .iter()
            .enumerate()
            .map(|(k, name)| {
                let mut rgb = [0.0; 3];
                rgb[k] = 1.0;
                let name = format!("{name}, everywhere (radiance)");
                Term::new(name, scale, scene.on_views(|_| rgb)).positive()
            })
            .collect();
        let positions: Vec<_> = scene.seen.sites.iter().map(|s| s.point.position).collect();
        let regions = Bumps::new(&positions, REGIONS, 1.0);
        for k in 0..regions.bumps {
            for c in 0..3 {
                let field = scene.on_views(|v| {
                    let mut rgb = [0.0; 3];
                    rgb[c] = regions.at(scene.seen.views[v].site as usize)[k];
                    rgb
                });
                let name = format!("{} of region {k} (radiance)", ["red", "green", "blue"][c]);
                terms.push(Term::new(name, scale, field).positive());
            }
        }
        terms
    }
}
