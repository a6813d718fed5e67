//! Specular reflection between rounds of the solve.

use render::{bvh::Bvh, transport::Quadrature};

use super::super::{
    lobe,
    model::Shared,
    patches::Observations,
    shading::{Lobe, Scene},
};
use super::{ReconstructError, Run};

/// What is reflected beyond a diffuse surface.
pub(super) struct Coat {
    pub(super) lobe: Lobe,
    /// Its part of every view of the stage, linear RGB.
    pub(super) part: Vec<[f32; 3]>,
}

impl Run<'_> {
    /// Fits the specular lobe under the light and the occluders of `z`, and what it adds to every view.
    pub(super) fn coat(
        &self,
        bvh: &Bvh,
        shared: &Shared,
        observations: &Observations,
        z: &[f32],
    ) -> Result<Coat, ReconstructError> {
        let radiance = shared.linearise(z)?.0.radiance()?;
        let occluders = self.masks(shared, z)?;
        let frames = &self.capture.frames;
        let eyes: Vec<_> = frames.iter().map(|f| f.camera.centre()).collect();
        let scene = Scene {
            bvh,
            quadrature: &Quadrature::new(shared.grid, 1),
            radiance: &radiance,
            occluders: occluders.as_ref(),
            lobe: None,
            eyes: &eyes,
        };
        let lobe = lobe::fit(&scene, observations);
        let part = lobe::correction(&scene, observations, lobe);
        Ok(Coat { lobe, part })
    }
}
