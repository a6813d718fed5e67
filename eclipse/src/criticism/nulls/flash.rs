//! A lamp on the camera that nobody knows of.

use render::bvh::{Bvh, SurfacePoint};

use super::{Kind, Structure, mean_seen};
use crate::capture::Capture;

/// What it adds where the surface faces the camera, in units of the photographs' mean over the object.
const STRENGTH: f32 = 0.15;
/// Rays along the side of a pixel.
const SIDE: usize = 2;

/// A ring light, on a surface of one albedo.
pub(super) struct Flash;

impl Structure for Flash {
    fn id(&self) -> &'static str {
        "flash"
    }

    fn kind(&self) -> Kind {
        Kind::Outside
    }

    fn derive(&self, capture: &mut Capture) {
        let Ok(bvh) = Bvh::new(&capture.mesh) else {
            return;
        };
        let (mut sum, mut count) = (0.0f64, 0u64);
        for frame in &capture.frames {
            let pixels = frame.image.data.chunks_exact(3);
            for (pixel, _) in pixels.zip(&frame.mask.data).filter(|(_, m)| **m > 0.5) {
                sum += pixel.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0;
                count += 1;
            }
        }
        let strength = STRENGTH * (sum / count.max(1) as f64) as f32;
        for frame in &mut capture.frames {
            let (width, eye) = (frame.image.width, frame.camera.centre());
            let pixels = frame.image.data.chunks_exact_mut(3).zip(&frame.mask.data);
            for (p, (pixel, mask)) in pixels.enumerate() {
                let at = [p % width, p / width];
                let facing = |point: &SurfacePoint| {
                    let towards = (eye - point.position).normalize();
                    point.normal.dot(towards).max(0.0)
                };
                if let Some(mean) = mean_seen(&bvh, &frame.camera, at, SIDE, facing) {
                    pixel
                        .iter_mut()
                        .for_each(|value| *value += mask * strength * mean);
                }
            }
        }
    }
}
