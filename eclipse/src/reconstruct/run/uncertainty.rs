//! How far off a result may be, on the grids and images that a run leaves.

use std::time::Instant;

use render::{bvh::Bvh, image::Image};

use super::super::{
    finish,
    laplace::{Effort, Part},
    model::Shared,
    patches::Observations,
    shading::Masks,
    sites::{Blend, Sites},
    uncertainty::{Deviations, Posterior},
};
use super::{Frames, ReconstructError, Run};
use crate::reconstruction::{Ended, Reconstruction, Uncertainty};

/// Products for each step of the solve, which itself takes 25: about a tenth of its time where most steps are fine ones.
const PRODUCTS: f64 = 1.8;
/// Most products: about the directions that photographs determine well.
pub(super) const MOST_PRODUCTS: usize = 160;
/// Probes of what those directions leave free.
const PROBES: usize = 8;
/// Share of the seconds so far that may be spent when there is a time limit.
pub(super) const SHARE: f64 = 0.08;

impl Run<'_> {
    /// Adds standard deviations to what was `found` at `z`; none when the caller wants the end.
    pub(super) fn doubt(
        &self,
        bvh: &Bvh,
        chosen: &Frames,
        observations: &Observations,
        shared: &mut Shared,
        z: &[f32],
        found: &mut Reconstruction,
    ) -> Result<(), ReconstructError> {
        if self.ended == Ended::Interrupted || self.iteration() == 0 {
            return Ok(());
        }
        self.report("standard deviations", f64::NAN, 0.0);
        let began = Instant::now();
        let allowed = match self.settings.time_limit {
            Some(_) => SHARE * self.seconds(),
            None => f64::INFINITY,
        };
        let steps = self.iteration() as f64;
        let effort = Effort {
            products: ((PRODUCTS * steps).ceil() as usize).min(MOST_PRODUCTS),
            probes: PROBES,
        };
        // Levels of the silhouette that were held still are no surer for it.
        shared.sky.withhold(0);
        let mut posterior = Posterior::new(shared, z, effort, self.settings.seed, &mut || {
            began.elapsed().as_secs_f64() < allowed && !self.control.stopped()
        })?;
        // Who ends a run now would get what little was found of them by then.
        if self.control.stopped() {
            return Ok(());
        }
        let deviations = posterior.deviations(Part::All);
        let mut uncertainty = Uncertainty::default();
        uncertainty.summary.known = posterior.known();
        uncertainty.summary.known_at_most = posterior.known_at_most();
        uncertainty.summary.misfit = posterior.misfit;
        self.doubt_light(shared, &deviations, found, &mut uncertainty);
        self.doubt_masks(chosen, shared, &deviations, found, &mut uncertainty);
        self.doubt_albedo(bvh, observations, &deviations, found, &mut uncertainty);
        uncertainty.summary.seconds = began.elapsed().as_secs_f64();
        let summary = serde_json::to_value(&uncertainty.summary).unwrap_or_default();
        let extra = &mut found.metrics.extra;
        extra.insert("uncertainty".to_owned(), summary);
        found.uncertainty = Some(uncertainty);
        Ok(())
    }

    fn doubt_light(
        &self,
        shared: &Shared,
        deviations: &Deviations,
        found: &Reconstruction,
        to: &mut Uncertainty,
    ) {
        let rows = self.settings.grid_rows;
        to.environment = finish::environment(shared.grid, &deviations.radiance, rows);
        to.summary.environment =
            rms(&to.environment.data) / rms(&found.environment.data).max(1e-12);
    }

    fn doubt_masks(
        &self,
        chosen: &Frames,
        shared: &Shared,
        deviations: &Deviations,
        found: &Reconstruction,
        to: &mut Uncertainty,
    ) {
        if deviations.masks.is_empty() {
            return;
        }
        let rows = self.settings.grid_rows;
        let (grid, shells) = (shared.mask_grid(), shared.shells.clone());
        to.occluders = Masks::new(grid, rows, shells, deviations.masks.clone()).images(rows);
        let light = &found.environment;
        let of_frame = |(t, mask): (usize, &Image)| {
            let (mut sum, mut all) = (0.0, 0.0);
            for (texel, deviation) in mask.data.iter().enumerate() {
                let v = (texel / mask.width) as f64 + 0.5;
                let around = (std::f64::consts::PI * v / mask.height as f64).sin();
                let radiance: f32 = light.data[3 * texel..3 * texel + 3].iter().sum();
                let weight = around * f64::from(radiance);
                sum += weight * f64::from(*deviation).powi(2);
                all += weight;
            }
            // The occluder of a frame that was held out was fitted to other pixels, afterwards.
            (!chosen.held_out[t]).then(|| (sum / all.max(1e-300)).sqrt())
        };
        to.summary.occluders = to.occluders.iter().enumerate().map(of_frame).collect();
    }

    fn doubt_albedo(
        &self,
        bvh: &Bvh,
        observations: &Observations,
        deviations: &Deviations,
        found: &Reconstruction,
        to: &mut Uncertainty,
    ) {
        let patches = &observations.patches;
        if patches.is_empty() {
            return;
        }
        let points = patches.iter().map(|p| (p.position, p.normal)).collect();
        let sites = Sites::new(points, observations.spacing);
        let relative = |blend: &Blend, channel: usize| -> f32 {
            let of = |patch: u32| deviations.albedo[channel * patches.len() + patch as usize];
            blend.iter().map(|&(patch, w)| w * of(patch)).sum()
        };
        let frames = self.capture.frames.iter().zip(&found.materials);
        to.albedo = frames
            .map(|(frame, materials)| {
                let mut image = Image::filled(materials.width, materials.height, 3, 0.0);
                for (p, blend) in sites.pixels(bvh, frame).iter().enumerate() {
                    for c in 0..3 {
                        let deviation = |blend| materials.data[5 * p + c] * relative(blend, c);
                        image.data[3 * p + c] = blend.as_ref().map_or(0.0, deviation);
                    }
                }
                image
            })
            .collect();
        let mesh = bvh.mesh();
        let vertices = mesh.positions.iter().zip(&mesh.normals);
        to.vertex_albedo = vertices
            .zip(&found.vertex_materials)
            .map(|((&position, &normal), material)| {
                let blend = sites.blend(position, normal);
                std::array::from_fn(|c| material.albedo[c] * relative(&blend, c))
            })
            .collect();
        let seen = to.albedo.iter().flat_map(|image| &image.data);
        let seen: Vec<f32> = seen.copied().filter(|v| *v > 0.0).collect();
        to.summary.albedo = rms(&seen);
    }
}

fn rms(values: &[f32]) -> f64 {
    let sum: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum();
    (sum / values.len().max(1) as f64).sqrt()
}
