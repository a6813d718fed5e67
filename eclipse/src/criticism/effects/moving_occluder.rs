//! Somebody or something that moves with the camera and stands in the light.

use glam::Vec3;
use rayon::prelude::*;
use render::occluder::shell_direction;

use super::{Effect, Mask, Passing, Stage, Term, support::CameraGrid};
use crate::criticism::{horizon::Horizon, observe::Observations, scene::Scene};

/// (1 − m(ω)) (1 − m_t(ω)), 0 ≤ m ≤ 1: opacity of the cells of a grid that turns with the camera, on the shell at the camera's
/// distance, and more of it in broad parts behind the camera frame by frame, since people do not stand still.
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
        let opacity: Vec<f32> = scene.numbers(self.id()).iter().map(|b| *b as f32).collect();
        let left = |k: usize| 1.0 - opacity.get(k).copied().unwrap_or(0.0);
        // What the other of both factors lets pass is what a number can still take.
        let fields = blocked_light(scene, |view, from_cell, texel, c| {
            let own = CameraGrid::part(from_cell).map_or(1.0, |part| {
                left(number_in_frame(scene.seen.views[view].frame, part))
            });
            -own * scene.radiance[3 * texel + c]
        });
        let whole = blocked_light(scene, |_, from_cell, texel, c| {
            -left(from_cell) * scene.radiance[3 * texel + c]
        });
        let own = (0..scene.seen.frames as u32)
            .flat_map(|t| (0..CameraGrid::PARTS).map(move |part| (t, part)));
        let own: Vec<Term> = own
            .map(|(t, part)| {
                let field = in_frame(scene, &whole, t, part);
                let name = format!(
                    "further opacity {} in frame {t}",
                    CameraGrid::part_name(part)
                );
                Term::new(name, 0.3, field).positive().at_most(1.0).of(t)
            })
            .collect();
        let cells = fields.into_iter().enumerate().map(|(cell, field)| {
            let name = format!("opacity at {}", CameraGrid::name(cell));
            let scale = if CameraGrid::behind_camera(cell) {
                0.5
            } else {
                0.15
            };
            Term::new(name, scale, field).positive().at_most(1.0)
        });
        cells.chain(own).collect()
    }
    fn mask(&self, seen: &Observations, beta: &[f64]) -> Option<Mask> {
        if beta.iter().all(|b| *b == 0.0) {
            return None;
        }
        let opacity: Vec<f32> = beta.iter().map(|b| *b as f32).collect();
        let azimuths = azimuths(seen);
        Some(Box::new(move |frame, from| {
            let cell = CameraGrid::cell(from, azimuths[frame]);
            let at = |k: usize| opacity.get(k).copied().unwrap_or(0.0);
            let own =
                CameraGrid::part(cell).map_or(0.0, |part| at(number_in_frame(frame as u32, part)));
            (1.0 - at(cell)) * (1.0 - own)
        }))
    }
    fn passing(&self, horizon: &Horizon, seen: &Observations, beta: &[f64]) -> Option<Passing> {
        let mask = self.mask(seen, beta)?;
        let directions = horizon.directions.clone();
        let places: Vec<(Vec3, f32, usize)> = seen
            .views
            .iter()
            .map(|view| {
                let point = seen.sites[view.site as usize].point.position;
                let frame = view.frame as usize;
                (point, seen.eyes[frame].length(), frame)
            })
            .collect();
        Some(Box::new(move |view, texel| {
            let (point, radius, frame) = places[view];
            mask(frame, shell_direction(point, directions[texel], radius))
        }))
    }
}

/// Which number is the opacity of a part behind the camera in one frame.
fn number_in_frame(frame: u32, part: usize) -> usize {
    CameraGrid::CELLS + frame as usize * CameraGrid::PARTS + part
}

/// The light that a part behind the camera sends to the views of one frame, from that of the cells.
fn in_frame(scene: &Scene<'_>, cells: &[Vec<f32>], frame: u32, part: usize) -> Vec<f32> {
    let members: Vec<&Vec<f32>> = (0..cells.len())
        .filter(|&cell| CameraGrid::part(cell) == Some(part))
        .map(|cell| &cells[cell])
        .collect();
    scene.on_views(|v| {
        if scene.seen.views[v].frame != frame {
            return [0.0; 3];
        }
        [0, 1, 2].map(|c| members.iter().map(|cell| cell[3 * v + c]).sum())
    })
}

/// Cosine and sine of every camera's azimuth.
pub(super) fn azimuths(seen: &Observations) -> Vec<[f32; 2]> {
    seen.eyes
        .iter()
        .map(|eye| {
            let length = (eye.x * eye.x + eye.y * eye.y).sqrt().max(1e-9);
            [eye.x / length, eye.y / length]
        })
        .collect()
}

/// For every cell of the camera's grid, what light of radiance `light(view, cell, texel, colour)` from it adds to each view.
fn blocked_light(
    scene: &Scene<'_>,
    light: impl Fn(usize, usize, usize, usize) -> f32 + Sync,
) -> Vec<Vec<f32>> {
    let azimuths = azimuths(scene.seen);
    let per_view: Vec<Vec<[f32; 3]>> = (0..scene.seen.views.len())
        .into_par_iter()
        .map(|v| {
            let view = &scene.seen.views[v];
            let point = scene.seen.sites[view.site as usize].point.position;
            let eye = scene.seen.eyes[view.frame as usize];
            let albedo = scene.albedo_of(v);
            let mut cells = vec![[0.0f32; 3]; CameraGrid::CELLS];
            for (texel, [d, s]) in scene.bare.row(v) {
                let from = shell_direction(point, scene.horizon.directions[texel], eye.length());
                let cell = CameraGrid::cell(from, azimuths[view.frame as usize]);
                let sum = &mut cells[cell];
                for c in 0..3 {
                    sum[c] += (albedo[c] * d + s) * light(v, cell, texel, c);
                }
            }
            cells
        })
        .collect();
    (0..CameraGrid::CELLS)
        .map(|cell| scene.on_views(|v| per_view[v][cell]))
        .collect()
}
