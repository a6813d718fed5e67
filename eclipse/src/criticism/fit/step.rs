//! One Gauss-Newton step of everything that is fitted.

use std::sync::Arc;

use autodiff::RunError;
use rayon::prelude::*;

use super::{Fit, FitError, lobe};
use crate::criticism::{
    chain::Chain, confined, linear::dot, nuisance::Nuisance, precision::Precision, study::Study,
};

/// The largest change of the logarithm of light a step may make.
const LARGEST_STEP: f32 = 1.2;

/// Room of a number without bounds.
const OPEN: [f32; 2] = [f32::NEG_INFINITY, f32::INFINITY];

/// A number beside light and texture: what it changes, where it is and how far it may go, in units of its scale.
struct Column {
    change: Vec<f32>,
    at: f32,
    room: [f32; 2],
}

impl Fit {
    pub(super) fn step(
        &mut self,
        study: &Study<'_>,
        precision: &Precision,
        with_lobe: bool,
    ) -> Result<(), FitError> {
        let mut chain = Chain::new(&self.links, study.seen.len())?;
        let betas = self.betas(study, &chain);
        chain.bind(&self.mean.ideal, &betas)?;
        let columns = self.columns(study, &mut chain, with_lobe)?;
        let lights = self.parameters.light.len();
        let inner = lights + self.parameters.texture.len();
        let mut at = self.parameters.light.clone();
        at.extend(&self.parameters.texture);
        at.extend(columns.iter().map(|column| column.at));
        let delta = self.direction(study, precision, &columns, &at)?;

        let before = self.cost_under(study, precision) + 0.5 * dot(&at, &at);
        let own = self.parameters.clone();
        let (lobe_before, active_before) = (self.lobe, self.active.clone());
        let order: Vec<&'static str> = chain.links().iter().map(|l| l.effect.id()).collect();
        let effects = inner + columns.len() - numbers(&chain);
        let mut share = self.allowed(&delta[..lights]);
        for _ in 0..4 {
            self.parameters = own.clone();
            self.active = active_before.clone();
            let moved = |(z, d): (&mut f32, &f32)| *z += share * d;
            let light = self.parameters.light.iter_mut();
            light.zip(&delta).for_each(moved);
            let texture = self.parameters.texture.iter_mut();
            texture.zip(&delta[lights..]).for_each(moved);
            self.move_effects(&order, &delta[effects..], share);
            if with_lobe && let Some(old) = lobe_before {
                let step = &delta[inner..];
                self.lobe = Some(lobe::moved(old, share * step[0], share * step[1]));
                self.bare = self.transport(study);
            }
            self.form(study)?;
            self.evaluate(study)?;
            let mut z = at.clone();
            z.iter_mut().zip(&delta).for_each(moved);
            if self.cost_under(study, precision) + 0.5 * dot(&z, &z) <= before {
                return Ok(());
            }
            share *= 0.4;
        }
        // Nothing along it is better: the next one is made with light and texture as they are now.
        self.worn = true;
        self.parameters = own;
        self.active = active_before;
        if self.lobe != lobe_before {
            self.lobe = lobe_before;
            self.bare = self.transport(study);
        }
        self.form(study)?;
        self.evaluate(study)
    }

    /// The lobe's numbers, then those of the effects in the chain's order.
    fn columns(
        &self,
        study: &Study<'_>,
        chain: &mut Chain,
        with_lobe: bool,
    ) -> Result<Vec<Column>, FitError> {
        let mut columns = Vec::new();
        if with_lobe {
            let free = |(change, at)| Column {
                change,
                at,
                room: OPEN,
            };
            columns.extend(self.lobe_columns(study)?.into_iter().map(free));
        }
        for (l, link) in chain.links().to_vec().iter().enumerate() {
            for (k, term) in link.terms.iter().enumerate() {
                let scale = term.scale as f32;
                let at = self.beta(link.effect.id(), k);
                let room = [term.least, term.most].map(|bound| ((bound - at) / term.scale) as f32);
                columns.push(Column {
                    change: chain.column(l, k)?.iter().map(|x| scale * x).collect(),
                    at: at as f32 / scale,
                    room: [room[0].min(0.0), room[1].max(0.0)],
                });
            }
        }
        Ok(columns)
    }

    /// Gauss-Newton's step of light, texture and `columns`, which are `at` now.
    fn direction(
        &mut self,
        study: &Study<'_>,
        precision: &Precision,
        columns: &[Column],
        at: &[f32],
    ) -> Result<Vec<f32>, FitError> {
        let nuisance = match &self.nuisance {
            None => Arc::new(Nuisance::new(study, self, precision)?),
            Some(known) if self.worn => Arc::new(known.renewed(study, self, precision)?),
            Some(known) => known.clone(),
        };
        let white = |column: &Column| {
            let mut change = column.change.clone();
            precision.whiten(&mut change);
            change
        };
        let beside: Vec<Vec<f32>> = columns.par_iter().map(white).collect();
        let mut inverse = nuisance.beside(&beside);
        let lights = self.parameters.light.len();
        let inner = lights + self.parameters.texture.len();
        let views = 3 * study.seen.views.len();
        let (slope, formation) = (&self.mean.slope, &self.formation);
        let mean = self.mean_parameters();
        let mut back = formation.workspace(&mean, 1)?;
        let mut pull = |weights: &[f32]| -> Result<Vec<f32>, RunError> {
            let own: Vec<f32> = (0..views).map(|i| slope[i] * weights[i]).collect();
            let (mut g, texture) = formation.pull(&mut back, &own)?;
            g.extend(texture);
            let beside = columns.par_iter().map(|c| dot(&c.change, weights) as f32);
            g.extend(beside.collect::<Vec<f32>>());
            Ok(g)
        };
        let mut right = pull(&precision.apply(&self.residual_of_mean(study)))?;
        right.iter_mut().zip(at).for_each(|(g, z)| *g -= z);
        let mut room = vec![OPEN; inner];
        room.extend(columns.iter().map(|column| column.room));
        let mut forth = formation.workspace(&mean, 1)?;
        let mut failed = None;
        let product = |v: &[f32]| {
            let mut run = || -> Result<Vec<f32>, RunError> {
                let mut moved = formation.push(&mut forth, &v[..lights], &v[lights..inner])?;
                let pairs = moved.iter_mut().zip(slope);
                pairs.for_each(|(moved, slope)| *moved *= slope);
                moved.resize(3 * study.seen.len(), 0.0);
                for (column, factor) in columns.iter().zip(&v[inner..]) {
                    if *factor != 0.0 {
                        let pairs = moved.iter_mut().zip(&column.change);
                        pairs.for_each(|(moved, change)| *moved += factor * change);
                    }
                }
                let mut back = pull(&precision.apply(&moved))?;
                back.iter_mut().zip(v).for_each(|(b, v)| *b += v);
                Ok(back)
            };
            run().unwrap_or_else(|error| {
                failed = Some(error);
                vec![0.0; v.len()]
            })
        };
        let (delta, ended) = confined::step(&right, &room, product, &mut inverse);
        if let Some(error) = failed {
            return Err(error.into());
        }
        // A step that did not get to its end asks for light and texture as they are now.
        self.nuisance = Some(nuisance);
        self.worn = !ended;
        Ok(delta)
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

/// How many numbers the effects of a chain have.
fn numbers(chain: &Chain) -> usize {
    chain.links().iter().map(|link| link.terms.len()).sum()
}
