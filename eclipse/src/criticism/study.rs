//! A capture and its simulation, prepared to be compared.

use std::sync::Arc;

use render::{bvh::Bvh, image::Image, lat_long::LatLong, mesh::MeshError};

use super::{
    fit::FitError,
    formation::{Bumps, Formation},
    given::Given,
    horizon::{Horizon, Source},
    light::LightModel,
    observe::Observations,
    simulation::Simulation,
    split::{Role, dark_role, frame_sealed, role},
    transport::{Lobe, Transport},
};
use crate::{capture::Capture, reconstruct::noise, reconstruction::Noise};

/// Patches of the background that are told apart.
pub const DARK_PLACES: usize = 24;

/// What does not change during a diagnosis.
pub struct Study<'a> {
    /// The photographs.
    pub capture: &'a Capture,
    /// The shape.
    pub bvh: Bvh,
    /// The photographs' noise.
    pub noise: Noise,
    /// What is looked at.
    pub seen: Observations,
    /// What may be done with each observation.
    pub role: Vec<Role>,
    /// `[observation][colour]`.
    pub value: Vec<f32>,
    /// Variances of the values.
    pub variance: Vec<f32>,
    /// What every site may receive of the light's sources.
    pub horizon: Arc<Horizon>,
    /// What is fitted of the light.
    pub light: Arc<LightModel>,
    /// Radiance of the simulation's sources, `[source][colour]`.
    pub radiance: Vec<f32>,
    /// Its lobe.
    pub lobe: Option<Lobe>,
    /// Its renders.
    pub renders: Vec<Image>,
    /// Radius of the object.
    pub radius: f32,
    texture: Arc<Bumps>,
    /// Occluders that the simulation has.
    pub given: Option<Given>,
    /// The frames among which some are sealed: none under known lamps.
    parted: usize,
}

impl<'a> Study<'a> {
    /// Prepares about `sites` places of the surface and a grid of light of `rows` × 2 `rows`.
    ///
    /// # Errors
    /// A mesh that cannot be traced, no place that is seen well, or renders that are not of the photographs' size.
    pub fn new(
        capture: &'a Capture,
        simulation: &Simulation,
        sites: usize,
        rows: usize,
        seed: u64,
    ) -> Result<Self, StudyError> {
        let renders = cut_out(capture, &simulation.renders)?;
        let bvh = Bvh::new(&capture.mesh)?;
        let noise = noise::estimate(&capture.frames);
        let seen = Observations::gather(capture, &bvh, &noise, sites, seed);
        if seen.views.len() < 200 {
            return Err(StudyError::TooLittle {
                views: seen.views.len(),
            });
        }
        let points: Vec<_> = seen.sites.iter().map(|s| s.point).collect();
        let positions: Vec<_> = points.iter().map(|p| p.position).collect();
        let (horizon, light, radiance) = match &capture.lamps {
            None => {
                let grid = LatLong::new(rows, 2 * rows);
                let radiance = resampled(&simulation.environment, grid);
                let light = LightModel::environment(grid, &radiance);
                (Horizon::of_grid(&bvh, grid, &points), light, radiance)
            }
            Some(lamps) => {
                let radiance = simulation.environment.data.clone();
                let light = LightModel::lamps(&radiance);
                (Horizon::of_lamps(&bvh, lamps, &points), light, radiance)
            }
        };
        // A frame's lamp is its own affair: under known lamps every frame takes part, and patches alone are sealed.
        let parted = if capture.lamps.is_some() {
            0
        } else {
            seen.frames
        };
        let role = (0..seen.len())
            .map(|i| match seen.views.get(i) {
                Some(view) => role(seen.sites[view.site as usize].place, view.frame, parted),
                None => {
                    let dark = &seen.dark[i - seen.views.len()];
                    dark_role(dark.patch, dark.frame, parted)
                }
            })
            .collect();
        let (value, variance) = (0..seen.len())
            .map(|i| seen.value(i))
            .unzip::<_, _, Vec<_>, Vec<_>>();
        Ok(Self {
            capture,
            noise,
            role,
            value: value.into_flattened(),
            variance: variance.into_flattened(),
            horizon: Arc::new(horizon),
            light: Arc::new(light),
            radiance,
            lobe: simulation.lobe,
            renders,
            radius: capture.mesh.bounding_radius(),
            texture: Arc::new(Bumps::texture(&positions)),
            given: Given::new(&simulation.occluders),
            parted,
            seen,
            bvh,
        })
    }

    /// Light transport to every view behind the occluders that the simulation has, if any.
    pub fn transport(&self, horizon: &Horizon, lobe: Option<Lobe>) -> Transport {
        let transport = Transport::new(horizon, &self.seen, lobe);
        match &self.given {
            None => transport,
            Some(given) => transport.masked(given.passing(horizon, &self.seen)),
        }
    }

    /// What the sites receive of known lamps at other places.
    pub fn horizon_under(&self, lamps: Vec<Source>) -> Horizon {
        let points: Vec<_> = self.seen.sites.iter().map(|s| s.point).collect();
        let ball = self.capture.lamps.as_ref().is_some_and(|lamps| lamps.ball);
        Horizon::of_sources(&self.bvh, ball, lamps, &points)
    }

    /// Image formation with this transport.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn formation_with(&self, transport: Arc<Transport>) -> Result<Formation, FitError> {
        Ok(Formation::new(
            self.light.clone(),
            transport,
            &self.seen,
            self.texture.clone(),
        )?)
    }

    /// Puts other values, `[observation][colour]`, in the place of the photographs', with their variances: for simulations.
    ///
    /// # Panics
    /// When their number is not that of the photographs' own.
    pub fn replace(&mut self, value: Vec<f32>, variance: Vec<f32>) {
        assert_eq!(
            (value.len(), variance.len()),
            (self.value.len(), self.variance.len())
        );
        (self.value, self.variance) = (value, variance);
    }

    /// Whether an observation takes part in fits, and may tell its site's own albedo.
    pub fn develops(&self, i: usize) -> bool {
        matches!(self.role[i], Role::Development(_))
    }

    /// Whether no fit sees a frame: every frame takes part in captures of a few, and under known lamps.
    pub fn frame_is_sealed(&self, frame: u32) -> bool {
        frame_sealed(frame, self.parted)
    }

    /// Whether any frame is set aside.
    pub fn seals_frames(&self) -> bool {
        (0..self.parted as u32).any(|frame| self.frame_is_sealed(frame))
    }

    /// Whether the albedo of a view's site was fitted: on sealed patches and in gutters it was not, and what differs there is mostly
    /// that.
    pub fn has_known_albedo(&self, view: usize) -> bool {
        matches!(self.role[view], Role::Development(_) | Role::SealedFrame)
    }

    /// The block an observation belongs to: a patch of surface in every fourth frame, or a patch of the background in one
    /// frame. Errors within a block are not independent.
    pub fn block(&self, i: usize) -> usize {
        match self.seen.views.get(i) {
            Some(view) => {
                let patch = self.seen.sites[view.site as usize].place.patch;
                4 * usize::from(patch) + view.frame as usize % 4
            }
            None => {
                let dark = &self.seen.dark[i - self.seen.views.len()];
                4 * self.seen.patches
                    + dark.frame as usize * DARK_PLACES
                    + dark.patch as usize % DARK_PLACES
            }
        }
    }

    /// How many blocks there are.
    pub fn blocks(&self) -> usize {
        4 * self.seen.patches + DARK_PLACES * self.seen.frames
    }
}

/// Radiance on `grid`.
fn resampled(environment: &Image, grid: LatLong) -> Vec<f32> {
    let from = LatLong::new(environment.height, environment.width);
    (0..grid.len())
        .flat_map(|t| {
            let direction = grid.texel_direction(t / grid.columns, t % grid.columns);
            let around = from.bilinear(direction);
            [0, 1, 2].map(|c| {
                (0..4)
                    .map(|k| {
                        let texel = around.index[k] as usize;
                        around.weight[k] * environment.data[environment.channels * texel + c]
                    })
                    .sum::<f32>()
            })
        })
        .collect()
}

/// Renders with the photographs' own coverage, so that edges are where they are in the photographs.
fn cut_out(capture: &Capture, renders: &[Image]) -> Result<Vec<Image>, StudyError> {
    let size = |image: &Image| [image.width, image.height];
    let all_fit = renders.len() == capture.frames.len()
        && renders.iter().zip(&capture.frames).all(|(render, frame)| {
            size(render) == size(&frame.image) && render.channels == frame.image.channels
        });
    if !all_fit {
        return Err(StudyError::Renders);
    }
    let mut renders = renders.to_vec();
    for (render, frame) in renders.iter_mut().zip(&capture.frames) {
        for (pixel, mask) in render.data.chunks_exact_mut(3).zip(&frame.mask.data) {
            pixel.iter_mut().for_each(|p| *p *= mask);
        }
    }
    Ok(renders)
}

/// Why a capture cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The mesh cannot be traced.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A simulation of something else.
    #[error(
        "the simulation's renders are not of the photographs' number and size: simulate this capture"
    )]
    Renders,
    /// Nothing to compare.
    #[error(
        "only {views} places of the surface are seen well in three frames or more; expected at least 200: check masks and poses, \
         or take more photographs"
    )]
    TooLittle {
        /// How many.
        views: usize,
    },
}
