//! The nuisance at its best: light, texture and lobe refitted, together with the effects that are in the model already.
//!
//! Gauss-Newton with conjugate gradients on products of the tape. Each site's own albedo is a random effect with a
//! deviation τ that is estimated on the way: its contribution to the variance is projected out in closed form.

mod lobe;
mod mean;
mod refine;
mod spread;
mod step;

use std::sync::Arc;

use autodiff::{GraphError, RunError};

pub use mean::Mean;

use super::{
    chain::{Chain, ChainError, Link},
    effects::{Effect, Passing},
    formation::{Formation, Parameters},
    horizon::{Horizon, Source},
    linear::dot,
    nuisance::Nuisance,
    precision::Precision,
    scene::Scene,
    study::Study,
    transport::{Lobe, Transport},
};

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
    /// The light's sources where the model has them, and what the sites receive of them.
    pub horizon: Arc<Horizon>,
    /// Light transport under that lobe, without occluders but those of the simulation.
    pub bare: Arc<Transport>,
    /// Image formation, occluders of the model included.
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
    /// The same of a surface of the texture alone.
    pub mean: Mean,
    /// Links of the active effects, as fields were when it was last linearised.
    pub links: Vec<Link>,
    /// Light and texture as a dense system, as they were at some step.
    nuisance: Option<Arc<Nuisance>>,
    /// Whether the model has gone too far from there.
    worn: bool,
}

impl Fit {
    /// A first model: the simulation's light and lobe, a plain texture.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn start(study: &Study<'_>) -> Result<Self, FitError> {
        let lobe = study.lobe;
        let horizon = study.horizon.clone();
        let bare = Arc::new(study.transport(&horizon, lobe));
        let formation = study.formation_with(bare.clone())?;
        let mut parameters = formation.zero();
        parameters.light = formation.light.like(&study.radiance);
        let values = 3 * study.seen.len();
        let mut fit = Self::unevaluated(parameters, lobe, horizon, bare, formation, values);
        fit.evaluate(study)?;
        Ok(fit)
    }

    /// Nothing of it evaluated yet; `values` is how many there are.
    fn unevaluated(
        parameters: Parameters,
        lobe: Option<Lobe>,
        horizon: Arc<Horizon>,
        bare: Arc<Transport>,
        formation: Formation,
        values: usize,
    ) -> Self {
        Self {
            parameters,
            lobe,
            horizon,
            bare,
            formation,
            active: Vec::new(),
            tau: [0.05; 3],
            inflation: 1.0,
            dark_inflation: 1.0,
            trust: vec![1.0; values],
            radiance: Vec::new(),
            albedo: Vec::new(),
            diffuse: Vec::new(),
            specular: Vec::new(),
            ideal: Vec::new(),
            value: Vec::new(),
            slope: Vec::new(),
            mean: Mean::default(),
            links: Vec::new(),
            nuisance: None,
            worn: false,
        }
    }

    /// The same model with another formation: what cannot be cloned is made anew.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn duplicate(&self, study: &Study<'_>) -> Result<Self, FitError> {
        let formation = study.formation_with(self.formation.transport().clone())?;
        let (parameters, horizon) = (self.parameters.clone(), self.horizon.clone());
        let (bare, values) = (self.bare.clone(), self.trust.len());
        let mut fit = Self {
            active: self.active.clone(),
            tau: self.tau,
            inflation: self.inflation,
            dark_inflation: self.dark_inflation,
            trust: self.trust.clone(),
            links: self.links.clone(),
            nuisance: self.nuisance.clone(),
            worn: self.worn,
            ..Self::unevaluated(parameters, self.lobe, horizon, bare, formation, values)
        };
        fit.evaluate(study)?;
        Ok(fit)
    }

    /// The scene that effects look at, of a surface of the texture alone.
    pub fn scene<'a>(&'a self, study: &'a Study<'_>) -> Scene<'a> {
        Scene {
            capture: study.capture,
            bvh: &study.bvh,
            seen: &study.seen,
            horizon: &self.horizon,
            transport: self.formation.transport(),
            bare: &self.bare,
            lobe: self.lobe,
            radiance: &self.radiance,
            albedo: &self.mean.albedo,
            diffuse: &self.diffuse,
            specular: &self.specular,
            value: &self.mean.ideal,
            renders: &study.renders,
            radius: study.radius,
            active: &self.active,
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
        self.precision_beside(study, [self, self], counted)
    }

    /// The same for a comparison with another model, by the noise that `judge` takes for the sensor's: what either of these takes for
    /// an outlier is trusted less. Weights of one of them would forgive its own outliers and count the other's.
    pub fn precision_beside(
        &self,
        study: &Study<'_>,
        [judge, other]: [&Self; 2],
        counted: &dyn Fn(usize) -> bool,
    ) -> Precision {
        let views = study.seen.views.len();
        self.weighed(study, |i| {
            if counted(i / 3) {
                let trust = judge.trust[i].min(other.trust[i]);
                trust / (study.variance[i] * judge.scale(i, views) as f32)
            } else {
                0.0
            }
        })
    }

    /// The same by the sensor's noise, no error of the model's own.
    pub fn sensor_precision_beside(
        &self,
        study: &Study<'_>,
        other: &Self,
        counted: &dyn Fn(usize) -> bool,
    ) -> Precision {
        self.weighed(study, |i| {
            if counted(i / 3) {
                self.trust[i].min(other.trust[i]) / study.variance[i]
            } else {
                0.0
            }
        })
    }

    fn weighed(&self, study: &Study<'_>, weight: impl Fn(usize) -> f32) -> Precision {
        let views = study.seen.views.len();
        let weight: Vec<f32> = (0..study.value.len()).map(weight).collect();
        let shading: Vec<f32> = (0..3 * views)
            .map(|i| self.mean.slope[i] * self.diffuse[i])
            .collect();
        Precision::new(&study.seen.offsets, weight, shading, self.tau)
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
        let betas = self.betas(study, &chain);
        chain.bind(&self.ideal, &betas)?;
        self.value = chain.values()?;
        self.slope = chain.slope(study.seen.len())?;
        self.evaluate_mean(study, &mut chain, &betas)
    }

    /// Numbers of the active effects in the order of a chain.
    pub fn betas(&self, study: &Study<'_>, chain: &Chain) -> Vec<Vec<f64>> {
        chain
            .links()
            .iter()
            .map(|link| {
                let own = self
                    .active
                    .iter()
                    .find(|a| a.effect.id() == link.effect.id());
                // What transport lets pass, and where lamps are, is in the ideal values already.
                let inside = |a: &Active| {
                    let passing = a.effect.passing(&self.horizon, &study.seen, &a.beta);
                    passing.is_some() || self.moved_lamps(study, a).is_some()
                };
                match own {
                    Some(a) if !inside(a) => a.beta.clone(),
                    _ => vec![0.0; link.terms.len()],
                }
            })
            .collect()
    }

    /// A number of an active effect; zero for others.
    pub fn beta(&self, id: &str, term: usize) -> f64 {
        let own = self.active.iter().find(|a| a.effect.id() == id);
        own.and_then(|a| a.beta.get(term)).copied().unwrap_or(0.0)
    }

    /// Light transport under the present lobe, without occluders.
    fn transport(&self, study: &Study<'_>) -> Arc<Transport> {
        Arc::new(study.transport(&self.horizon, self.lobe))
    }

    /// The known lamps where an effect puts them.
    fn moved_lamps(&self, study: &Study<'_>, active: &Active) -> Option<Vec<Source>> {
        let given = study.horizon.lamps()?;
        active.effect.moved_lamps(given, &study.seen, &active.beta)
    }

    /// Puts the known lamps where the effects have them.
    fn move_lamps(&mut self, study: &Study<'_>) {
        let Some(given) = study.horizon.lamps() else {
            return;
        };
        let mut lamps = given.to_vec();
        for active in &self.active {
            if let Some(moved) = active.effect.moved_lamps(&lamps, &study.seen, &active.beta) {
                lamps = moved;
            }
        }
        if self.horizon.lamps() != Some(&*lamps) {
            self.horizon = Arc::new(study.horizon_under(lamps));
            self.bare = self.transport(study);
        }
    }

    /// The share of light that occluders in the model let pass to each view from each source; `None` without any.
    fn passing(&self, study: &Study<'_>) -> Option<Passing> {
        let of = |a: &Active| a.effect.passing(&self.horizon, &study.seen, &a.beta);
        self.active.iter().filter_map(of).reduce(|one, other| {
            Box::new(move |view, source| one(view, source) * other(view, source))
        })
    }

    /// Image formation with lamps and occluders as they are now.
    fn form(&mut self, study: &Study<'_>) -> Result<(), FitError> {
        self.move_lamps(study);
        let transport = match self.passing(study) {
            None => self.bare.clone(),
            Some(passing) => Arc::new(self.bare.masked(passing)),
        };
        if !Arc::ptr_eq(&transport, self.formation.transport()) {
            self.formation = study.formation_with(transport)?;
        }
        Ok(())
    }

    /// Adds an effect at its null, or at `beta`.
    pub fn add(&mut self, effect: &'static dyn Effect, beta: Vec<f64>) {
        self.active.push(Active { effect, beta });
    }

    /// Whether no effect of the model has numbers of single frames.
    pub fn is_shared(&self) -> bool {
        let mut terms = self.links.iter().flat_map(|link| link.terms.iter());
        terms.all(|term| term.frame.is_none())
    }

    /// Sets all numbers of single frames to zero: before another effect joins, what only stood in for it must not stay.
    pub fn forget_frames(&mut self) {
        for active in &mut self.active {
            let own = |link: &&Link| link.effect.id() == active.effect.id();
            let terms = self.links.iter().find(own).map(|link| link.terms.clone());
            let numbers = active
                .beta
                .iter_mut()
                .zip(terms.iter().flat_map(|t| t.iter()));
            numbers
                .filter(|(_, term)| term.frame.is_some())
                .for_each(|(beta, _)| *beta = 0.0);
        }
    }

    /// The terms of an effect in the model, as they were when it was last linearised.
    pub fn link(&self, id: &str) -> Option<&Link> {
        self.links.iter().find(|link| link.effect.id() == id)
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
        self.form(study)?;
        self.evaluate(study)
    }

    /// Begins the next step with light and texture as they were linearised here, of this model or one close to it.
    pub fn precondition(&mut self, nuisance: Arc<Nuisance>) {
        self.nuisance = Some(nuisance);
        self.worn = false;
    }

    /// ½ rᵀ V⁻¹ r with the site's own albedo integrated out. Costs of different models can be compared by the same noise only.
    pub fn cost_under(&self, study: &Study<'_>, precision: &Precision) -> f64 {
        let r = self.residual_of_mean(study);
        0.5 * dot(&r, &precision.apply(&r))
    }

    /// How far light, texture and lobe are from what is usual, in standard deviations, squared.
    pub fn unusual(&self) -> f64 {
        let numbers = self.parameters.light.iter().chain(&self.parameters.texture);
        let lobe = self.lobe.map_or([0.0; 2], lobe::unusual);
        numbers.chain(&lobe).map(|z| f64::from(*z).powi(2)).sum()
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
