//! Light lost towards the corners of the image.

use autodiff::Var;
use glam::Vec2;
use render::camera::Camera;

use super::{Effect, Recorded, Stage, Term, camera_map::CameraMap, weighted};
use crate::{capture::Capture, criticism::scene::Scene};

/// 1 + a r² + b r⁴, with r = 1 in the corners.
pub struct Vignetting;

impl Effect for Vignetting {
    fn id(&self) -> &'static str {
        "vignetting"
    }
    fn describe(&self) -> &'static str {
        "the image darkens from its middle outwards"
    }
    fn stage(&self) -> Stage {
        Stage::Falloff
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["medium", "near_field_light", "veiling_glare"]
    }
    fn shown_by(&self) -> &'static str {
        "photograph the object near the image's edges and corners from the same distance: a falloff follows the image"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let squared = |i: usize| {
            let camera = &scene.capture.frames[scene.seen.frame(i) as usize].camera;
            squared_radius(camera, scene.seen.at(i).into())
        };
        vec![
            Term::new(
                "a: per r², r = 1 in the corners",
                0.3,
                scene.everywhere(|i| [squared(i); 3]),
            ),
            Term::new(
                "b: per r⁴",
                0.3,
                scene.everywhere(|i| [squared(i).powi(2); 3]),
            ),
        ]
    }
    fn is_of_the_camera(&self) -> bool {
        true
    }
    fn camera_map(&self, capture: &Capture, numbers: &[f64]) -> Option<CameraMap> {
        let &[a, b] = numbers else { return None };
        let frames = capture.frames.iter();
        let cameras: Vec<Camera> = frames.map(|frame| frame.camera.clone()).collect();
        Some(CameraMap::gains(move |frame, at| {
            let r2 = squared_radius(&cameras[frame], at);
            [1.0 + a as f32 * r2 + b as f32 * r2 * r2; 3]
        }))
    }
    fn is_of_one_sum(&self) -> bool {
        false
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        match weighted(terms) {
            Some(sum) => value * sum.affine(1.0, 1.0),
            None => value.clone(),
        }
    }
}

/// Squared distance from the principal point, 1 in the corners.
fn squared_radius(camera: &Camera, at: Vec2) -> f32 {
    let away = at - Vec2::from(camera.principal);
    let corner = 0.5 * Vec2::new(camera.width as f32, camera.height as f32);
    away.length_squared() / corner.length_squared()
}
