//! One Gauss-Newton step of everything that is fitted.

use autodiff::RunError;
use rayon::prelude::*;

use super::{Fit, FitError, lobe};
use crate::criticism::{
    chain::Chain,
    formation::Formation,
    linear::{conjugate_gradients, dot},
    study::Study,
};

/// Products of conjugate gradients a step.
const PRODUCTS: usize = 30;
/// The largest change of the logarithm of light a step may make.
const LARGEST_STEP: f32 = 1.2;
impl Fit {
    pub(super) fn step(&mut self, study: &Study<'_>, with_lobe: bool) -> Result<(), FitError> {
        let precision = self.precision(study, &|i| study.develops(i));
        let r = self.without_own_albedo(study);
        let mut columns: Vec<(Vec<f32>, f32)> = Vec::new();
        if with_lobe {
            columns.extend(self.lobe_columns(study)?);
        }
        let lobes = columns.len();
        let mut chain = Chain::new(&self.links, study.seen.len())?;
        let betas = self.betas(study, &chain);
        chain.bind(&self.ideal, &betas)?;
        for (l, link) in chain.links().to_vec().iter().enumerate() {
            for (k, term) in link.terms.iter().enumerate() {
                let scale = term.scale as f32;
                let column = chain.column(l, k)?.iter().map(|x| scale * x).collect();
                columns.push((column, self.beta(link.effect.id(), k) as f32 / scale));
            }
        }
        let lights = self.parameters.light.len();
        let textures = self.parameters.texture.len();
        let views = 3 * study.seen.views.len();
        let mut ws = self.formation.workspace(&self.parameters, 1)?;
        let mut pull = |formation: &Formation, weights: &[f32]| -> Result<Vec<f32>, RunError> {
            let own: Vec<f32> = (0..views).map(|i| self.slope[i] * weights[i]).collect();
            let (mut g, texture) = formation.pull(&mut ws, &own)?;
            g.extend(texture);
            let inner: Vec<f32> = columns
                .par_iter()
                .map(|(column, _)| dot(column, weights) as f32)
                .collect();
            g.extend(inner);
            Ok(g)
        };
        let mut at = self.parameters.light.clone();
        at.extend(&self.parameters.texture);
        at.extend(columns.iter().map(|(_, at)| *at));
        let mut right = pull(&self.formation, &precision.apply(&r))?;
        right.iter_mut().zip(&at).for_each(|(g, z)| *g -= z);

        let mut ws = self.formation.workspace(&self.parameters, 1)?;
        let mut failed = None;
        let mut delta = vec![0.0; at.len()];
        let slope = &self.slope;
        let formation = &self.formation;
        conjugate_gradients(&mut delta, &right, PRODUCTS, 1e-3, |v| {
            let mut run = || -> Result<Vec<f32>, RunError> {
                let mut moved =
                    formation.push(&mut ws, &v[..lights], &v[lights..lights + textures])?;
                moved
                    .iter_mut()
                    .zip(slope)
                    .for_each(|(m, slope)| *m *= slope);
                moved.resize(3 * study.seen.len(), 0.0);
                for ((column, _), factor) in columns.iter().zip(&v[lights + textures..]) {
                    if *factor != 0.0 {
                        moved
                            .iter_mut()
                            .zip(column)
                            .for_each(|(m, c)| *m += factor * c);
                    }
                }
                let mut back = pull(formation, &precision.apply(&moved))?;
                back.iter_mut().zip(v).for_each(|(b, v)| *b += v);
                Ok(back)
            };
            run().unwrap_or_else(|error| {
                failed = Some(error);
                vec![0.0; v.len()]
            })
        });
        if let Some(error) = failed {
            return Err(error.into());
        }
        let before = self.cost(study) + 0.5 * dot(&at, &at);
        let own = self.parameters.clone();
        let (lobe_before, betas_before) = (self.lobe, self.active.clone());
        let order: Vec<&'static str> = chain.links().iter().map(|l| l.effect.id()).collect();
        let mut share = self.allowed(&delta[..lights]);
        for _ in 0..4 {
            self.parameters = own.clone();
            self.active = betas_before.clone();
            (0..lights).for_each(|i| self.parameters.light[i] += share * delta[i]);
            (0..textures).for_each(|i| self.parameters.texture[i] += share * delta[lights + i]);
            self.move_effects(&order, &delta[lights + textures + lobes..], share);
            if with_lobe && let Some(old) = lobe_before {
                let step = &delta[lights + textures..];
                self.lobe = Some(lobe::moved(old, share * step[0], share * step[1]));
                self.bare = self.transport(study);
            }
            self.form(study)?;
            self.evaluate(study)?;
            let mut z = self.parameters.light.clone();
            z.extend(&self.parameters.texture);
            let beyond: f64 = (0..columns.len())
                .map(|k| {
                    f64::from(at[lights + textures + k] + share * delta[lights + textures + k])
                        .powi(2)
                })
                .sum();
            if self.cost(study) + 0.5 * (dot(&z, &z) + beyond) <= before {
                return Ok(());
            }
            share *= 0.4;
        }
        self.parameters = own;
        self.active = betas_before;
        if self.lobe != lobe_before {
            self.lobe = lobe_before;
            self.bare = self.transport(study);
        }
        self.form(study)?;
        self.evaluate(study)
    }

    /// Moves the effects' numbers, given in the chain's order and in units of their scales.
    fn move_effects(&mut self, order: &[&'static str], delta: &[f32], share: f32) {
        let mut next = 0;
        for id in order {
            let Some(at) = self.active.iter().position(|a| a.effect.id() == *id) else {
                continue;
            };
            let link = &self.links[at];
            for (b, term) in self.active[at].beta.iter_mut().zip(link.terms.iter()) {
                *b =
                    (*b + f64::from(share * delta[next]) * term.scale).clamp(term.least, term.most);
                next += 1;
            }
        }
    }

    /// Which part of a step of light keeps its change small.
    fn allowed(&self, light: &[f32]) -> f32 {
        let change = self.formation.light.change(light);
        let largest = change.iter().fold(0.0f32, |m, c| m.max(c.abs()));
        (LARGEST_STEP / largest.max(1e-9)).min(1.0)
    }
}
