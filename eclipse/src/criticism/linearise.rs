//! The model's derivatives at the fit, whitened: what light and texture can do, and what effects would do.
//!
//! Light has thousands of parameters but blurs most of them away. A few hundred directions span what the photographs can
//! tell of it: products of the transposed Jacobian with random residuals find them (Halko, Martinsson & Tropp 2011), one
//! tape pass for sixteen at a time. In coordinates of the prior they are orthonormal, so that the prior stays ½‖·‖².

use std::sync::Arc;

use rayon::prelude::*;
use render::sampler::SampleKey;

use super::{
    chain::{Chain, Link},
    effects::{Effect, Term},
    fit::{Fit, FitError},
    formation::orthonormal,
    nuisance::Nuisance,
    precision::Precision,
    study::Study,
};

/// Directions of light.
const DIRECTIONS: usize = 240;
/// Directions a pass of the tape serves.
const PROBES: usize = 16;

/// Whitened columns, each `[observation][colour]`.
pub struct Jacobian {
    /// Light and texture.
    pub nuisance: Arc<Nuisance>,
    /// The lobe and the effects in the model already, times their prior's deviation: one coefficient for all colours.
    pub always: Vec<Vec<f32>>,
    /// Bounds of the coefficients of `always`, in the same units, relative to where they are now.
    pub always_bounds: Vec<[f64; 2]>,
    /// Residual, sites' own albedo left in.
    pub residual: Vec<f32>,
    /// The covariance that whitened them.
    pub precision: Precision,
}

/// What an effect would do.
pub struct Candidate {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Its terms; fields are dropped.
    pub terms: Vec<Term>,
    /// Whitened columns times the terms' scales.
    pub columns: Vec<Vec<f32>>,
    /// Relative size of the change of the object's image per unit of each column, before whitening: RMS over views.
    pub unit_size: Vec<Vec<f32>>,
}

impl Jacobian {
    /// At this fit, for the observations of development.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn new(study: &Study<'_>, fit: &Fit) -> Result<Self, FitError> {
        let precision = fit.precision(study, &|i| study.develops(i));
        // Light's and texture's prior is taken around this fit rather than around zero: what its pull left in the residual is theirs to
        // take before an effect is asked (a step of iterated Tikhonov regularisation), or it would pass for physics.
        let mut residual = fit.residual_of_mean(study);
        precision.whiten(&mut residual);
        let nuisance = Arc::new(Nuisance::new(study, fit, &precision)?);
        let mut always: Vec<Vec<f32>> = Vec::new();
        let mut always_bounds = Vec::new();
        for (column, _) in fit.lobe_columns(study)? {
            always.push(column);
            always_bounds.push([f64::NEG_INFINITY, f64::INFINITY]);
        }
        let mut chain = Chain::new(&fit.links, study.seen.len())?;
        let betas = fit.betas(study, &chain);
        chain.bind(&fit.mean.ideal, &betas)?;
        for (l, link) in chain.links().to_vec().iter().enumerate() {
            for (k, term) in link.terms.iter().enumerate() {
                let scale = term.scale as f32;
                always.push(chain.column(l, k)?.iter().map(|x| scale * x).collect());
                let now = fit.beta(link.effect.id(), k);
                always_bounds.push([term.least, term.most].map(|bound| (bound - now) / term.scale));
            }
        }
        always
            .par_iter_mut()
            .for_each(|column| precision.whiten(column));
        Ok(Self {
            nuisance,
            always,
            always_bounds,
            residual,
            precision,
        })
    }

    /// Counts an effect's numbers among what is free, within their bounds, as light and texture are.
    pub fn take_for_granted(&mut self, candidate: &Candidate) {
        self.always.extend(candidate.columns.iter().cloned());
        self.always_bounds.extend(candidate.bounds());
    }

    /// The columns of several effects that are not in the model yet.
    ///
    /// # Errors
    /// As [`candidate`](Self::candidate).
    pub fn candidates(
        &self,
        study: &Study<'_>,
        fit: &Fit,
        effects: impl Iterator<Item = &'static dyn Effect>,
    ) -> Result<Vec<Candidate>, FitError> {
        effects
            .map(|effect| self.candidate(study, fit, effect))
            .collect()
    }

    /// The columns of an effect that is not in the model yet.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn candidate(
        &self,
        study: &Study<'_>,
        fit: &Fit,
        effect: &'static dyn Effect,
    ) -> Result<Candidate, FitError> {
        let mut terms = effect.terms(&fit.scene(study));
        let mut columns = Vec::with_capacity(terms.len());
        // A few at a time: at their null terms do not see each other, and the tape holds all that it is given.
        for group in groups(&mut terms) {
            let group = Arc::new(group);
            let mut links = fit.links.clone();
            links.push(Link {
                effect,
                terms: group.clone(),
            });
            let mut chain = Chain::new(&links, study.seen.len())?;
            let own = chain
                .links()
                .iter()
                .position(|link| link.effect.id() == effect.id());
            let betas = fit.betas(study, &chain);
            chain.bind(&fit.mean.ideal, &betas)?;
            for (k, term) in group.iter().enumerate() {
                let scale = term.scale as f32;
                let column = chain.column(own.unwrap_or(0), k)?;
                columns.push(column.iter().map(|x| scale * x).collect::<Vec<f32>>());
            }
        }
        let views = study.seen.views.len();
        // Three colours of a third of the middle value: relative changes of the dark mean little.
        let floor = fit.scene(study).typical();
        let unit_size = columns
            .iter()
            .map(|column| {
                (0..views)
                    .map(|v| {
                        let sum = |of: &[f32]| (0..3).map(|c| of[3 * v + c]).sum::<f32>();
                        sum(column) / sum(&fit.mean.value).max(floor)
                    })
                    .collect()
            })
            .collect();
        columns
            .par_iter_mut()
            .for_each(|column| self.precision.whiten(column));
        Ok(Candidate {
            effect,
            terms,
            columns,
            unit_size,
        })
    }
}

impl Candidate {
    /// Bounds of its coefficients, in deviations of their prior.
    pub fn bounds(&self) -> impl Iterator<Item = [f64; 2]> {
        let terms = self.terms.iter();
        terms.map(|t| [t.least, t.most].map(|bound| bound / t.scale))
    }
}

/// Terms a chain holds at once.
const GROUP: usize = 12;

/// The terms in groups; what is left behind keeps names and bounds without the fields.
fn groups(terms: &mut [Term]) -> Vec<Vec<Term>> {
    terms
        .chunks_mut(GROUP)
        .map(|group| {
            let moved = |term: &mut Term| Term {
                name: term.name.clone(),
                field: std::mem::take(&mut term.field),
                ..*term
            };
            group.iter_mut().map(moved).collect()
        })
        .collect()
}

/// Directions of light that matter, and derivatives.
pub(super) struct Directions {
    /// Orthonormal, `[direction][number]`.
    pub basis: Vec<Vec<f32>>,
    /// Columns of those, then of the texture's bumps.
    pub columns: Vec<Vec<f32>>,
}

/// Whitened derivatives by the directions of light that matter and by the texture's bumps.
///
/// # Errors
/// A bug of the tape.
pub(super) fn nuisance(
    study: &Study<'_>,
    fit: &Fit,
    precision: &Precision,
) -> Result<Directions, FitError> {
    let basis = light(study, fit, precision)?;
    nuisance_along(study, fit, precision, basis)
}

/// The same by these directions of light.
///
/// # Errors
/// A bug of the tape.
pub(super) fn nuisance_along(
    study: &Study<'_>,
    fit: &Fit,
    precision: &Precision,
    basis: Vec<Vec<f32>>,
) -> Result<Directions, FitError> {
    let mut columns = along(study, fit, &basis)?;
    columns.extend(texture(study, fit));
    let all = columns.par_iter_mut();
    all.for_each(|column| precision.whiten(column));
    Ok(Directions { basis, columns })
}

/// Directions of light that the photographs tell of.
fn light(study: &Study<'_>, fit: &Fit, precision: &Precision) -> Result<Vec<Vec<f32>>, FitError> {
    let formation = &fit.formation;
    let views = study.seen.views.len();
    let levels = formation.light.len();
    let width = 3 * PROBES;
    let mut ws = formation.workspace(&fit.mean_parameters(), PROBES)?;
    let mut rows = Vec::new();
    for batch in 0..DIRECTIONS / PROBES {
        let mut cotangent = vec![0.0f32; views * width];
        let columns: Vec<Vec<f32>> = (0..PROBES)
            .into_par_iter()
            .map(|probe| {
                let mut stream = SampleKey {
                    dimension: 73,
                    sample: (batch * PROBES + probe) as u32,
                    ..SampleKey::default()
                }
                .stream();
                let mut column: Vec<f32> = (0..study.value.len())
                    .map(|_| if stream.uniform() < 0.5 { -1.0 } else { 1.0 })
                    .collect();
                precision.whiten(&mut column);
                column
            })
            .collect();
        for v in 0..views {
            for (probe, column) in columns.iter().enumerate() {
                for c in 0..3 {
                    cotangent[v * width + 3 * probe + c] =
                        fit.mean.slope[3 * v + c] * column[3 * v + c];
                }
            }
        }
        let (gradient, _) = formation.pull(&mut ws, &cotangent)?;
        for probe in 0..PROBES {
            let row = (0..levels)
                .map(|l| (0..3).map(|c| gradient[l * width + 3 * probe + c]).sum())
                .collect();
            rows.push(row);
        }
    }
    Ok(orthonormal(rows))
}

/// Derivatives by directions of light, not whitened yet.
fn along(study: &Study<'_>, fit: &Fit, basis: &[Vec<f32>]) -> Result<Vec<Vec<f32>>, FitError> {
    let formation = &fit.formation;
    let views = study.seen.views.len();
    let levels = formation.light.len();
    let width = 3 * PROBES;
    let mut ws = formation.workspace(&fit.mean_parameters(), PROBES)?;
    let mut columns: Vec<Vec<f32>> = Vec::with_capacity(basis.len());
    let still = vec![0.0f32; formation.texture.bumps * width];
    for group in basis.chunks(PROBES) {
        let mut direction = vec![0.0f32; levels * width];
        for (probe, row) in group.iter().enumerate() {
            for l in 0..levels {
                (0..3).for_each(|c| direction[l * width + 3 * probe + c] = row[l]);
            }
        }
        let moved = formation.push(&mut ws, &direction, &still)?;
        for probe in 0..group.len() {
            let mut column = vec![0.0f32; study.value.len()];
            for v in 0..views {
                for c in 0..3 {
                    column[3 * v + c] =
                        fit.mean.slope[3 * v + c] * moved[v * width + 3 * probe + c];
                }
            }
            columns.push(column);
        }
    }
    Ok(columns)
}

/// Derivatives by the texture's bumps.
fn texture(study: &Study<'_>, fit: &Fit) -> Vec<Vec<f32>> {
    let texture = &fit.formation.texture;
    (0..texture.bumps)
        .into_par_iter()
        .map(|b| {
            let mut column = vec![0.0f32; study.value.len()];
            for (v, view) in study.seen.views.iter().enumerate() {
                let bump = texture.at(view.site as usize)[b];
                for c in 0..3 {
                    column[3 * v + c] = fit.mean.slope[3 * v + c] * fit.diffuse[3 * v + c] * bump;
                }
            }
            column
        })
        .collect()
}
