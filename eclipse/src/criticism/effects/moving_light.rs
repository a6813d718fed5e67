//! An environment that turns or changes while the photographs are taken.

use glam::{Quat, Vec3};
use render::lat_long::LatLong;

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// Rotation about three axes with time, a free turn about the vertical of each frame, and a drift of brightness from one
/// side to the other.
pub struct MovingLight;

/// The angle (radian) whose difference of environments stands for a rotation's slope.
const STEP: f32 = 0.06;

impl Effect for MovingLight {
    fn id(&self) -> &'static str {
        "moving_light"
    }
    fn describe(&self) -> &'static str {
        "the light turns or drifts while the photographs are taken"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["moving_occluder", "exposure_drift"]
    }
    fn shown_by(&self) -> &'static str {
        "take the first view again at the end, exposure locked: what has changed is the light"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let Some(grid) = scene.horizon.grid() else {
            return Vec::new();
        };
        let mut terms = Vec::new();
        let axes = [("x", Vec3::X), ("y", Vec3::Y), ("z", Vec3::Z)];
        for (name, axis) in axes {
            let turned = scene.lit_by(&turning(scene, grid, axis));
            for (time, power) in [("time", 1), ("time²", 2)] {
                let field = scaled(scene, &turned, |t| {
                    let t = scene.time(t);
                    // Without a mean, which a static environment has.
                    if power == 1 { t } else { t * t - 1.0 / 3.0 }
                });
                let name = format!("turn about {name} with {time} (radian)");
                terms.push(Term::new(name, 0.2, field));
            }
            if name == "z" {
                for frame in 0..scene.seen.frames as u32 {
                    let field = scaled(scene, &turned, |t| f32::from(t == frame));
                    let name = format!("turn about z of frame {frame} (radian)");
                    terms.push(Term::new(name, 0.05, field).of(frame));
                }
            }
        }
        for (name, axis) in axes {
            let tilted: Vec<f32> = scene
                .radiance
                .iter()
                .enumerate()
                .map(|(i, l)| l * scene.horizon.directions[i / 3].dot(axis))
                .collect();
            let field = scaled(scene, &scene.lit_by(&tilted), |t| scene.time(t));
            let name = format!("brightening towards {name} with time (log)");
            terms.push(Term::new(name, 0.1, field));
        }
        terms
    }
}

/// The field times a number of each frame.
fn scaled(scene: &Scene<'_>, field: &[f32], of: impl Fn(u32) -> f32) -> Vec<f32> {
    let factors: Vec<f32> = (0..scene.seen.frames as u32).map(of).collect();
    field
        .iter()
        .enumerate()
        .map(|(i, f)| f * factors[scene.seen.frame(i / 3) as usize])
        .collect()
}

/// The environment's change by a turn about `axis`, per radian.
fn turning(scene: &Scene<'_>, grid: LatLong, axis: Vec3) -> Vec<f32> {
    let at = |direction: Vec3, c: usize| {
        let around = grid.bilinear(direction);
        (0..4)
            .map(|k| around.weight[k] * scene.radiance[3 * around.index[k] as usize + c])
            .sum::<f32>()
    };
    let (forth, back) = (
        Quat::from_axis_angle(axis, -STEP),
        Quat::from_axis_angle(axis, STEP),
    );
    scene
        .horizon
        .directions
        .iter()
        .flat_map(|&d| {
            let (f, b) = (forth * d, back * d);
            [0, 1, 2].map(|c| (at(f, c) - at(b, c)) / (2.0 * STEP))
        })
        .collect()
}
