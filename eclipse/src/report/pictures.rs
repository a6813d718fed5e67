//! Pictures of the report: linear values to PNG data URIs.

use std::path::Path;

use base64::{Engine, engine::general_purpose::STANDARD};
use render::image::Image;

use crate::{
    image_io::{ImageIoError, encode_png8, linear_to_srgb},
    reconstruction::{Noise, Reconstruction},
};

/// Colour of blocked light in the overlays, sRGB.
const BLOCKED: [f32; 3] = [0.93, 0.36, 0.05];
/// Residuals of this many units (σ, or the scale) are fully red or blue.
pub(super) const RESIDUAL_RANGE: f32 = 4.0;
/// Reflectance at normal incidence that is shown white: that of sapphire, twice that of most things.
const KAPPA_WHITE: f32 = 0.08;
/// The share of albedos whose standard deviation must not clip, and the least one that is shown as white.
const ALBEDO_DOUBT: (f64, f32) = (0.98, 0.05);

/// The reflectance at normal incidence that is shown white: [`KAPPA_WHITE`], or the object's greatest where that is more, so that none
/// is cut off; in whole hundredths.
pub(super) fn kappa_white(solved: &Reconstruction) -> f32 {
    let vertices = solved.vertex_materials.iter().map(|m| m.kappa);
    let materials = solved.materials.iter().filter(|m| m.channels == 5);
    let pixels = materials.flat_map(|m| m.data.iter().skip(4).step_by(5).copied());
    let most = vertices.chain(pixels).fold(KAPPA_WHITE, f32::max);
    (100.0 * most.min(1.0)).ceil() / 100.0
}

/// The standard deviation of an albedo that is shown as white: two digits.
pub(super) fn doubt_white(solved: &Reconstruction) -> f32 {
    let (share, least) = ALBEDO_DOUBT;
    let deviations = solved.uncertainty.as_ref().map(|doubt| doubt.albedo.iter());
    let images: Vec<&Image> = deviations.into_iter().flatten().collect();
    // Off the object there are none.
    let known = |number: usize, index: usize| {
        let image = images[number];
        image.data[index * image.channels] > 0.0
    };
    let white = 1.0 / exposure(&images, share, known);
    (100.0 * white.clamp(least, 1.0)).ceil() / 100.0
}

/// The PNG of display values (sRGB-encoded, in [0, 1]) as a URI to put into a page.
pub(crate) fn data_uri(display: &Image) -> Result<String, ImageIoError> {
    let png = encode_png8(display, Path::new("report.html"))?;
    Ok(format!("data:image/png;base64,{}", STANDARD.encode(png)))
}

/// The values of an image as base64 of little-endian floats.
pub(super) fn floats(image: &Image) -> String {
    let bytes: Vec<u8> = image
        .data
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    STANDARD.encode(bytes)
}

/// Factor that brings the `quantile` of the values kept by `keep(pixel index)` to display white.
pub(crate) fn exposure(
    images: &[&Image],
    quantile: f64,
    keep: impl Fn(usize, usize) -> bool,
) -> f32 {
    let mut values = Vec::new();
    for (number, image) in images.iter().enumerate() {
        for (index, pixel) in image.data.chunks_exact(image.channels).enumerate() {
            if keep(number, index) {
                values.extend(
                    pixel
                        .iter()
                        .take(3)
                        .copied()
                        .reduce(f32::max)
                        .filter(|v| v.is_finite()),
                );
            }
        }
    }
    if values.is_empty() {
        return 1.0;
    }
    let rank = ((values.len() - 1) as f64 * quantile) as usize;
    let (_, value, _) = values.select_nth_unstable_by(rank, f32::total_cmp);
    if *value > 0.0 { 1.0 / *value } else { 1.0 }
}

/// Linear values (the first three channels) for display.
pub(crate) fn tonemapped(image: &Image, exposure: f32) -> Image {
    let rgb =
        |pixel: &[f32]| std::array::from_fn(|c| encode(exposure * pixel[c.min(pixel.len() - 1)]));
    map(image, rgb)
}

/// One channel of an image as grey, `white` shown white, without a tone curve.
pub(super) fn grey(image: &Image, channel: usize, white: f32) -> Image {
    map(image, |pixel| [(pixel[channel] / white).clamp(0.0, 1.0); 3])
}

/// The deviation σ of an environment's texels beside their radiance L, σ ∕ (σ + L) of the means over channels: black is sure, the
/// middle unsure by the whole value.
pub(super) fn doubt(environment: &Image, deviation: &Image) -> Image {
    let mut share = Image::filled(environment.width, environment.height, 1, 0.0);
    let texels = environment.data.chunks_exact(3);
    for (out, (light, deviation)) in share
        .data
        .iter_mut()
        .zip(texels.zip(deviation.data.chunks_exact(3)))
    {
        let deviation = deviation.iter().sum::<f32>();
        *out = deviation / (deviation + light.iter().sum::<f32>()).max(f32::MIN_POSITIVE);
    }
    grey(&share, 0, 1.0)
}

/// Photograph minus render on pixels that the object covers: blue is too bright a render, red too dark.
///
/// The mean over channels is shown in units of its standard deviation, or of `scale` when the noise is unknown.
pub(super) fn residual(
    photograph: &Image,
    render: &Image,
    mask: &Image,
    noise: Option<Noise>,
    scale: f32,
) -> Image {
    let mut display = Image::filled(photograph.width, photograph.height, 3, 0.96);
    for (index, out) in display.data.chunks_exact_mut(3).enumerate() {
        if mask.data[index * mask.channels] < 0.5 {
            continue;
        }
        let seen = &photograph.data[index * photograph.channels..][..3];
        let model = &render.data[index * render.channels..][..3];
        let difference: f32 = seen.iter().zip(model).map(|(a, b)| a - b).sum::<f32>() / 3.0;
        let unit = noise.map_or(scale, |noise| {
            let variance: f64 = model
                .iter()
                .map(|&value| noise.sigma(value.into()).powi(2))
                .sum();
            (variance.sqrt() / 3.0) as f32
        });
        let amount = (difference / unit / RESIDUAL_RANGE).clamp(-1.0, 1.0);
        out.copy_from_slice(&diverging(amount));
    }
    display
}

/// The environment for display with blocked light in one colour.
pub(super) fn blocked(environment: &Image, mask: &Image, exposure: f32) -> Image {
    let mut display = tonemapped(environment, exposure);
    if (mask.width, mask.height) == (display.width, display.height) {
        for (pixel, passes) in display
            .data
            .chunks_exact_mut(3)
            .zip(mask.data.chunks_exact(mask.channels))
        {
            let passes = passes[0].clamp(0.0, 1.0);
            for channel in 0..3 {
                pixel[channel] = passes * pixel[channel] + (1.0 - passes) * BLOCKED[channel];
            }
        }
    }
    display
}

/// An image no larger than `side` either way: blocks of whole pixels averaged.
pub(crate) fn reduced(image: &Image, side: usize) -> Image {
    let step = image.width.max(image.height).div_ceil(side).max(1);
    if step == 1 {
        return image.clone();
    }
    let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
    let mut small = Image::filled(width, height, image.channels, 0.0);
    for y in 0..height {
        for x in 0..width {
            let rows = y * step..((y + 1) * step).min(image.height);
            let columns = x * step..((x + 1) * step).min(image.width);
            let count = (rows.len() * columns.len()) as f32;
            for row in rows {
                for column in columns.clone() {
                    let pixel = image.pixel(column, row);
                    for (sum, value) in small.pixel_mut(x, y).iter_mut().zip(pixel) {
                        *sum += value / count;
                    }
                }
            }
        }
    }
    small
}

fn map(image: &Image, rgb: impl Fn(&[f32]) -> [f32; 3]) -> Image {
    let data = image
        .data
        .chunks_exact(image.channels)
        .flat_map(rgb)
        .collect();
    Image {
        width: image.width,
        height: image.height,
        channels: 3,
        data,
    }
}

fn encode(linear: f32) -> f32 {
    linear_to_srgb(linear.clamp(0.0, 1.0))
}

/// White at 0, blue at −1, red at 1, luminance falling evenly either way.
fn diverging(amount: f32) -> [f32; 3] {
    let end = if amount < 0.0 {
        [0.13, 0.40, 0.67]
    } else {
        [0.70, 0.09, 0.17]
    };
    std::array::from_fn(|c| 0.96 + amount.abs() * (end[c] - 0.96))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(rgb: [f32; 3]) -> Image {
        Image {
            width: 1,
            height: 1,
            channels: 3,
            data: rgb.to_vec(),
        }
    }

    #[test]
    fn residuals_are_signed_in_sigma_and_blank_off_the_object() {
        let noise = Some(Noise {
            read: 0.03,
            shot: 0.0,
            relative: 0.0,
        });
        let object = Image::filled(1, 1, 1, 1.0);
        // The mean of three channels has a deviation of 0.03/√3: 4 of them saturate.
        let saturated = 4.0 * 0.03 / 3f32.sqrt();
        let brighter = residual(
            &one([0.5 + saturated; 3]),
            &one([0.5; 3]),
            &object,
            noise,
            1.0,
        );
        assert!((brighter.data[0] - 0.70).abs() < 1e-3 && brighter.data[2] < 0.2);
        let darker = residual(
            &one([0.5 - saturated; 3]),
            &one([0.5; 3]),
            &object,
            noise,
            1.0,
        );
        assert!((darker.data[2] - 0.67).abs() < 1e-3 && darker.data[0] < 0.2);
        let off = Image::filled(1, 1, 1, 0.0);
        assert_eq!(
            residual(&one([9.0; 3]), &one([0.0; 3]), &off, noise, 1.0).data,
            [0.96; 3]
        );
    }

    #[test]
    fn blocked_light_takes_the_overlays_colour() {
        let black = one([0.0; 3]);
        let half: Vec<f32> = BLOCKED.iter().map(|value| 0.5 * value).collect();
        assert_eq!(
            blocked(&black, &Image::filled(1, 1, 1, 0.0), 1.0).data,
            BLOCKED
        );
        assert_eq!(
            blocked(&black, &Image::filled(1, 1, 1, 0.5), 1.0).data,
            half
        );
        assert_eq!(
            blocked(&black, &Image::filled(1, 1, 1, 1.0), 1.0).data,
            [0.0; 3]
        );
    }

    #[test]
    fn reduction_averages_blocks_and_keeps_small_images() {
        let image = Image {
            width: 4,
            height: 2,
            channels: 1,
            data: vec![0., 2., 4., 4., 2., 4., 4., 4.],
        };
        assert_eq!(reduced(&image, 4), image);
        assert_eq!(reduced(&image, 2).data, [2.0, 4.0]);
    }

    #[test]
    fn exposure_brings_the_quantile_to_white() {
        let image = Image {
            width: 4,
            height: 1,
            channels: 1,
            data: vec![1.0, 2.0, 4.0, 100.0],
        };
        assert_eq!(exposure(&[&image], 1.0, |_, index| index < 3), 0.25);
        assert_eq!(exposure(&[&image], 0.5, |_, _| true), 0.5);
        assert_eq!(exposure(&[&image], 0.5, |_, _| false), 1.0);
    }
}
