//! Photographs of a lens that bends straight lines, beside cameras that know of none.

use render::image::Image;

use super::{Kind, Structure};
use crate::{capture::Capture, criticism::effects::support::between};

/// How much farther from the middle than a pinhole camera's the image is, at its corners.
const STRENGTH: f32 = 0.02;

/// Pincushion distortion.
pub(super) struct LensDistortion;

impl Structure for LensDistortion {
    fn id(&self) -> &'static str {
        "lens_distortion"
    }

    fn kind(&self) -> Kind {
        Kind::Outside
    }

    fn derive(&self, capture: &mut Capture) {
        for frame in &mut capture.frames {
            frame.image = bent(&frame.image);
            frame.mask = bent(&frame.mask);
        }
    }
}

/// What the image of a pinhole camera becomes.
fn bent(image: &Image) -> Image {
    let (width, height) = (image.width, image.height);
    let middle = [width as f32 / 2.0, height as f32 / 2.0];
    let corner = middle[0].hypot(middle[1]);
    let mut out = image.clone();
    for (p, pixel) in out.data.chunks_exact_mut(image.channels).enumerate() {
        let from = [
            (p % width) as f32 + 0.5 - middle[0],
            (p / width) as f32 + 0.5 - middle[1],
        ];
        let r = from[0].hypot(from[1]) / corner;
        let scale = 1.0 / (1.0 + STRENGTH * r * r);
        let at = [0, 1].map(|k| middle[k] + scale * from[k]);
        let value = between(image, at);
        pixel
            .iter_mut()
            .enumerate()
            .for_each(|(c, v)| *v = value(c));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_stays_and_the_rest_moves_outwards() {
        let mut image = Image::filled(41, 41, 1, 0.0);
        for (x, y) in [(20, 20), (32, 20)] {
            image.data[41 * y + x] = 1.0;
        }
        let out = bent(&image);
        assert_eq!(out.data[41 * 20 + 20], 1.0);
        let row = &out.data[41 * 20 + 26..41 * 20 + 40];
        let sum: f32 = row.iter().sum();
        let mean = row.iter().zip(26..).map(|(v, x)| v * x as f32).sum::<f32>() / sum;
        assert!((32.02..32.3).contains(&mean), "{mean}");
    }
}
