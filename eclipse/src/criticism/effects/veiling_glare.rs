//! Light that the lens scatters over the image.

use std::sync::Arc;

use autodiff::Var;

use render::image::Image;

use super::{
    Effect, Recorded, Stage, Term,
    camera_map::CameraMap,
    support::{sample, widely_blurred},
};
use crate::{capture::Capture, criticism::scene::Scene};

/// (1 − k) I + k · PSF ∗ I for three widths of the point-spread function; the field holds PSF ∗ I.
pub struct VeilingGlare;

/// Names and widths of the point-spread function, as shares of the image's width; the widest is all but flat.
const VEILS: [(&str, f32); 3] = [("narrow", 0.04), ("middle", 0.12), ("wide", 0.4)];
/// A lens that scatters more than this share is fog.
const MOST: f32 = 0.8;

impl Effect for VeilingGlare {
    fn id(&self) -> &'static str {
        "veiling_glare"
    }
    fn describe(&self) -> &'static str {
        "the lens scatters part of the light over the image"
    }
    fn stage(&self) -> Stage {
        Stage::Glare
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["black_level", "defocus", "medium"]
    }
    fn shown_by(&self) -> &'static str {
        "take one view again with all that is bright around the object covered in black cloth: scattered light goes with it"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        VEILS
            .into_iter()
            .map(|(name, share)| {
                let veils = veils(scene.capture, share);
                let field = scene
                    .everywhere(|i| sample(&veils[scene.seen.frame(i) as usize], scene.seen.at(i)));
                Term::new(format!("k of the {name} veil"), 0.05, field).positive()
            })
            .collect()
    }
    fn is_of_the_camera(&self) -> bool {
        true
    }
    fn camera_map(&self, capture: &Capture, numbers: &[f64]) -> Option<CameraMap> {
        if numbers.len() != VEILS.len() {
            return None;
        }
        let shares: Vec<f32> = numbers.iter().map(|&k| k.max(0.0) as f32).collect();
        let all: f32 = shares.iter().sum();
        if all > MOST {
            return None;
        }
        let veils = VEILS.map(|(_, width)| veils(capture, width));
        let veil: Arc<Vec<Image>> = Arc::new(
            (0..capture.frames.len())
                .map(|frame| {
                    let mut sum = capture.frames[frame].image.clone();
                    sum.data.fill(0.0);
                    for (k, veil) in shares.iter().zip(&veils) {
                        let values = sum.data.iter_mut().zip(&veil[frame].data);
                        values.for_each(|(s, v)| *s += k * v);
                    }
                    sum
                })
                .collect(),
        );
        let undone = veil.clone();
        Some(CameraMap {
            apply: Box::new(move |frame, image| {
                let values = image.data.iter_mut().zip(&veil[frame].data);
                values.for_each(|(v, veil)| *v = (1.0 - all) * *v + veil);
            }),
            undo: Box::new(move |frame, image| {
                let values = image.data.iter_mut().zip(&undone[frame].data);
                values.for_each(|(v, veil)| *v = (*v - veil) / (1.0 - all));
            }),
        })
    }
    fn is_of_one_sum(&self) -> bool {
        false
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        terms.iter().fold(value.clone(), |out, term| {
            out + &term.beta * (&term.field - value)
        })
    }
}

/// Photographs under a wide blur. Not renders: the glare of what the object stands before is in them too, and so wide a mean
/// holds no noise that a value could share.
fn veils(capture: &Capture, share: f32) -> Vec<Image> {
    let frames = capture.frames.iter();
    frames
        .map(|f| widely_blurred(&f.image, share * f.image.width as f32))
        .collect()
}
