//! Whole frames as the fitted models explain them, from the sites in between.

use rayon::prelude::*;
use render::image::Image;

use super::{diagnose::Outcome, effects::support::sample, fit::Fit};

/// Images of one frame; the pairs are before and after.
pub struct Maps {
    /// The last model's image.
    pub model: Image,
    /// Photograph minus model, three channels.
    pub residual: [Image; 2],
    /// The mean over channels of the residual in units of its standard deviation; NaN off the object.
    pub significance: [Image; 2],
}

/// Of all frames.
///
/// The simulation's render gives the detail; the ratio of the model at the sites to it, smoothed over a few pixels, corrects it.
/// A little is added to both before, so that in the dark it is their difference that counts.
pub fn frames(outcome: &Outcome<'_>) -> Vec<Maps> {
    (0..outcome.study.seen.frames)
        .into_par_iter()
        .map(|t| frame(outcome, t))
        .collect()
}

fn frame(outcome: &Outcome<'_>, t: usize) -> Maps {
    let study = &outcome.study;
    let photograph = &study.capture.frames[t];
    let (width, height) = (photograph.image.width, photograph.image.height);
    let models = [&outcome.before, &outcome.after].map(|fit| model(outcome, fit, t));
    let residual = [0, 1].map(|k: usize| {
        let mut image = Image::filled(width, height, 3, 0.0);
        for (p, out) in image.data.chunks_exact_mut(3).enumerate() {
            if photograph.mask.data[p] > 0.999 {
                for c in 0..3 {
                    out[c] = photograph.image.data[3 * p + c] - models[k].data[3 * p + c];
                }
            }
        }
        image
    });
    let significance = [0, 1].map(|k: usize| {
        let mut image = Image::filled(width, height, 1, f32::NAN);
        for (p, out) in image.data.iter_mut().enumerate() {
            if photograph.mask.data[p] > 0.999 {
                let mean = |of: &[f32]| of[3 * p..3 * p + 3].iter().sum::<f32>() / 3.0;
                let noise = study.noise.sigma(f64::from(mean(&models[k].data))) as f32;
                *out = mean(&residual[k].data) / (noise / 3f32.sqrt()).max(1e-9);
            }
        }
        image
    });
    let [_, model] = models;
    Maps {
        model,
        residual,
        significance,
    }
}

fn model(outcome: &Outcome<'_>, fit: &Fit, t: usize) -> Image {
    let study = &outcome.study;
    let render = &study.renders[t];
    let mask = &study.capture.frames[t].mask;
    let floor = 0.05 * fit.scene(study).typical();
    let views: Vec<([f32; 2], [f32; 3])> = study
        .seen
        .views
        .iter()
        .enumerate()
        .filter(|&(v, view)| view.frame as usize == t && study.has_known_albedo(v))
        .map(|(v, view)| {
            let there = sample(render, view.at);
            let ratio = [0, 1, 2]
                .map(|c| (fit.value[3 * v + c].max(0.0) + floor) / (there[c].max(0.0) + floor))
                .map(|ratio| ratio.clamp(0.1, 10.0));
            (view.at, ratio)
        })
        .collect();
    let reach = (render.width as f32 / 40.0).max(1.5);
    let mut image = render.clone();
    for (p, out) in image.data.chunks_exact_mut(3).enumerate() {
        if mask.data[p] <= 0.0 {
            continue;
        }
        let (x, y) = (
            (p % render.width) as f32 + 0.5,
            (p / render.width) as f32 + 0.5,
        );
        let mut sums = [0.0f32; 4];
        for ([vx, vy], ratio) in &views {
            let d = ((vx - x).powi(2) + (vy - y).powi(2)) / (reach * reach);
            // Far away the nearest still decide: a heavier tail than a Gaussian's.
            let weight = 1.0 / (1.0 + d).powi(3);
            (0..3).for_each(|c| sums[c] += weight * ratio[c]);
            sums[3] += weight;
        }
        if sums[3] > 0.0 {
            (0..3).for_each(|c| out[c] = (out[c] + floor) * sums[c] / sums[3] - floor);
        }
    }
    image
}
