//! How far the materials are off that are relit.

use serde_json::{Value, json};

use crate::studies::{evidence::listed, trial::Solved};

/// How far recovered materials are from the true ones.
#[derive(Clone, Copy)]
pub(super) struct MaterialErrors {
    /// Decibels.
    pub albedo: f64,
    /// RMSE of α and κ, of shiny objects.
    pub lobe: Option<[f64; 2]>,
}

impl MaterialErrors {
    /// Of a result that was scored.
    pub(super) fn of(solved: &Solved) -> Self {
        let of = &solved.scores.materials;
        let lobe = of.alpha_rmse.zip(of.kappa_rmse);
        Self {
            albedo: solved.albedo(),
            lobe: lobe.map(|(alpha, kappa)| [alpha, kappa]),
        }
    }
}

/// The same of every seed, for whoever reads it.
pub(super) fn materials_in_words(all: &[MaterialErrors]) -> String {
    let albedo: Vec<f64> = all.iter().map(|m| m.albedo).collect();
    let lobe = |k: usize| -> Vec<f64> { all.iter().filter_map(|m| Some(m.lobe?[k])).collect() };
    match lobe(0).is_empty() {
        true => format!("albedo {} dB", listed(&albedo)),
        false => format!(
            "albedo {} dB, α off by {}, κ by {}",
            listed(&albedo),
            listed(&lobe(0)),
            listed(&lobe(1))
        ),
    }
}

/// The same for programs, a value a seed; nothing for the lobe of matt objects.
pub(super) fn materials_as_numbers(all: &[MaterialErrors]) -> Value {
    let lobe = |k: usize| -> Vec<Option<f64>> { all.iter().map(|m| Some(m.lobe?[k])).collect() };
    json!({
        "albedo_psnr": all.iter().map(|m| m.albedo).collect::<Vec<_>>(),
        "alpha_rmse": lobe(0),
        "kappa_rmse": lobe(1),
    })
}
