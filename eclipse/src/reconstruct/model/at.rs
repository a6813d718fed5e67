//! The model linearised at a point.

use autodiff::{RunError, Workspace};

use super::{
    super::{
        least_squares::Linearisation,
        patches::{Observations, View},
        sky::SkyAt,
    },
    Shared,
    tape::named,
};

/// The model linearised at a point.
pub struct At<'a> {
    pub(super) shared: &'a Shared,
    pub(super) ws: Workspace<f32>,
    pub(super) sky: Option<SkyAt>,
    pub(super) residual: Vec<f32>,
    pub(super) by_albedo: Vec<f32>,
}

impl At<'_> {
    /// What the model says about every view, linear RGB.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn predicted(&self, observations: &Observations) -> Result<Vec<[f32; 3]>, RunError> {
        let shared = self.shared;
        let mut predicted = Vec::with_capacity(shared.shells.groups.len());
        for g in 0..shared.shells.groups.len() {
            predicted.push(self.ws.output(&named("predicted", g))?);
        }
        let of_view = |view: &View| {
            let [group, k] = shared.shells.place[view.frame as usize];
            let count = shared.shells.groups[group].frames.len();
            let row = |c: usize| c * shared.patches + view.patch as usize;
            std::array::from_fn(|c| predicted[group][row(c) * count + k])
        };
        Ok(observations.views.iter().map(of_view).collect())
    }

    /// Radiance, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn radiance(&self) -> Result<Vec<f32>, RunError> {
        Ok(self.by_texel(self.ws.output("radiance")?))
    }

    /// The change of the radiance along the direction of the last product Jv, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn radiance_change(&self) -> Result<Vec<f32>, RunError> {
        Ok(self.by_texel(self.ws.tangent("radiance")?))
    }

    fn by_texel(&self, planar: &[f32]) -> Vec<f32> {
        let n = self.shared.grid.len();
        (0..3 * n).map(|i| planar[(i % 3) * n + i / 3]).collect()
    }

    /// The change of every mask when the parameters of occluders move along `v`, `[texel][frame]`; empty without occluders.
    pub fn mask_change(&mut self, v: &[f32]) -> Vec<f32> {
        self.sky
            .as_mut()
            .map_or(Vec::new(), |sky| self.shared.sky.change(sky, v))
    }
}

impl Linearisation for At<'_> {
    fn residual(&self) -> &[f32] {
        &self.residual
    }

    fn by_albedo(&self) -> &[f32] {
        &self.by_albedo
    }

    fn groups(&self) -> &[u32] {
        &self.shared.fixed.albedo_of
    }

    fn jvp(&mut self, v: &[f32]) -> Vec<f32> {
        let [environment, occluders] = self.shared.ranges();
        let mask = self
            .sky
            .as_mut()
            .map(|sky| self.shared.sky.push(sky, &v[occluders]));
        let masks: Vec<(String, Vec<f32>)> = (0..self.shared.shells.groups.len())
            .filter_map(|g| Some((named("mask", g), self.shared.columns(mask.as_ref()?, g))))
            .collect();
        let mut direction = vec![("environment", &v[environment])];
        direction.extend(
            masks
                .iter()
                .map(|(name, mask)| (name.as_str(), mask.as_slice())),
        );
        self.shared
            .program
            .jvp(&mut self.ws, &direction)
            .expect("a direction of the model's own size");
        self.shared
            .joined(|name| self.ws.tangent(name))
            .expect("outputs of the model")
    }

    fn vjp(&mut self, w: &[f32]) -> Vec<f32> {
        let groups = &self.shared.shells.groups;
        let mut rest = w;
        let seeds: Vec<(String, &[f32])> = groups
            .iter()
            .enumerate()
            .map(|(g, group)| {
                let (own, others) = rest.split_at(3 * self.shared.patches * group.frames.len());
                rest = others;
                (named("residual", g), own)
            })
            .collect();
        let seeds: Vec<(&str, &[f32])> = seeds.iter().map(|(n, w)| (n.as_str(), *w)).collect();
        self.shared
            .program
            .vjp_with(&mut self.ws, &seeds)
            .expect("a cotangent of the model's own size");
        let mut z = self
            .ws
            .gradient("environment")
            .expect("a parameter of the model")
            .to_vec();
        if let Some(sky) = &mut self.sky {
            let frames = self.shared.shells.frames();
            let mut masks = vec![0.0; self.shared.mask_grid().len() * frames];
            for (g, group) in groups.iter().enumerate() {
                let name = named("mask", g);
                let own = self.ws.gradient(&name).expect("a parameter of the model");
                for (to, from) in masks
                    .chunks_exact_mut(frames)
                    .zip(own.chunks_exact(group.frames.len()))
                {
                    group.frames.iter().zip(from).for_each(|(&t, &m)| to[t] = m);
                }
            }
            z.extend(self.shared.sky.pull(sky, masks));
        }
        z
    }
}
