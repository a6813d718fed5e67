//! A texture finer than any patch of the model.

use glam::{IVec3, Vec3};
use render::{
    bvh::{Bvh, SurfacePoint},
    sampler::SampleKey,
};

use super::{Kind, Structure, mean_seen};
use crate::capture::Capture;

/// Largest departure from one of what the texture multiplies the reflected light by.
const DEPTH: f32 = 0.15;
/// Cells of the texture across the object's bounding radius: at a hundred pixels across the object, about two pixels each.
const CELLS: f32 = 25.0;
/// Rays along the side of a pixel.
const SIDE: usize = 4;
/// Of the random numbers.
const SEED: u64 = 0x7465_7874;

/// Paint in cells of a solid lattice, the same in all photographs.
pub(super) struct FineTexture;

impl Structure for FineTexture {
    fn id(&self) -> &'static str {
        "fine_texture"
    }

    fn kind(&self) -> Kind {
        Kind::Structured
    }

    fn derive(&self, capture: &mut Capture) {
        let Ok(bvh) = Bvh::new(&capture.mesh) else {
            return;
        };
        let cell = capture.mesh.bounding_radius() / CELLS;
        for frame in &mut capture.frames {
            let width = frame.image.width;
            for (p, pixel) in frame.image.data.chunks_exact_mut(3).enumerate() {
                let at = [p % width, p / width];
                let paint = |point: &SurfacePoint| texture(point.position / cell);
                if let Some(mean) = mean_seen(&bvh, &frame.camera, at, SIDE, paint) {
                    pixel.iter_mut().for_each(|value| *value *= mean);
                }
            }
        }
    }
}

/// The texture at a point in units of its cells: one value a cell.
fn texture(point: Vec3) -> f32 {
    let IVec3 { x, y, z } = point.floor().as_ivec3();
    let key = SampleKey {
        seed: SEED,
        frame: x as u32,
        pixel: y as u32,
        sample: z as u32,
        ..SampleKey::default()
    };
    1.0 + DEPTH * (2.0 * key.stream().uniform() - 1.0)
}
