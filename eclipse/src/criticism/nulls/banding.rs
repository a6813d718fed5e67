//! Bands of lamps that flicker while a sensor is read row by row.

use std::f32::consts::TAU;

use super::{Kind, Structure};
use crate::capture::Capture;

/// Largest relative change.
const DEPTH: f32 = 0.05;
/// Flickers while one photograph is read.
const BANDS: f32 = 2.7;
/// Flickers from one photograph to the next: no rhythm that frames share.
const BETWEEN: f32 = 0.382;

/// A rolling shutter under mains light.
pub(super) struct Banding;

impl Structure for Banding {
    fn id(&self) -> &'static str {
        "banding"
    }

    fn kind(&self) -> Kind {
        Kind::Outside
    }

    fn derive(&self, capture: &mut Capture) {
        for (t, frame) in capture.frames.iter_mut().enumerate() {
            let (width, height) = (frame.image.width, frame.image.height);
            for (p, pixel) in frame.image.data.chunks_exact_mut(3).enumerate() {
                let read = (p / width) as f32 / height as f32;
                let flicker = (TAU * (BANDS * read + BETWEEN * t as f32)).sin();
                pixel.iter_mut().for_each(|v| *v *= 1.0 + DEPTH * flicker);
            }
        }
    }
}
