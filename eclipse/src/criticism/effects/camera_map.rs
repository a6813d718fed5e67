//! What an effect of the camera does to a whole photograph, and how it is undone.

use glam::Vec2;
use rayon::prelude::*;
use render::image::Image;

/// A change of photographs by the camera that can be taken back.
pub struct CameraMap {
    /// From what would be recorded without the effect to what is.
    pub apply: Box<Change>,
    /// From what was recorded to what would be without the effect.
    pub undo: Box<Change>,
}

/// A change of the photograph of a frame.
pub type Change = dyn Fn(usize, &mut Image) + Send + Sync;

impl CameraMap {
    /// From functions of the frame, the place (pixels, corners at integers) and the colour.
    pub fn pixelwise(
        apply: impl Fn(usize, Vec2, [f32; 3]) -> [f32; 3] + Send + Sync + 'static,
        undo: impl Fn(usize, Vec2, [f32; 3]) -> [f32; 3] + Send + Sync + 'static,
    ) -> Self {
        Self {
            apply: Box::new(move |frame, image| each(image, |at, rgb| apply(frame, at, rgb))),
            undo: Box::new(move |frame, image| each(image, |at, rgb| undo(frame, at, rgb))),
        }
    }

    /// From gains that do not depend on what is photographed.
    pub fn gains(gain: impl Fn(usize, Vec2) -> [f32; 3] + Send + Sync + Clone + 'static) -> Self {
        let inverse = gain.clone();
        Self::pixelwise(
            move |frame, at, rgb| {
                let gain = gain(frame, at);
                std::array::from_fn(|c| rgb[c] * gain[c])
            },
            move |frame, at, rgb| {
                let gain = inverse(frame, at);
                std::array::from_fn(|c| rgb[c] / gain[c].max(LEAST_GAIN))
            },
        )
    }
}

/// Gains below are no gains that a photograph would be taken with; dividing by them would only raise noise.
const LEAST_GAIN: f32 = 0.02;

fn each(image: &mut Image, of: impl Fn(Vec2, [f32; 3]) -> [f32; 3] + Sync) {
    let width = image.width.max(1);
    image
        .data
        .par_chunks_exact_mut(3)
        .enumerate()
        .for_each(|(p, pixel)| {
            let at = Vec2::new((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
            let changed = of(at, [pixel[0], pixel[1], pixel[2]]);
            pixel.copy_from_slice(&changed);
        });
}
