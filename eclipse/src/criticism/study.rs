//! A capture and its simulation, prepared to be compared.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use render::{bvh::Bvh, image::Image, lat_long::LatLong, mesh::MeshError};

use super::{
    fit::FitError,
    formation::{Bumps, Formation},
    horizon::{Horizon, Source},
    light::LightModel,
    observe::Observations,
    split::{Role, dark_role, role},
    transport::{Lobe, Transport},
};
use crate::{
    capture::{Capture, Frame},
    files::read_limited,
    image_io::{self, ExrFile, ImageIoError},
    layout,
    reconstruct::noise,
    reconstruction::{Noise, Reconstruction},
};

/// Largest `settings.json`.
const MAX_SETTINGS: u64 = 1 << 20;

/// What of a reconstruction a diagnosis starts from.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// Radiance, equirectangular, three channels; where lamps are known, one row with what each of them has.
    pub environment: Image,
    /// The lobe; `None` for Lambertian surfaces.
    pub lobe: Option<Lobe>,
    /// The photographs as it renders them.
    pub renders: Vec<Image>,
    /// What each frame's occluder lets through, if it has occluders.
    pub occluders: Vec<Image>,
}

impl Simulation {
    /// Of a reconstruction in memory.
    pub fn of(reconstruction: &Reconstruction) -> Self {
        Self {
            environment: reconstruction.environment.clone(),
            lobe: lobe_or_usual(
                &reconstruction.materials,
                reconstruction.settings.lambertian,
            ),
            renders: reconstruction.renders.clone(),
            occluders: reconstruction.occluders.clone(),
        }
    }

    /// Of the folder that `reconstruct` wrote for this capture.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another capture.
    pub fn load(folder: &Path, capture: &Capture) -> Result<Self, SimulationError> {
        let frames = capture.frames.len();
        let numbered = |name: &str, t: usize| folder.join(name).join(layout::numbered(t));
        let found = (0..)
            .take_while(|t| numbered(layout::RENDERS, *t).is_file())
            .count();
        if found != frames {
            return Err(SimulationError::Count {
                path: folder.join(layout::RENDERS),
                found,
                expected: frames,
            });
        }
        let render = |(t, frame): (usize, &Frame)| {
            let path = numbered(layout::RENDERS, t);
            let render = image_io::read_exr(&path)?.to_rgb();
            let size = |image: &Image| [image.width, image.height];
            let (found, expected) = (size(&render), size(&frame.image));
            if found != expected {
                return Err(SimulationError::Size {
                    path,
                    found,
                    expected,
                });
            }
            Ok(render)
        };
        let renders = capture.frames.iter().enumerate().map(render);
        let renders = renders.collect::<Result<_, _>>()?;
        let materials: Vec<Image> = (0..frames)
            .map(|t| {
                Ok(materials_of(&image_io::read_exr_file(&numbered(
                    layout::MATERIALS,
                    t,
                ))?))
            })
            .collect::<Result<_, ImageIoError>>()?;
        // A run without occluders leaves none.
        let occluders = if numbered(layout::OCCLUDERS, 0).is_file() {
            (0..frames)
                .map(|t| image_io::read_exr(&numbered(layout::OCCLUDERS, t)))
                .collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        Ok(Self {
            environment: image_io::read_exr(&folder.join(layout::ENVIRONMENT))?.to_rgb(),
            lobe: lobe_or_usual(&materials, is_lambertian(folder)),
            renders,
            occluders,
        })
    }
}

/// The mean lobe of material images (`R G B alpha kappa`), where they hold an object that has one.
pub fn lobe_of(materials: &[Image]) -> Option<Lobe> {
    let (mut alpha, mut kappa, mut count) = (0.0f64, 0.0f64, 0u64);
    for image in materials.iter().filter(|image| image.channels == 5) {
        for pixel in image.data.chunks_exact(5) {
            if pixel[3] > 0.0 && pixel[..3].iter().any(|&a| a > 0.0) {
                alpha += f64::from(pixel[3]);
                kappa += f64::from(pixel[4]);
                count += 1;
            }
        }
    }
    let (alpha, kappa) = (alpha / count as f64, kappa / count as f64);
    (count > 0 && kappa > 1e-6).then_some(Lobe {
        alpha: alpha as f32,
        kappa: kappa as f32,
    })
}

/// The lobe of materials, or the usual one where a solver that was free to find one ended before it did: such a lobe is a part
/// of the model, not of the physics it lacks.
fn lobe_or_usual(materials: &[Image], lambertian: bool) -> Option<Lobe> {
    if lambertian {
        return None;
    }
    Some(lobe_of(materials).unwrap_or(Lobe::USUAL))
}

/// Whether the reconstruction in a folder was told that the surface is Lambertian; `false` where it does not say.
fn is_lambertian(folder: &Path) -> bool {
    read_limited(&folder.join(layout::SETTINGS), MAX_SETTINGS)
        .ok()
        .and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok())
        .and_then(|settings| settings.get("lambertian")?.as_bool())
        .unwrap_or(false)
}

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
        let frames = if capture.lamps.is_some() {
            0
        } else {
            seen.frames
        };
        let role = (0..seen.len())
            .map(|i| match seen.views.get(i) {
                Some(view) => role(seen.sites[view.site as usize].place, view.frame, frames),
                None => {
                    let dark = &seen.dark[i - seen.views.len()];
                    dark_role(dark.patch, dark.frame, frames)
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
            seen,
            bvh,
        })
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
                4 * self.seen.patches + dark.frame as usize * 24 + dark.patch as usize % 24
            }
        }
    }

    /// How many blocks there are.
    pub fn blocks(&self) -> usize {
        4 * self.seen.patches + 24 * self.seen.frames
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

/// Why a reconstruction cannot be what a diagnosis starts from.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// Renders of other photographs.
    #[error("{} holds {found} renders, but the capture has {expected} frames: name the folder that reconstruct wrote for this capture", path.display())]
    Count {
        /// Their folder.
        path: PathBuf,
        /// How many there are.
        found: usize,
        /// How many frames the capture has.
        expected: usize,
    },
    /// A render of another size than its photograph.
    #[error(
        "{} has {} × {} pixels, but the photograph {} × {}: name the folder that reconstruct wrote for this capture",
        path.display(), found[0], found[1], expected[0], expected[1]
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Its pixels across and down.
        found: [usize; 2],
        /// The photograph's.
        expected: [usize; 2],
    },
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

/// A material image from its file, channels in the order of [`layout::MATERIAL_CHANNELS`].
fn materials_of(file: &ExrFile) -> Image {
    let channels: Vec<Option<usize>> = layout::MATERIAL_CHANNELS
        .iter()
        .map(|name| file.channel_names.iter().position(|n| n == name))
        .collect();
    let image = &file.image;
    let mut out = Image::filled(image.width, image.height, 5, 0.0);
    for (target, source) in out
        .data
        .chunks_exact_mut(5)
        .zip(image.data.chunks_exact(image.channels))
    {
        for (t, channel) in target.iter_mut().zip(&channels) {
            *t = channel.map_or(0.0, |c| source[c]);
        }
    }
    out
}
