//! A ghost: light that lenses reflect twice lands mirrored through the middle of the image.

use super::{Kind, Structure};
use crate::capture::Capture;

/// Share of the light that lands there.
const SHARE: f32 = 0.06;

/// Two lens surfaces without coating.
pub(super) struct Ghost;

impl Structure for Ghost {
    fn id(&self) -> &'static str {
        "ghost"
    }

    fn kind(&self) -> Kind {
        Kind::Outside
    }

    fn derive(&self, capture: &mut Capture) {
        for frame in &mut capture.frames {
            // Backwards through the pixels is a turn by half a circle.
            let before = frame.image.data.clone();
            let turned = before.chunks_exact(3).rev();
            for (pixel, other) in frame.image.data.chunks_exact_mut(3).zip(turned) {
                for (value, other) in pixel.iter_mut().zip(other) {
                    *value = (1.0 - SHARE) * *value + SHARE * other;
                }
            }
        }
    }
}
