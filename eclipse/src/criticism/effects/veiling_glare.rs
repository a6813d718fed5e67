//! Light that the lens scatters over the image.

use autodiff::Var;

use super::{
    Effect, Recorded, Stage, Term,
    support::{blurred, sample},
};
use crate::criticism::scene::Scene;

/// (1 − k) I + k · PSF ∗ I for three widths of the point-spread function; the field holds PSF ∗ I.
pub struct VeilingGlare;

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
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        // Shares of the image's width; the widest is all but flat.
        [("narrow", 0.04), ("middle", 0.12), ("wide", 0.4)]
            .into_iter()
            .map(|(name, share)| {
                // Photographs, not renders: the glare of what the object stands before is in them too, and so wide a mean
                // holds no noise that a value could share.
                let veils: Vec<_> = scene
                    .capture
                    .frames
                    .iter()
                    .map(|f| blurred(&f.image, share * f.image.width as f32))
                    .collect();
                let field = scene
                    .everywhere(|i| sample(&veils[scene.seen.frame(i) as usize], scene.seen.at(i)));
                Term::new(format!("k of the {name} veil"), 0.05, field).positive()
            })
            .collect()
    }
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        terms.iter().fold(value.clone(), |out, term| {
            out + &term.beta * (&term.field - value)
        })
    }
}
