//! The nuisance at its best: light, texture and lobe refitted, together with the effects that are in the model already.
//!
//! Gauss-Newton with conjugate gradients on products of the tape. Each site's own albedo is a random effect with a
//! deviation τ that is estimated on the way: its contribution to the variance is projected out in closed form.

mod lobe;
mod spread;

use std::sync::Arc;

use autodiff::{GraphError, RunError};
use rayon::prelude::*;

use super::{
    chain::{Chain, ChainError, Link},
    effects::Effect,
    formation::{Formation, Parameters},
    linear::{conjugate_gradients, dot},
    precision::Precision,
    scene::Scene,
    study::Study,
    transport::Lobe,
};

/// Products of conjugate gradients a step.
const PRODUCTS: usize = 30;
/// The largest change of the logarithm of light a step may make.
const LARGEST_STEP: f32 = 1.2;
/// An effect in the model with its numbers.
#[derive(Clone)]
pub struct Active {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Its numbers.
    pub beta: Vec<f64>,
}

/// A fitted model.
pub struct Fit {
    /// Light and texture.
    pub parameters: Parameters,
    /// The lobe, unless the surface is Lambertian.
    pub lobe: Option<Lobe>,
    /// Image formation under that lobe.
    pub formation: Formation,
    /// Effects in the model.
    pub active: Vec<Active>,
    /// Deviation of sites' albedo from the smooth texture, by colour.
    pub tau: [f64; 3],
    /// What the variances of observations are multiplied with.
    pub inflation: f64,
    /// The same for the background.
    pub dark_inflation: f64,
    /// Trust in each value, (0, 1], by Huber's rule.
    pub trust: Vec<f32>,
    /// Radiance, `[texel][colour]`.
    pub radiance: Vec<f32>,
    /// Albedo, `[site][colour]`.
    pub albedo: Vec<f32>,
    /// Light on an albedo of one, `[view][colour]`.
    pub diffuse: Vec<f32>,
    /// Specular light.
    pub specular: Vec<f32>,
    /// Values before effects, `[observation][colour]`.
    pub ideal: Vec<f32>,
    /// Values after effects.
    pub value: Vec<f32>,
    /// Derivative of the latter by the former.
    pub slope: Vec<f32>,
    /// Links of the active effects, as fields were when it was last linearised.
    pub links: Vec<Link>,
}

impl Fit {
    /// A first model: the simulation's light and lobe, a plain texture.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn start(study: &Study<'_>) -> Result<Self, FitError> {
        let lobe = study.lobe;
        let formation = study.formation(lobe)?;
        let mut parameters = formation.zero();
        parameters.light = formation.light_like(&study.radiance);
        let size = 3 * study.seen.len();
        let mut fit = Self {
            parameters,
            lobe,
            formation,
            active: Vec::new(),
            tau: [0.05; 3],
            inflation: 1.0,
            dark_inflation: 1.0,
            trust: vec![1.0; size],
            radiance: Vec::new(),
            albedo: Vec::new(),
            diffuse: Vec::new(),
            specular: Vec::new(),
            ideal: Vec::new(),
            value: Vec::new(),
            slope: Vec::new(),
            links: Vec::new(),
        };
        fit.evaluate(study)?;
        Ok(fit)
    }

    /// The same model with another formation: what cannot be cloned is made anew.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn duplicate(&self, study: &Study<'_>) -> Result<Self, FitError> {
        let mut fit = Self {
            parameters: self.parameters.clone(),
            lobe: self.lobe,
            formation: study.formation_with(self.formation.transport().clone())?,
            active: self.active.clone(),
            tau: self.tau,
            inflation: self.inflation,
            dark_inflation: self.dark_inflation,
            trust: self.trust.clone(),
            radiance: Vec::new(),
            albedo: Vec::new(),
            diffuse: Vec::new(),
            specular: Vec::new(),
            ideal: Vec::new(),
            value: Vec::new(),
            slope: Vec::new(),
            links: self.links.clone(),
        };
        fit.evaluate(study)?;
        Ok(fit)
    }

    /// The scene that effects look at.
    pub fn scene<'a>(&'a self, study: &'a Study<'_>) -> Scene<'a> {
        Scene {
            capture: study.capture,
            bvh: &study.bvh,
            seen: &study.seen,
            horizon: &study.horizon,
            transport: self.formation.transport(),
            lobe: self.lobe,
            radiance: &self.radiance,
            albedo: &self.albedo,
            diffuse: &self.diffuse,
            specular: &self.specular,
            value: &self.ideal,
            renders: &study.renders,
            radius: study.radius,
        }
    }

    /// Residual of every value: photograph minus model.
    pub fn residual(&self, study: &Study<'_>) -> Vec<f32> {
        study
            .value
            .iter()
            .zip(&self.value)
            .map(|(y, m)| y - m)
            .collect()
    }

    /// Weights and random albedo of the present model, of the observations that `counted` names.
    pub fn precision(&self, study: &Study<'_>, counted: &dyn Fn(usize) -> bool) -> Precision {
        self.precision_with(study, counted, self.tau)
    }

    /// The same for another deviation of sites' own albedo.
    pub fn precision_with(
        &self,
        study: &Study<'_>,
        counted: &dyn Fn(usize) -> bool,
        tau: [f64; 3],
    ) -> Precision {
        let views = study.seen.views.len();
        let weight: Vec<f32> = (0..study.value.len())
            .map(|i| {
                if counted(i / 3) {
                    self.trust[i] / (study.variance[i] * self.scale(i, views) as f32)
                } else {
                    0.0
                }
            })
            .collect();
        let shading: Vec<f32> = (0..3 * views)
            .map(|i| self.slope[i] * self.diffuse[i])
            .collect();
        Precision::new(&study.seen.offsets, weight, shading, tau)
    }

    /// Recomputes everything that follows from the parameters.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn evaluate(&mut self, study: &Study<'_>) -> Result<(), FitError> {
        let mut ws = self.formation.workspace(&self.parameters, 1)?;
        self.formation.forward(&mut ws)?;
        self.radiance = ws.output("radiance")?.to_vec();
        self.albedo = ws.output("albedo")?.to_vec();
        self.diffuse = ws.output("diffuse")?.to_vec();
        self.specular = ws.output("specular")?.to_vec();
        self.ideal = ws.output("value")?.to_vec();
        self.ideal.resize(3 * study.seen.len(), 0.0);
        let mut chain = Chain::new(&self.links, study.seen.len())?;
        chain.bind(&self.ideal, &self.betas(&chain))?;
        self.value = chain.values()?;
        self.slope = chain.slope(study.seen.len())?;
        Ok(())
    }

    /// Numbers of the active effects in the order of a chain.
    pub fn betas(&self, chain: &Chain) -> Vec<Vec<f64>> {
        chain
            .links()
            .iter()
            .map(|link| {
                let own = self
                    .active
                    .iter()
                    .find(|a| a.effect.id() == link.effect.id());
                own.map_or_else(|| vec![0.0; link.terms.len()], |a| a.beta.clone())
            })
            .collect()
    }

    /// Adds an effect at its null, or at `beta`.
    pub fn add(&mut self, effect: &'static dyn Effect, beta: Vec<f64>) {
        self.active.push(Active { effect, beta });
    }

    /// Fields of the active effects for the model as it stands.
    pub fn relink(&mut self, study: &Study<'_>) -> Result<(), FitError> {
        let links: Vec<Link> = {
            let scene = self.scene(study);
            self.active
                .iter()
                .map(|active| Link {
                    effect: active.effect,
                    terms: Arc::new(active.effect.terms(&scene)),
                })
                .collect()
        };
        for (active, link) in self.active.iter_mut().zip(&links) {
            active.beta.resize(link.terms.len(), 0.0);
        }
        self.links = links;
        self.evaluate(study)
    }

    /// Takes up to `steps` steps on the development data.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn refine(&mut self, study: &Study<'_>, steps: usize) -> Result<(), FitError> {
        for step in 0..steps {
            self.relink(study)?;
            let lobe = self.lobe.is_some();

            let before = self.cost(study);
            self.step(study, lobe)?;
            self.site_albedo(study)?;
            if step > 0 {
                self.variances(study);
            }
            let after = self.cost(study);
            tracing::debug!(step, before, after, "nuisance step");
            if step > 2 && before - after < 1e-3 * after.abs() && before >= after {
                break;
            }
        }
        Ok(())
    }

    /// ½ rᵀ V⁻¹ r with the site's own albedo integrated out.
    fn cost(&self, study: &Study<'_>) -> f64 {
        let precision = self.precision(study, &|i| study.develops(i));
        let r = self.without_own_albedo(study);
        0.5 * dot(&r, &precision.apply(&r))
    }

    /// Residuals as if no site had an albedo of its own.
    fn without_own_albedo(&self, study: &Study<'_>) -> Vec<f32> {
        let mut r = self.residual(study);
        for (v, view) in study.seen.views.iter().enumerate() {
            for c in 0..3 {
                let i = 3 * v + c;
                let own = self.parameters.deviation[3 * view.site as usize + c];
                r[i] += self.slope[i] * self.diffuse[i] * own;
            }
        }
        r
    }

    fn step(&mut self, study: &Study<'_>, with_lobe: bool) -> Result<(), FitError> {
        let precision = self.precision(study, &|i| study.develops(i));
        let r = self.without_own_albedo(study);
        let mut columns: Vec<(Vec<f32>, f32)> = Vec::new();
        if with_lobe {
            columns.extend(self.lobe_columns(study)?);
        }
        let lobes = columns.len();
        let mut chain = Chain::new(&self.links, study.seen.len())?;
        let betas = self.betas(&chain);
        chain.bind(&self.ideal, &betas)?;
        for (l, link) in chain.links().to_vec().iter().enumerate() {
            for (k, term) in link.terms.iter().enumerate() {
                let scale = term.scale as f32;
                let column = chain.column(l, k)?.iter().map(|x| scale * x).collect();
                columns.push((column, betas[l][k] as f32 / scale));
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
                self.formation = study.formation(self.lobe)?;
            }
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
            self.formation = study.formation(self.lobe)?;
        }
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
                *b = (*b + f64::from(share * delta[next]) * term.scale).max(term.least);
                next += 1;
            }
        }
    }

    /// Which part of a step of light keeps its change small.
    fn allowed(&self, light: &[f32]) -> f32 {
        let formation = &self.formation;
        let scaled: Vec<f32> = (0..light.len())
            .map(|i| light[i] * formation.deviation[i / 3])
            .collect();
        let mut change = vec![0.0; 3 * formation.grid.len()];
        formation.pyramid.apply(&scaled, &mut change, 3);
        let largest = change.iter().fold(0.0f32, |m, c| m.max(c.abs()));
        (LARGEST_STEP / largest.max(1e-9)).min(1.0)
    }
}

/// The tape failed; always a bug of this program.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// It did not compile.
    #[error("the diagnosis failed: {0}; please report this with the capture")]
    Graph(#[from] GraphError),
    /// It refused what it was given.
    #[error("the diagnosis failed: {0}; please report this with the capture")]
    Run(#[from] RunError),
    /// A chain of effects failed.
    #[error("the diagnosis failed: {0}; please report this with the capture")]
    Chain(#[from] ChainError),
}
