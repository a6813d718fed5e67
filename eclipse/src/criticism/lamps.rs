//! The simulation of a capture whose lamps are known: Lambert's law on the given shape, nothing else.

use render::{
    bvh::{Bvh, SurfacePoint},
    image::Image,
    mesh::MeshError,
};

use super::{
    horizon::{Source, arriving},
    simulation::Simulation,
    statistics::median,
};
use crate::capture::{Capture, Frame, Lamps};

/// Albedo of the simulation before anything is fitted; what it is goes into the lamps' scale.
const ALBEDO: f32 = 0.5;
/// Pixels darker than this share of the brightest say little about the scale.
const LIT: f32 = 0.3;

impl Simulation {
    /// Of a capture under these lamps: their scale, by colour, is the middle ratio of photographs to renders.
    ///
    /// # Errors
    /// A mesh that cannot be traced.
    pub fn under_lamps(capture: &Capture, lamps: &Lamps) -> Result<Self, MeshError> {
        let bvh = Bvh::new(&capture.mesh)?;
        let mut renders: Vec<Image> = capture
            .frames
            .iter()
            .zip(&lamps.lamps)
            .map(|(frame, lamp)| {
                let source = Source::from(lamp);
                let shade = |point: &SurfacePoint| arriving(&bvh, lamps.ball, &source, point);
                render(&bvh, frame, lamp.strength, shade)
            })
            .collect();
        let scale = [0, 1, 2].map(|c| scale(capture, &renders, c));
        for pixel in renders.iter_mut().flat_map(|r| r.data.chunks_exact_mut(3)) {
            (0..3).for_each(|c| pixel[c] *= scale[c]);
        }
        let radiance = lamps.lamps.iter();
        let radiance: Vec<f32> = radiance
            .flat_map(|lamp| [0, 1, 2].map(|c| scale[c] * lamp.strength[c]))
            .collect();
        Ok(Self {
            environment: Image {
                width: lamps.lamps.len(),
                height: 1,
                channels: 3,
                data: radiance,
            },
            lobe: None,
            renders,
            occluders: Vec::new(),
        })
    }
}

/// A frame with a plain albedo under a lamp of this strength.
fn render(
    bvh: &Bvh,
    frame: &Frame,
    strength: [f32; 3],
    shade: impl Fn(&SurfacePoint) -> f32 + Sync,
) -> Image {
    use rayon::prelude::*;
    let (width, height) = (frame.image.width, frame.image.height);
    let mut image = Image::filled(width, height, 3, 0.0);
    image
        .data
        .par_chunks_exact_mut(3)
        .enumerate()
        .for_each(|(p, pixel)| {
            let (x, y) = ((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
            if let Some((point, _)) = bvh.seen(&frame.camera, x, y) {
                let light = ALBEDO * shade(&point);
                (0..3).for_each(|c| pixel[c] = strength[c] * light);
            }
        });
    image
}

/// The middle ratio of photographs to renders where these are well lit.
fn scale(capture: &Capture, renders: &[Image], c: usize) -> f32 {
    let top = renders
        .iter()
        .flat_map(|render| &render.data)
        .fold(0.0f32, |top, value| top.max(*value));
    let mut ratios: Vec<f64> = Vec::new();
    for (frame, render) in capture.frames.iter().zip(renders) {
        for (p, mask) in frame.mask.data.iter().enumerate() {
            let rendered = render.data[3 * p + c];
            if *mask > 0.999 && rendered > LIT * top {
                ratios.push(f64::from(frame.image.data[3 * p + c] / rendered));
            }
        }
    }
    let middle = median(&mut ratios) as f32;
    if middle.is_finite() && middle > 0.0 {
        middle
    } else {
        1.0
    }
}
