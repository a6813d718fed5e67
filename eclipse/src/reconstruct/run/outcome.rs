//! What a run leaves where its steps end.

use std::collections::BTreeMap;

use render::bvh::Bvh;

use super::super::{
    finish::{self, Found},
    hold_out,
    model::Shared,
    surface::Surface,
};
use super::{Frames, LEGS, ReconstructError, Run, photometric};
use crate::reconstruction::{Ended, Metrics, Reconstruction};

impl Run<'_> {
    /// Materials, images, scores and remarks.
    pub(super) fn finish(
        &self,
        bvh: &Bvh,
        surface: &Surface,
        chosen: &Frames,
        shared: &Shared,
        z: &[f32],
    ) -> Result<Reconstruction, ReconstructError> {
        self.report("materials and renders", f64::NAN, 0.0);
        let rows = self.settings.grid_rows;
        let radiance = shared.linearise(z)?.0.radiance()?;
        let environment = finish::environment(shared.grid, &radiance, rows);
        let frames = &self.capture.frames;
        let lobe = self.round.as_ref().and_then(|begun| begun.lobe);
        let found = Found {
            bvh,
            surface,
            frames,
            noise: &self.noise,
            grid: surface.grid,
            radiance: &environment.data,
            occluders: None,
            lobe,
            seed: self.settings.seed,
        };
        let mut occluders = self.masks(shared, z)?;
        let mut finished = finish::finish(&found.under(occluders.as_ref()));
        if self.settings.hold_out.is_some() {
            self.report("occluders of held-out frames", f64::NAN, 0.0);
            let held = |t: usize| chosen.held_out[t];
            let z = hold_out::fit(&found, shared, z, &finished.materials, &held)?;
            let moved = self.masks(shared, &z)?;
            finished = finish::finish(&found.under(moved.as_ref()));
            occluders = moved;
        }
        let masks = occluders.map_or(Vec::new(), |masks| masks.images(rows));
        let photometric = photometric(self.capture, self.settings, &finished.renders);
        let extra = BTreeMap::from([
            ("iterations".to_owned(), self.iteration().into()),
            ("seconds".to_owned(), self.seconds().into()),
        ]);
        let mut notes = chosen.notes(frames, &masks);
        if self.ended == Ended::TimeLimit && self.reached + 1 < LEGS.len() {
            notes.push(
                "the time limit ended the run before its fine stage: the light is coarse, and a longer --time-limit gives a better \
                 result"
                    .to_owned(),
            );
        }
        if let Some(lobe) = lobe {
            notes.push(format!(
                "specular reflection: alpha {:.3} and kappa {:.3}, the same all over the object",
                lobe.alpha, lobe.kappa
            ));
        } else if !self.settings.lambertian {
            notes.push(
                "the run ended before specular reflection was fitted: all is diffuse".to_owned(),
            );
        }
        Ok(Reconstruction {
            environment,
            uncertainty: None,
            notes,
            occluders: masks,
            materials: finished.materials,
            vertex_materials: finished.vertex_materials,
            network: None,
            renders: finished.renders,
            curve: self.curve.clone(),
            metrics: Metrics { photometric, extra },
            noise: Some(self.noise),
            settings: self.settings.clone(),
            ended: self.ended,
        })
    }
}
