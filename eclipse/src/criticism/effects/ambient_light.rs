//! Light besides the known lamps, the same in all frames.

use glam::Vec3;

use super::{Effect, Stage, Term};
use crate::criticism::{light::Light, scene::Scene};

/// Half a sky of even light around each of the six axes, a colour each; their sum is a whole one. What the object hides of it
/// from itself is left out.
pub struct AmbientLight;

/// The middles of the skies.
const SIDES: [(&str, Vec3); 6] = [
    ("+x", Vec3::X),
    ("−x", Vec3::NEG_X),
    ("+y", Vec3::Y),
    ("−y", Vec3::NEG_Y),
    ("+z", Vec3::Z),
    ("−z", Vec3::NEG_Z),
];

impl Effect for AmbientLight {
    fn id(&self) -> &'static str {
        "ambient_light"
    }
    fn describe(&self) -> &'static str {
        "there is light besides the lamps, the same in all frames"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["emission", "black_level", "veiling_glare", "response_curve"]
    }
    fn shown_by(&self) -> &'static str {
        "take one photograph with all lamps off: what is still lit is lit by the room"
    }
    fn under(&self, light: Light) -> bool {
        light == Light::Lamps
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        if scene.horizon.light() != Light::Lamps {
            return Vec::new();
        }
        let colours = ["red", "green", "blue"];
        // One is a sky that a middling albedo reflects as the middle value.
        let unit = 2.0 * scene.typical();
        let numbers = SIDES
            .into_iter()
            .flat_map(|side| (0..3).map(move |c| (side, c)));
        numbers
            .map(|((name, middle), c)| {
                let field = scene.on_views(|v| {
                    let site = scene.seen.views[v].site as usize;
                    let normal = scene.seen.sites[site].point.normal;
                    let mut rgb = [0.0; 3];
                    // A Lambertian surface under half a sky.
                    rgb[c] = unit * scene.albedo_of(v)[c] * 0.5 * (1.0 + normal.dot(middle));
                    rgb
                });
                let name = format!(
                    "{} light from {name} (share of the middle value)",
                    colours[c]
                );
                Term::new(name, 0.05, field).positive()
            })
            .collect()
    }
}
