//! The finer model between rounds of the solve: specular reflection, and what patches leave out.

use render::lat_long::LatLong;

use super::super::{
    detail::{self, Data},
    finish, lobe,
    model::Shared,
    patches::Observations,
    shading::{Lobe, Scene},
    surface::{Surface, eyes},
};
use super::{ReconstructError, Run};

/// Where a round began: with the capture, all that its data depend on.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RoundStart {
    /// Parameters.
    pub(super) z: Vec<f32>,
    /// Specular reflection; `None` for a Lambertian surface.
    pub(super) lobe: Option<Lobe>,
}

impl Run<'_> {
    /// The data of a round that begins at `z`; the lobe is fitted, near that of the round before, unless `known` gives it.
    pub(super) fn round(
        &self,
        surface: &Surface,
        shared: &Shared,
        (observations, patch_of_site): (&Observations, &[u32]),
        z: &[f32],
        known: Option<Lobe>,
        before: Option<Lobe>,
    ) -> Result<(RoundStart, Data), ReconstructError> {
        let (at, _) = shared.linearise(z)?;
        let rows = surface.grid.rows;
        let radiance = finish::environment(shared.grid, &at.radiance()?, rows).data;
        let occluders = self.masks(shared, z)?;
        let mut scene = Scene {
            grid: LatLong::new(rows, 2 * rows),
            radiance: &radiance,
            occluders: occluders.as_ref(),
            lobe: before,
            eyes: &eyes(&self.capture.frames),
        };
        if !self.settings.lambertian {
            scene.lobe = Some(known.unwrap_or_else(|| lobe::fit(&scene, surface)));
        }
        let predicted = at.predicted(observations)?;
        let data = detail::correct(
            surface,
            &scene,
            &self.noise,
            observations,
            patch_of_site,
            &predicted,
            0.004,
        );
        let start = RoundStart {
            z: z.to_vec(),
            lobe: scene.lobe,
        };
        Ok((start, data))
    }
}
