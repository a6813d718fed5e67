//! The model that derivatives are taken at: a surface of the texture alone.

use super::{Fit, FitError, Study};
use crate::criticism::{chain::Chain, formation::Parameters};

/// A model whose sites have no albedo of their own: what derivatives are taken at.
///
/// Own albedos are noise, of the covariance V, which is not differentiated. Were they in the derivatives, brighter light on a darker
/// surface would always seem better, since V grows with the light and its determinant is not in the cost; and an effect's change would
/// hold a part of the residual that it is to explain.
#[derive(Clone, Debug, Default)]
pub struct Mean {
    /// Albedo, `[site][colour]`.
    pub albedo: Vec<f32>,
    /// Values before effects, `[observation][colour]`.
    pub ideal: Vec<f32>,
    /// Values after effects.
    pub value: Vec<f32>,
    /// Derivative of the latter by the former.
    pub slope: Vec<f32>,
}

impl Fit {
    /// Recomputes it; `chain` holds the effects in the model, and these are their numbers.
    pub(super) fn evaluate_mean(
        &mut self,
        study: &Study<'_>,
        chain: &mut Chain,
        betas: &[Vec<f64>],
    ) -> Result<(), FitError> {
        let own = &self.parameters.deviation;
        let pairs = self.albedo.iter().zip(own);
        self.mean.albedo = pairs.map(|(albedo, own)| albedo - own).collect();
        self.mean.ideal.clone_from(&self.ideal);
        for (v, view) in study.seen.views.iter().enumerate() {
            for c in 0..3 {
                let own = own[3 * view.site as usize + c];
                self.mean.ideal[3 * v + c] -= own * self.diffuse[3 * v + c];
            }
        }
        chain.bind(&self.mean.ideal, betas)?;
        self.mean.value = chain.values()?;
        self.mean.slope = chain.slope(study.seen.len())?;
        Ok(())
    }

    /// The parameters that derivatives are taken at: those of the [mean](Mean).
    pub fn mean_parameters(&self) -> Parameters {
        let mut mean = self.parameters.clone();
        mean.deviation.fill(0.0);
        mean
    }

    /// Residual of every value as if no site had an albedo of its own.
    pub fn residual_of_mean(&self, study: &Study<'_>) -> Vec<f32> {
        let pairs = study.value.iter().zip(&self.mean.value);
        pairs.map(|(y, m)| y - m).collect()
    }
}
