//! A surface that changes half way through: somebody put a wet hand on it.

use glam::Vec3;
use render::bvh::{Bvh, SurfacePoint};

use super::{Kind, Structure, mean_seen};
use crate::capture::Capture;

/// Share of the light that the stain takes away in its middle.
const DEPTH: f32 = 0.2;
/// Radius of the stain in bounding radii of the object.
const SIZE: f32 = 0.5;
/// Rays along the side of a pixel.
const SIDE: usize = 2;

/// A stain that appears with the frame in the middle.
pub(super) struct Stain;

impl Structure for Stain {
    fn id(&self) -> &'static str {
        "stain"
    }

    fn kind(&self) -> Kind {
        Kind::Outside
    }

    fn derive(&self, capture: &mut Capture) {
        let Ok(bvh) = Bvh::new(&capture.mesh) else {
            return;
        };
        let size = SIZE * capture.mesh.bounding_radius();
        // On whichever side is photographed last, where it is certain to be seen.
        let Some(last) = capture.frames.last() else {
            return;
        };
        let eye = last.camera.centre();
        let Some(middle) = nearest(&capture.mesh.positions, eye) else {
            return;
        };
        let half = capture.frames.len() / 2;
        for frame in &mut capture.frames[half..] {
            let width = frame.image.width;
            for (p, pixel) in frame.image.data.chunks_exact_mut(3).enumerate() {
                let at = [p % width, p / width];
                let left = |point: &SurfacePoint| {
                    let d = point.position.distance_squared(middle) / (size * size);
                    1.0 - DEPTH * (-2.0 * d).exp()
                };
                if let Some(mean) = mean_seen(&bvh, &frame.camera, at, SIDE, left) {
                    pixel.iter_mut().for_each(|value| *value *= mean);
                }
            }
        }
    }
}

/// The place of the surface that is nearest to `eye`.
fn nearest(positions: &[Vec3], eye: Vec3) -> Option<Vec3> {
    let far = |p: &Vec3| p.distance_squared(eye);
    let all = positions.iter().copied();
    all.min_by(|a, b| far(a).total_cmp(&far(b)))
}
