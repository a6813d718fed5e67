//! Sampled paths as plain numbers.
//!
//! A path is camera → surface → light. Directions, densities, lobe choices and visibility are chosen here and carry no
//! gradient (Zeltner et al. 2021): the tape sees only what this batch holds, and re-evaluates the integrand at these fixed
//! directions. Samples that cannot contribute (hidden, below the surface) are dropped, so a point has a varying number.

mod block;
mod draw;
mod quadrature;
mod run;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use self::draw::Draw;
use self::run::Run;
use crate::bsdf::{Cosines, Material, Model, microfacet};
use crate::bvh::{Bvh, SurfacePoint};
use crate::environment::LightDistribution;
use crate::lat_long::LatLong;
use crate::transport::Quadrature;
use crate::visibility::Visibility;

/// A surface point to be shaded: where a camera ray met the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadingPoint {
    /// The surface.
    pub surface: SurfacePoint,
    /// Unit direction towards the camera.
    pub outgoing: Vec3,
    /// Frame, whose occluder shades it.
    pub frame: u32,
    /// Pixel of the frame: with the frame it keys the random numbers.
    pub pixel: u32,
    /// Its number in the visibility cache, if one is used.
    pub cached: u32,
    /// Present roughness, which material samples follow.
    pub alpha: f32,
}

/// All that paths are drawn from.
#[derive(Clone, Copy)]
pub struct PathScene<'a> {
    /// The object.
    pub bvh: &'a Bvh,
    /// How its own shadows are found.
    pub visibility: Visibility<'a>,
    /// Which reflectance it has.
    pub model: Model,
    /// Present brightness of the environment, on its grid.
    pub lights: &'a LightDistribution,
    /// Grid of the environment's table.
    pub environment_grid: LatLong,
    /// Grid of every mask.
    pub mask_grid: LatLong,
    /// Shell radius of each frame.
    pub radii: &'a [f32],
}

/// How many samples are drawn, and which.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathSettings {
    /// Samples a point drawn from the light.
    pub light_samples: usize,
    /// Samples a point drawn from the material.
    pub material_samples: usize,
    /// The run's seed.
    pub seed: u64,
    /// Iteration: new numbers every time.
    pub iteration: u32,
    /// How tables are read.
    pub lookup: Lookup,
    /// Which of several independent renders of the same pixels this is. The two renders of Eq. 9 must differ here.
    pub render: u32,
}

/// How a sample reads the tables of light and masks. Both have the same expectation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lookup {
    /// All four texels around its direction, by their weights.
    Bilinear,
    /// One of the four, chosen by their weights ("Stochastic Texture Filtering", Fajardo et al. 2023): a quarter of the
    /// memory traffic forwards and backwards, for a little noise.
    Stochastic,
}

/// Samples of many points, a value an array, samples of a point adjoining; the tape shares the arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct PathBatch {
    /// Samples of point p are `offsets[p]..offsets[p + 1]`.
    pub offsets: Vec<u32>,
    /// n·ωo of each point.
    pub outgoing: Arc<[f32]>,
    /// n·ωi of each sample.
    pub incident: Arc<[f32]>,
    /// n·h; nothing for Lambertian samples, which need none.
    pub half: Arc<[f32]>,
    /// h·ωi; likewise.
    pub difference: Arc<[f32]>,
    /// Multiple-importance weight over (sample count × density): a point's radiance is Σ weight · L · M · f · n·ωi.
    pub weight: Arc<[f32]>,
    /// Corners of the environment's texels.
    pub light: Corners,
    /// Corners of the masks' texels, as texel × frames + frame.
    pub mask: Corners,
}

/// The texels a sample reads, a corner an array: four with bilinear weights, or one without.
#[derive(Clone, Debug, PartialEq)]
pub struct Corners {
    /// Table indices of each corner.
    pub index: Vec<Arc<[u32]>>,
    /// Weights of each of four corners; empty for one.
    pub weight: Vec<Arc<[f32]>>,
}

/// Points are sampled in parallel in runs of about this many samples; results do not depend on it.
const RUN: usize = 1 << 14;

impl PathBatch {
    /// Draws the samples of all points.
    pub fn sample(scene: &PathScene, points: &[ShadingPoint], settings: &PathSettings) -> Self {
        let run = |points: &[ShadingPoint]| Draw::new(scene, settings).run(points);
        let each = (settings.light_samples + settings.material_samples).max(1);
        let runs: Vec<Run> = points.par_chunks(RUN.div_ceil(each)).map(run).collect();
        Run::join(&runs, settings.lookup)
    }

    /// The same integral without randomness: `side` × `side` directions in every texel of the environment, each weighted by
    /// its solid angle. It has no noise, and the bias of its grid.
    pub fn quadrature(scene: &PathScene, points: &[ShadingPoint], side: usize) -> Self {
        let quadrature = Quadrature::new(scene.environment_grid, side);
        let run = |points: &[ShadingPoint]| quadrature::quadrature(scene, points, &quadrature);
        let runs: Vec<Run> = points.par_chunks(16).map(run).collect();
        Run::join(&runs, Lookup::Bilinear)
    }

    /// The number of points.
    pub fn points(&self) -> usize {
        self.outgoing.len()
    }

    /// The number of samples.
    pub fn samples(&self) -> usize {
        self.weight.len()
    }

    /// Radiance of point `p` in plain numbers, f64: what the tape's evaluation is checked against.
    ///
    /// `environment` is `[texel][RGB]`, `masks` is `[texel][frame]`.
    pub fn radiance(
        &self,
        p: usize,
        model: Model,
        material: &Material,
        environment: &[f32],
        masks: &[f32],
    ) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for s in self.offsets[p] as usize..self.offsets[p + 1] as usize {
            let (factor, specular) = match model {
                Model::Lambertian => (1.0, 0.0),
                Model::Microfacet => {
                    let cosines = Cosines {
                        incident: f64::from(self.incident[s]),
                        outgoing: f64::from(self.outgoing[p]),
                        half: f64::from(self.half[s]),
                        difference: f64::from(self.difference[s]),
                    };
                    microfacet(
                        cosines,
                        f64::from(material.alpha),
                        f64::from(material.kappa),
                    )
                }
            };
            let passed = self.mask.gather(s, |i| f64::from(masks[i]));
            for c in 0..3 {
                let light = self.light.gather(s, |i| f64::from(environment[3 * i + c]));
                let f = f64::from(material.albedo[c]) / std::f64::consts::PI * factor + specular;
                sum[c] +=
                    f64::from(self.weight[s]) * light * passed * f * f64::from(self.incident[s]);
            }
        }
        sum
    }
}

impl Lookup {
    /// The number of texels read.
    pub fn corners(self) -> usize {
        match self {
            Self::Bilinear => 4,
            Self::Stochastic => 1,
        }
    }
}

impl Corners {
    /// The value of a table that sample `s` reads.
    pub fn gather(&self, s: usize, table: impl Fn(usize) -> f64) -> f64 {
        let weight = |k: usize| self.weight.get(k).map_or(1.0, |w| f64::from(w[s]));
        self.index
            .iter()
            .enumerate()
            .map(|(k, index)| weight(k) * table(index[s] as usize))
            .sum()
    }
}
