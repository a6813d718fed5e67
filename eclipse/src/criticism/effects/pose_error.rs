//! Cameras that are not where the capture says.

use glam::{Mat4, Vec3};

use super::{Effect, Stage, Term, support::gradient};
use crate::criticism::scene::Scene;

/// A small rigid motion of each camera: the photograph shows another place of the surface than the model thinks.
pub struct PoseError;

impl Effect for PoseError {
    fn id(&self) -> &'static str {
        "pose_error"
    }
    fn describe(&self) -> &'static str {
        "cameras stand or look elsewhere than recorded"
    }
    fn stage(&self) -> Stage {
        Stage::Optics
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["finer_albedo", "defocus", "normal_error"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // Turning to the side and nodding (which moving sideways all but equals), rolling, and moving closer.
        const NAMES: [&str; 4] = ["yaw", "pitch", "roll", "approach"];
        let mut terms = Vec::new();
        for t in 0..scene.seen.frames as u32 {
            let camera = &scene.capture.frames[t as usize].camera;
            let axes = camera.world_from_camera;
            let about: [Vec3; 3] =
                [axes.y_axis, axes.x_axis, axes.z_axis].map(|a| a.truncate().normalize());
            let distance = camera.distance();
            // Each is a displacement of about a pixel.
            let pixel = distance / camera.focal[0];
            for (k, name) in NAMES.iter().enumerate() {
                let moved = |step: f32| {
                    let mut camera = camera.clone();
                    let centre = camera.centre();
                    camera.world_from_camera = match k {
                        3 => Mat4::from_translation(step * scene.radius * about[2]) * axes,
                        _ => {
                            Mat4::from_translation(centre)
                                * Mat4::from_axis_angle(about[k], step)
                                * Mat4::from_translation(-centre)
                                * axes
                        }
                    };
                    camera
                };
                let unit = match k {
                    0 | 1 => pixel / distance,
                    2 => pixel / scene.radius,
                    _ => pixel * distance / (scene.radius * scene.radius),
                };
                let (plus, minus) = (moved(unit), moved(-unit));
                let field = scene.on_views(|v| {
                    let view = &scene.seen.views[v];
                    if view.frame != t {
                        return [0.0; 3];
                    }
                    let point = scene.seen.sites[view.site as usize].point.position;
                    let (Some(a), Some(b)) = (plus.project(point), minus.project(point)) else {
                        return [0.0; 3];
                    };
                    let (dx, dy) = (0.5 * (a[0] - b[0]), 0.5 * (a[1] - b[1]));
                    // The surface point is now seen at +d, so that the recorded place shows what lay at −d.
                    let (across, down) = gradient(&scene.renders[t as usize], view.at);
                    [0, 1, 2].map(|c| -(dx * across[c] + dy * down[c]))
                });
                let name = format!("{name} of frame {t} (about a pixel)");
                terms.push(Term::new(name, 0.5, field).of(t));
            }
        }
        terms
    }
}
