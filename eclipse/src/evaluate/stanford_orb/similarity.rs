//! The three scores of one view.

use render::image::Image;

use super::{Similarity, ssim::ssim};
use crate::image_io::linear_to_srgb;

/// Pixels across and down of everything that is compared.
pub const RESOLUTION: usize = 512;

/// The mask is shrunk by this many pixels: its boundary is inexact.
const SHRINK: usize = 2;
/// Linear values above this are clipped in PSNR-H.
const MOST_LINEAR: f64 = 4.0;
/// A channel with less energy than this is scaled as if it were 1 everywhere.
const LEAST_ENERGY: f64 = 1e-6;
/// What a missing prediction is taken for: no score is below this grey's.
const GREY: f64 = 0.5;

/// Whether predictions are scaled before they are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// By the best factor of each channel, as the benchmark's tables have it.
    #[default]
    Best,
    /// Not at all.
    None,
}

/// Scores a prediction against a photograph, both linear RGB, on the pixels of `mask` (coverage, cut at ½).
///
/// # Panics
/// When the images differ in size.
pub fn similarity(
    prediction: &Image,
    photograph: &Image,
    mask: &Image,
    scale: Scale,
) -> Similarity {
    let size = |image: &Image| [image.width, image.height];
    assert!(size(prediction) == size(photograph) && size(prediction) == size(mask));
    let object = shrunk(mask);
    let masked = |image: &Image| -> Vec<[f64; 3]> {
        let pixels = image.data.chunks_exact(image.channels).zip(&object);
        pixels
            .map(|(pixel, &inside)| {
                let value = |channel: usize| f64::from(pixel[channel]).max(0.0);
                if inside {
                    [value(0), value(1), value(2)]
                } else {
                    [0.0; 3]
                }
            })
            .collect()
    };
    let (mut guess, truth) = (masked(prediction), masked(photograph));
    if scale == Scale::Best {
        let factors = best_scale(&guess, &truth, &object);
        for pixel in &mut guess {
            (0..3).for_each(|channel| pixel[channel] *= factors[channel]);
        }
    }

    let brightness = brightness(&truth);
    let bright = |v: f64| (brightness * v).min(MOST_LINEAR);
    let [guess_h, truth_h] = [&guess, &truth].map(|image| each(image, bright));
    let shown = |v: f64| f64::from(linear_to_srgb(v.min(1.0) as f32));
    let [guess_l, truth_l] = [&guess, &truth].map(|image| each(image, shown));
    Similarity {
        psnr_h: psnr(&guess_h, &truth_h, &object),
        psnr_l: psnr(&guess_l, &truth_l, &object),
        ssim: ssim(&guess_l, &truth_l, prediction.width),
    }
}

fn each(image: &[[f64; 3]], change: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
    image.iter().map(|pixel| pixel.map(&change)).collect()
}

/// Pixels whose whole neighbourhood is the object's; beyond the picture's edge counts as such.
fn shrunk(mask: &Image) -> Vec<bool> {
    let covered: Vec<bool> = mask
        .data
        .iter()
        .step_by(mask.channels)
        .map(|&coverage| coverage > 0.5)
        .collect();
    let (width, height) = (mask.width, mask.height);
    let around = |at: usize, end: usize| at.saturating_sub(SHRINK)..(at + SHRINK + 1).min(end);
    (0..width * height)
        .map(|pixel| {
            let (x, y) = (pixel % width, pixel / width);
            around(y, height).all(|y| around(x, width).all(|x| covered[y * width + x]))
        })
        .collect()
}

/// Σ truth·guess / Σ guess² of each channel over the object.
fn best_scale(guess: &[[f64; 3]], truth: &[[f64; 3]], object: &[bool]) -> [f64; 3] {
    std::array::from_fn(|channel| {
        let pairs = guess.iter().zip(truth).zip(object);
        let (mut cross, mut energy, mut alone, mut count) = (0.0, 0.0, 0.0, 0.0);
        for ((guess, truth), _) in pairs.filter(|(_, inside)| **inside) {
            cross += guess[channel] * truth[channel];
            energy += guess[channel] * guess[channel];
            alone += truth[channel];
            count += 1.0;
        }
        if energy > LEAST_ENERGY {
            cross / energy
        } else if count > 0.0 {
            alone / count
        } else {
            1.0
        }
    })
}

/// How much brighter the sRGB curve makes the picture on average: linear pictures look too dark.
fn brightness(truth: &[[f64; 3]]) -> f64 {
    let clipped = || truth.iter().flatten().map(|v| v.clamp(0.0, 1.0));
    let linear: f64 = clipped().sum();
    let encoded: f64 = clipped().map(|v| f64::from(linear_to_srgb(v as f32))).sum();
    let values = 3.0 * truth.len() as f64;
    if linear / values > 1e-8 {
        encoded / linear
    } else {
        1.0
    }
}

/// In decibels against 1, over all pixels of the picture, and at least what grey would have.
fn psnr(guess: &[[f64; 3]], truth: &[[f64; 3]], object: &[bool]) -> f64 {
    let (mut error, mut grey_error) = (0.0, 0.0);
    for ((guess, truth), &inside) in guess.iter().zip(truth).zip(object) {
        let grey = if inside { GREY } else { 0.0 };
        for channel in 0..3 {
            error += (guess[channel] - truth[channel]).powi(2);
            grey_error += (grey - truth[channel]).powi(2);
        }
    }
    let decibels = |sum: f64| -10.0 * (sum / (3.0 * truth.len() as f64)).log10();
    decibels(error).max(decibels(grey_error))
}
