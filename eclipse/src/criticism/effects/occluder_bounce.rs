//! Light that a pale occluder sends back to the object.

use super::{
    Effect, Stage, Term,
    moving_occluder::{azimuths, light_of_cells},
    support::CameraGrid,
};
use crate::criticism::scene::Scene;

/// + E_t (1 − M_t) + E(part).
///
/// M is the transmittance of the occluder in the model and E its radiance, which depends on the side of the surroundings that it
/// faces: one number and two for the camera's azimuth. Somebody as bright as what is behind them blocks nothing on balance, so that
/// a model without bounce has no opacity there; hence a number more for each part of the sky behind the camera. Where nobody is in
/// the model at all nobody sends light: light from behind the camera would be a lamp.
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
    fn shown_by(&self) -> &'static str {
        "take the same views in black clothes, then in white ones: light that a body sends grows with its albedo, its shadow does not"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let texels = scene.radiance.len() / 3;
        // In units of the mean radiance of the environment, with its colour.
        let mean = [0, 1, 2].map(|c| {
            let sum: f32 = (0..texels).map(|t| scene.radiance[3 * t + c]).sum();
            sum / texels.max(1) as f32
        });
        let (sent, cells) = match sent_by_occluder(scene, mean) {
            Some(sent) => (sent, light_of_cells(scene, |_, c| mean[c])),
            None => (vec![0.0; scene.size()], Vec::new()),
        };
        let azimuths = azimuths(scene.seen);
        let turned = |axis: usize| {
            scene.on_views(|v| {
                let side = azimuths[scene.seen.views[v].frame as usize][axis];
                [0, 1, 2].map(|c| side * sent[3 * v + c])
            })
        };
        let sides = ["cosine", "sine"]
            .into_iter()
            .enumerate()
            .map(|(axis, what)| {
                let name = format!("its change with the {what} of the camera's azimuth");
                Term::new(name, 0.15, turned(axis))
            });
        let mut terms: Vec<Term> = sides.collect();
        let name = "radiance (of the mean) of the occluder";
        terms.push(Term::new(name, 0.3, sent).positive());
        let parts = (0..CameraGrid::PARTS).map(|part| {
            let mut field = vec![0.0; scene.size()];
            for (cell, sent) in cells.iter().enumerate() {
                if CameraGrid::part(cell) == Some(part) {
                    field.iter_mut().zip(sent).for_each(|(f, s)| *f += s);
                }
            }
            let name = format!(
                "radiance (of the mean) {} beyond that",
                CameraGrid::part_name(part)
            );
            Term::new(name, 0.1, field).positive()
        });
        terms.extend(parts);
        terms
    }
}

/// What an occluder in the model, of radiance `mean`, adds to each view; `None` when there is none.
fn sent_by_occluder(scene: &Scene<'_>, mean: [f32; 3]) -> Option<Vec<f32>> {
    if std::ptr::eq(scene.bare, scene.transport) {
        return None;
    }
    let field = scene.on_views(|v| {
        let albedo = scene.albedo_of(v);
        let mut sum = [0.0; 3];
        // The same entries in the same order: one is the other with shares taken away.
        for ((_, all), (_, left)) in scene.bare.row(v).zip(scene.transport.row(v)) {
            let [d, s] = [all[0] - left[0], all[1] - left[1]];
            for c in 0..3 {
                sum[c] += (albedo[c] * d + s) * mean[c];
            }
        }
        sum
    });
    field.iter().any(|f| *f != 0.0).then_some(field)
}
