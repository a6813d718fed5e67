//! Cameras that are not where the capture says.

use glam::{Mat4, Vec3, Vec4};
use render::math::Frame;

use super::{Effect, Stage, Term, normal_error::slopes, support::gradient};
use crate::criticism::{light::Light, scene::Scene};

/// A small rigid motion of each camera: the photograph shows another place of the surface than the model thinks. Where the lamps are
/// known and the object is a ball, one motion and one size for all frames: what is seen at a place faces elsewhere.
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
    fn shown_by(&self) -> &'static str {
        "put a board with markers beside the object and find the cameras anew from it: poses that were wrong change"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        match &scene.capture.lamps {
            None => of_cameras(scene),
            Some(lamps) if lamps.ball => of_a_ball(scene),
            // One camera that does not move: a motion of its own in every frame makes no sense.
            Some(_) => Vec::new(),
        }
    }
}

/// Turning to the side and nodding (which moving sideways all but equals), rolling, and moving closer, of each camera.
fn of_cameras(scene: &Scene<'_>) -> Vec<Term> {
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

/// A ball further to the right, higher, and larger in the image than the capture says, in its radii.
///
/// At a place of the image, in radii from the ball's middle, the normal has that place for its part across the direction of view.
fn of_a_ball(scene: &Scene<'_>) -> Vec<Term> {
    const NAMES: [&str; 3] = ["further to the right", "higher", "larger"];
    let slopes = slopes(scene);
    let term = |k: usize| {
        let field = scene.on_views(|v| {
            let view = &scene.seen.views[v];
            let camera = &scene.seen.cameras[view.frame as usize].world_from_camera;
            let normal = scene.seen.sites[view.site as usize].point.normal;
            let tilt = tilt(
                k,
                normal,
                scene.outgoing(v),
                [camera.x_axis, camera.y_axis].map(Vec4::truncate),
            );
            let axes = Frame::new(normal);
            let along = [axes.tangent, axes.bitangent].map(|axis| axis.dot(tilt));
            [0, 1, 2].map(|c| along[0] * slopes[v][0][c] + along[1] * slopes[v][1][c])
        });
        Term::new(format!("the ball is {} (its radii)", NAMES[k]), 0.03, field)
    };
    (0..3).map(term).collect()
}

/// How the normal that is seen at a fixed place changes as the ball moves by a radius along one of the camera's axes, or doubles.
fn tilt(k: usize, normal: Vec3, outgoing: Vec3, axes: [Vec3; 2]) -> Vec3 {
    let across = |v: Vec3| v - v.dot(outgoing) * outgoing;
    let change = match k {
        0 | 1 => -across(axes[k].normalize()),
        _ => -across(normal),
    };
    // What the normal loses of its part across, it gains towards the camera.
    change - change.dot(normal) / normal.dot(outgoing).max(0.1) * outgoing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_that_moves_or_grows_turns_the_normal_that_is_seen_at_a_place() {
        // Seen from above, without perspective.
        let normal_at = |x: f32, y: f32| Vec3::new(x, y, (1.0 - x * x - y * y).sqrt());
        let (x, y, step) = (0.4f32, -0.5f32, 1e-3f32);
        let moved = [
            normal_at(x - step, y),
            normal_at(x, y - step),
            normal_at(x / (1.0 + step), y / (1.0 + step)),
        ];
        for (k, moved) in moved.into_iter().enumerate() {
            let expected = (moved - normal_at(x, y)) / step;
            let found = tilt(k, normal_at(x, y), Vec3::Z, [Vec3::X, Vec3::Y]);
            assert!(
                (found - expected).length() < 5e-3,
                "{k}: {found} {expected}"
            );
        }
    }
}
