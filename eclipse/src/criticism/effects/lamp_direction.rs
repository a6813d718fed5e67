//! Known lamps that stand elsewhere than where the capture says.

use glam::Vec3;

use super::{Effect, Stage, Term, support::lamp_slope};
use crate::criticism::{horizon::Source, light::Light, observe::Observations, scene::Scene};

/// A turn of each frame's lamp along the two directions across its own: to the image's right, and upwards. In degrees.
pub struct LampDirection;

/// Degrees whose difference of images stands for a turn's slope.
const STEP: f64 = 0.5;
/// The names of a frame's two numbers.
const ACROSS: [&str; 2] = ["to the image's right", "upwards"];

impl Effect for LampDirection {
    fn id(&self) -> &'static str {
        "lamp_direction"
    }
    fn describe(&self) -> &'static str {
        "lamps stand elsewhere than where the capture says"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["response_curve", "near_field_light", "normal_error"]
    }
    fn shown_by(&self) -> &'static str {
        "put a mirror ball beside the object in every frame: the lamp's image on it says where it stands"
    }
    fn under(&self, light: Light) -> bool {
        light == Light::Lamps
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let lamps = scene.horizon.lamps().unwrap_or_default();
        let numbers = (0..lamps.len()).flat_map(|t| [0, 1].map(|axis| (t, axis)));
        numbers
            .map(|(t, axis)| {
                let turned = |angle: f64| {
                    let mut angles = [0.0; 2];
                    angles[axis] = angle;
                    turned(&lamps[t], right_of(scene.seen, t), angles)
                };
                let slope = lamp_slope(scene, t, &turned(STEP), &turned(-STEP), 2.0 * STEP as f32);
                let name = format!("lamp of frame {t} {} (degrees)", ACROSS[axis]);
                Term::new(name, 3.0, slope).of(t as u32)
            })
            .collect()
    }
    fn moved_lamps(
        &self,
        lamps: &[Source],
        seen: &Observations,
        beta: &[f64],
    ) -> Option<Vec<Source>> {
        if beta.iter().all(|b| *b == 0.0) {
            return None;
        }
        let moved = lamps.iter().enumerate().map(|(t, lamp)| {
            let angle = |axis: usize| beta.get(2 * t + axis).copied().unwrap_or(0.0);
            turned(lamp, right_of(seen, t), [angle(0), angle(1)])
        });
        Some(moved.collect())
    }
}

/// The direction that is to the right in a frame's image.
fn right_of(seen: &Observations, frame: usize) -> Vec3 {
    seen.cameras[frame].world_from_camera.x_axis.truncate()
}

/// A lamp turned along a great circle by these degrees, to the right and upwards.
fn turned(lamp: &Source, right: Vec3, [across, up]: [f64; 2]) -> Source {
    let direction = lamp.direction;
    // A lamp straight to the side has no right of its own; any direction across will do there.
    let across_axis = (right - right.dot(direction) * direction)
        .try_normalize()
        .unwrap_or_else(|| direction.any_orthonormal_vector());
    let up_axis = direction.cross(across_axis);
    let angle = across.hypot(up).to_radians() as f32;
    let along = across as f32 * across_axis + up as f32 * up_axis;
    let along = along.normalize_or_zero();
    Source {
        direction: (angle.cos() * direction + angle.sin() * along).normalize(),
        ..*lamp
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_is_as_far_as_it_says_and_where_it_says() {
        let lamp = Source {
            direction: Vec3::new(0.3, -0.2, 0.9).normalize(),
            nearness: 0.0,
        };
        for angles in [[4.0, 0.0], [0.0, -7.0], [3.0, 5.0]] {
            let there = turned(&lamp, Vec3::X, angles).direction;
            let angle = there.dot(lamp.direction).acos().to_degrees();
            assert!((f64::from(angle) - angles[0].hypot(angles[1])).abs() < 0.02);
            let moved = there - lamp.direction;
            // A turn to one side also lifts a lamp a little that is not straight ahead.
            for (part, wanted) in [(moved.x, angles[0]), (moved.y, angles[1])] {
                assert!(
                    wanted == 0.0 || f64::from(part) * wanted > 0.0,
                    "{moved} {angles:?}"
                );
            }
        }
        assert_eq!(turned(&lamp, Vec3::X, [0.0; 2]).nearness, 0.0);
    }
}
