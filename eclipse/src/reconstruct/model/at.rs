//! The model linearised at a point.

use autodiff::{RunError, Workspace};

use super::{
    super::{
        least_squares::{Linearisation, add},
        patches::{Observations, View},
        sky::SkyAt,
    },
    Shared,
    lots::WIDTH,
};

/// The model linearised at a point.
pub struct At<'a> {
    pub(super) shared: &'a Shared,
    /// A run of the tape for each lot of frames.
    pub(super) runs: Vec<Workspace<f32>>,
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
        let runs = self.runs.iter().map(|run| run.output("predicted"));
        let predicted = runs.collect::<Result<Vec<&[f32]>, RunError>>()?;
        let of_view = |view: &View| {
            let [lot, k] = shared.lots.place[view.frame as usize];
            let row = |c: usize| c * shared.patches + view.patch as usize;
            std::array::from_fn(|c| predicted[lot][row(c) * WIDTH + k])
        };
        Ok(observations.views.iter().map(of_view).collect())
    }

    /// Radiance, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn radiance(&self) -> Result<Vec<f32>, RunError> {
        Ok(self.by_texel(self.runs[0].output("radiance")?))
    }

    /// The change of the radiance along the direction of the last product Jv, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn radiance_change(&self) -> Result<Vec<f32>, RunError> {
        Ok(self.by_texel(self.runs[0].tangent("radiance")?))
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
        for (lot, run) in self.runs.iter_mut().enumerate() {
            let mask = mask
                .as_ref()
                .map(|mask| self.shared.lots.columns(mask, lot));
            let mut direction = vec![("environment", &v[environment.clone()])];
            direction.extend(mask.as_ref().map(|mask| ("mask", mask.as_slice())));
            self.shared
                .program
                .jvp(run, &direction)
                .expect("a direction of the model's own size");
        }
        super::joined(&self.runs, |run| run.tangent("residual")).expect("an output of the model")
    }

    fn vjp(&mut self, w: &[f32]) -> Vec<f32> {
        let shared = self.shared;
        let [environment, _] = shared.ranges();
        let mut z = vec![0.0; environment.len()];
        let values = shared.mask_grid().len() * shared.shells.frames();
        let mut masks = self.sky.as_ref().map(|_| vec![0.0; values]);
        let seeds = w.chunks_exact(3 * shared.patches * WIDTH);
        for (lot, (run, seed)) in self.runs.iter_mut().zip(seeds).enumerate() {
            shared
                .program
                .vjp_with(run, &[("residual", seed)])
                .expect("a cotangent of the model's own size");
            let gradient = |name| run.gradient(name).expect("a parameter of the model");
            add(&mut z, 1.0, gradient("environment"));
            if let Some(masks) = &mut masks {
                shared.lots.restore(gradient("mask"), lot, masks);
            }
        }
        if let (Some(sky), Some(masks)) = (&mut self.sky, masks) {
            z.extend(shared.sky.pull(sky, masks));
        }
        z
    }
}
