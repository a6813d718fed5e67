//! The sRGB transfer function (IEC 61966-2-1).

use render::image::Image;
use serde::{Deserialize, Serialize};

/// How stored pixel values relate to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorEncoding {
    /// Values are proportional to light.
    Linear,
    /// Values carry the sRGB curve.
    Srgb,
}

/// Light of an sRGB-encoded value; values outside [0, 1] continue the curve, odd around zero.
pub fn srgb_to_linear(value: f32) -> f32 {
    let magnitude = value.abs();
    let linear = if magnitude <= 0.04045 {
        magnitude / 12.92
    } else {
        ((magnitude + 0.055) / 1.055).powf(2.4)
    };
    linear.copysign(value)
}

/// sRGB encoding of light, the inverse of [`srgb_to_linear`].
pub fn linear_to_srgb(value: f32) -> f32 {
    let magnitude = value.abs();
    let encoded = if magnitude <= 0.003_130_8 {
        magnitude * 12.92
    } else {
        1.055 * magnitude.powf(1.0 / 2.4) - 0.055
    };
    encoded.copysign(value)
}

/// The value shown as white: all but the brightest 0.5 % of the images' values are below.
pub fn white<'a>(images: impl IntoIterator<Item = &'a Image>) -> f32 {
    let mut values: Vec<f32> = images
        .into_iter()
        .flat_map(|image| image.data.iter().copied())
        .collect();
    values.sort_unstable_by(f32::total_cmp);
    let white = values.get(values.len() * 995 / 1000);
    white.map_or(1.0, |value| value.max(1e-6))
}

/// Decodes the colours of `image` in place; alpha, the last of two or four channels, stays.
pub(super) fn decode_srgb(image: &mut Image) {
    let colors = if image.channels.is_multiple_of(2) {
        image.channels - 1
    } else {
        image.channels
    };
    for pixel in image.data.chunks_exact_mut(image.channels) {
        for value in &mut pixel[..colors] {
            *value = srgb_to_linear(*value);
        }
    }
}
