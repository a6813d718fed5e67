//! Somebody or something that moves with the camera and stands in the light.

use glam::Vec3;
use rayon::prelude::*;
use render::occluder::shell_direction;

use super::{Effect, Mask, Passing, Stage, Term, support::CameraGrid};
use crate::criticism::{horizon::Horizon, observe::Observations, scene::Scene};

/// Usual opacity of a cell where somebody behind the camera would be.
const SCALE: f64 = 0.5;
/// The same high above and at the ground, where mostly nobody is.
const SCALE_ASIDE: f64 = 0.05;

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
    fn shown_by(&self) -> &'static str {
        "take the same views with nobody near, by a timer or from behind a screen: where nobody stands nothing is darker"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let opacity: Vec<f32> = scene.numbers(self.id()).iter().map(|b| *b as f32).collect();
        let left = |k: usize| 1.0 - opacity.get(k).copied().unwrap_or(0.0);
        let light = light_of_cells(scene, |texel, c| scene.radiance[3 * texel + c]);
        // What the other of both factors lets pass is what a number can still take.
        let in_all = |cell: usize| {
            let left_in =
                |t: u32| CameraGrid::part(cell).map_or(1.0, |part| left(number_in_frame(t, part)));
            scene.on_views(|v| {
                let left = left_in(scene.seen.views[v].frame);
                [0, 1, 2].map(|c| -left * light[cell][3 * v + c])
            })
        };
        let in_one = |t: u32, part: usize| {
            let members =
                (0..CameraGrid::CELLS).filter(|&cell| CameraGrid::part(cell) == Some(part));
            let members: Vec<(f32, &Vec<f32>)> =
                members.map(|cell| (left(cell), &light[cell])).collect();
            scene.on_views(|v| {
                if scene.seen.views[v].frame != t {
                    return [0.0; 3];
                }
                let sum = |c| {
                    members
                        .iter()
                        .map(|(left, light)| -left * light[3 * v + c])
                        .sum()
                };
                [0, 1, 2].map(sum)
            })
        };
        let own = (0..scene.seen.frames as u32)
            .flat_map(|t| (0..CameraGrid::PARTS).map(move |part| (t, part)));
        let own: Vec<Term> = own
            .map(|(t, part)| {
                let name = format!(
                    "further opacity {} in frame {t}",
                    CameraGrid::part_name(part)
                );
                Term::new(name, 0.3, in_one(t, part))
                    .positive()
                    .at_most(1.0)
                    .of(t)
            })
            .collect();
        let cells = (0..CameraGrid::CELLS).map(|cell| {
            let name = format!("opacity at {}", CameraGrid::name(cell));
            let scale = match CameraGrid::behind_camera(cell) {
                true => SCALE,
                false => SCALE_ASIDE,
            };
            Term::new(name, scale, in_all(cell)).positive().at_most(1.0)
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
            let Some(cell) = CameraGrid::cell(from, azimuths[frame]) else {
                return 1.0;
            };
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

/// For every cell of the camera's grid, what light of `radiance(texel, colour)` from it adds to each view where nobody stands.
pub(super) fn light_of_cells(
    scene: &Scene<'_>,
    radiance: impl Fn(usize, usize) -> f32 + Sync,
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
                let Some(cell) = CameraGrid::cell(from, azimuths[view.frame as usize]) else {
                    continue;
                };
                let sum = &mut cells[cell];
                for c in 0..3 {
                    sum[c] += (albedo[c] * d + s) * radiance(texel, c);
                }
            }
            cells
        })
        .collect();
    (0..CameraGrid::CELLS)
        .map(|cell| scene.on_views(|v| per_view[v][cell]))
        .collect()
}
