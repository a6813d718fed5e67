//! Three times the noise.

use render::sampler::SampleKey;

use super::{Kind, Structure};
use crate::{capture::Capture, reconstruct::noise};

/// How much larger the noise's standard deviation becomes.
const FACTOR: f32 = 3.0;
/// Of the random numbers.
const SEED: u64 = 0x6e75_6c6c;

/// A noisier sensor.
pub(super) struct MoreNoise;

impl Structure for MoreNoise {
    fn id(&self) -> &'static str {
        "more_noise"
    }

    fn kind(&self) -> Kind {
        Kind::Plain
    }

    fn derive(&self, capture: &mut Capture) {
        let noise = noise::estimate(&capture.frames);
        let added = (FACTOR * FACTOR - 1.0).sqrt();
        for (t, frame) in capture.frames.iter_mut().enumerate() {
            for (p, pixel) in frame.image.data.chunks_exact_mut(3).enumerate() {
                let key = SampleKey {
                    seed: SEED,
                    frame: t as u32,
                    pixel: p as u32,
                    ..SampleKey::default()
                };
                let mut stream = key.stream();
                for value in pixel {
                    *value += added * noise.sigma(f64::from(*value)) as f32 * stream.normal();
                }
            }
        }
    }
}
