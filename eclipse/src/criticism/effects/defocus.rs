//! An image that is less sharp than the model's.

use render::image::Image;

use super::{
    Effect, Stage, Term,
    support::{blurred, sample},
};
use crate::criticism::scene::Scene;

/// Point-spread blur: the difference of renders blurred by one and by two pixels from themselves.
pub struct Defocus;

impl Effect for Defocus {
    fn id(&self) -> &'static str {
        "defocus"
    }
    fn describe(&self) -> &'static str {
        "the image is blurred"
    }
    fn stage(&self) -> Stage {
        Stage::Optics
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &[
            "finer_albedo",
            "veiling_glare",
            "pose_error",
            "translucency",
        ]
    }
    fn shown_by(&self) -> &'static str {
        "take the same views at a smaller aperture from a tripod: blur of the lens shrinks"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        [1.0f32, 2.0]
            .into_iter()
            .map(|sigma| {
                let images: Vec<(Image, Image)> = scene
                    .renders
                    .iter()
                    .map(|r| (r.clone(), blurred(r, sigma)))
                    .collect();
                let field = scene.everywhere(|i| {
                    let (sharp, soft) = &images[scene.seen.frame(i) as usize];
                    let at = scene.seen.at(i);
                    let (sharp, soft) = (sample(sharp, at), sample(soft, at));
                    [0, 1, 2].map(|c| soft[c] - sharp[c])
                });
                Term::new(format!("share blurred by {sigma} pixels"), 0.5, field).positive()
            })
            .collect()
    }
}
