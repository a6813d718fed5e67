//! The image formation of patches on the tape: light through masks onto patches of diffuse albedo.
//!
//! Every parameter is in units of its prior's standard deviation, so that the prior is ½‖z‖². For patch p and frame t,
//! value = albedo_p Σ_d W_pd L_d M_t[S(p, d)]: the sum over directions is a contraction that works on all frames at once.

mod at;
mod fixed;
mod lots;
mod tape;

use std::ops::Range;

use autodiff::{GraphError, Program, RunError, Sizes, Workspace};
use render::{lat_long::LatLong, pyramid::Pyramid};

pub use at::At;
pub(super) use fixed::MASK_SIDE;
pub use fixed::mask_grid;
use fixed::{Fixed, FixedLot, dealt};
use lots::{Lots, WIDTH};
use tape::{CORNERS, WEIGHTS, coefficient, mixed_variances, record, steepness};

use super::{
    detail::Data, least_squares, patches::Observations, pyramid::level_deviations, shell::Shells,
    sky::SkyModel,
};

/// Standard deviations of the logarithm of radiance added by each level, finest (50 × 100) first.
const ENVIRONMENT_DEVIATIONS: [f32; 6] = [0.12, 0.25, 0.5, 0.8, 1.0, 1.0];

/// Everything about a capture that the tape reads and that does not change during a stage.
pub struct Shared {
    /// Grid of light, masks and transport.
    pub grid: LatLong,
    /// Where rays look masks up.
    pub shells: Shells,
    /// Occluders.
    pub sky: SkyModel,
    /// Logarithm of the radiance at z = 0.
    pub log_radiance: f32,
    /// Precision of the prior of the albedo about one half.
    pub albedo_precision: f32,
    /// Worker threads.
    pub threads: usize,
    /// Shaded samples (patch, direction, frame) of one pass over the data.
    pub samples: usize,
    /// [`Data::excess`] of what is fitted.
    pub excess: f64,
    patches: usize,
    pyramid: Pyramid,
    deviation: Vec<f32>,
    program: Program,
    lots: Lots,
    fixed: Fixed,
}

impl Shared {
    /// Prepares the tape for these observations; `rows` is `[patch][texel]` (see [`super::transport::rows`]).
    ///
    /// # Errors
    /// When the tape does not compile, which would be a bug.
    pub fn new(
        grid: LatLong,
        rows: &[f32],
        observations: &Observations,
        shells: Shells,
        sky: SkyModel,
        threads: usize,
    ) -> Result<Self, GraphError> {
        let levels = ENVIRONMENT_DEVIATIONS.len() - usize::from(grid.rows <= 25);
        let pyramid = Pyramid::new(grid, levels);
        let deviation = level_deviations(
            &pyramid,
            &ENVIRONMENT_DEVIATIONS[ENVIRONMENT_DEVIATIONS.len() - levels..],
        );
        let lots = Lots::new(&shells);
        let fixed = Fixed::new(grid, rows, observations, &lots);
        let count = observations.views.len().max(1) as f64;
        let mean = observations
            .views
            .iter()
            .map(|v| f64::from(v.value.iter().sum::<f32>()) / 3.0)
            .sum::<f64>()
            / count;
        let received = rows.iter().map(|&w| f64::from(w)).sum::<f64>()
            / observations.patches.len().max(1) as f64;
        Ok(Self {
            grid,
            sky,
            // Albedo one half explains the mean of the photographs.
            log_radiance: (mean.max(1e-9) / (0.5 * received.max(1e-9))).ln() as f32,
            albedo_precision: 16.0,
            threads,
            samples: fixed.texel.len() * shells.frames(),
            excess: 1.0,
            patches: observations.patches.len(),
            program: record(&pyramid)?,
            shells,
            lots,
            pyramid,
            deviation,
            fixed,
        })
    }

    /// The same patches under the same light, with nothing in its way; `observations` are those of [`Shared::new`].
    ///
    /// # Errors
    /// As [`Shared::new`].
    pub fn unoccluded(
        &self,
        observations: &Observations,
        shells: Shells,
    ) -> Result<Self, GraphError> {
        let lots = Lots::new(&shells);
        Ok(Self {
            fixed: self.fixed.repainted(self.grid, observations, &lots),
            program: record(&self.pyramid)?,
            lots,
            sky: SkyModel::Clear,
            shells,
            pyramid: self.pyramid.clone(),
            deviation: self.deviation.clone(),
            ..*self
        })
    }

    /// The masks' grid, as fine as `MASK_SIDE` parts of a texel of light: shadows have edges where light has none.
    pub fn mask_grid(&self) -> LatLong {
        mask_grid(self.grid)
    }

    /// How many parameters: environment, then occluders.
    pub fn parameters(&self) -> usize {
        self.ranges()[1].end
    }

    /// Where environment and occluders lie in z.
    pub fn ranges(&self) -> [Range<usize>; 2] {
        let environment = 3 * self.pyramid.len();
        [
            0..environment,
            environment..environment + self.sky.parameters(),
        ]
    }

    /// The number of albedo values: `[channel][patch]`.
    pub fn albedos(&self) -> usize {
        3 * self.patches
    }

    /// The largest change of a texel's log luminance or of a silhouette's logit over a step from `z`.
    pub fn largest_change(&self, z: &[f32], delta: &[f32]) -> f32 {
        let scaled: Vec<f32> = z
            .iter()
            .zip(delta)
            .zip(&self.deviation)
            .map(|((z, delta), sd)| (coefficient(z + delta) - coefficient(*z)) * sd)
            .collect();
        let mut values = vec![0.0; self.grid.len()];
        self.pyramid.apply(&scaled, &mut values, 1);
        let light = values.iter().fold(1e-9f32, |m, v| m.max(v.abs()));
        light.max(0.75 * self.sky.largest_change(&delta[self.ranges()[1].clone()]))
    }

    /// The variance that the prior leaves each texel's log radiance around `z`, `[texel][channel]`.
    pub fn prior_variances(&self, z: &[f32]) -> Vec<f64> {
        let values = self.pyramid.len();
        let own = |component: usize, value: usize| {
            let steep = steepness(z[component * values + value]) * self.deviation[value];
            f64::from(steep).powi(2)
        };
        let mixed = mixed_variances();
        let of_texel = |texel: usize| {
            let mut parts: Vec<(usize, f64)> = self.pyramid.parts(texel).collect();
            // At the poles two corners of an interpolation are one value.
            parts.sort_unstable_by_key(|part| part.0);
            let sums: [f64; 3] = std::array::from_fn(|component| {
                let same = parts.chunk_by(|a, b| a.0 == b.0);
                same.map(|same| {
                    let weight: f64 = same.iter().map(|part| part.1).sum();
                    weight.powi(2) * own(component, same[0].0)
                })
                .sum()
            });
            mixed.map(|row| row.iter().zip(sums).map(|(m, sum)| m * sum).sum())
        };
        (0..self.grid.len()).flat_map(of_texel).collect()
    }

    /// Transmittance of every frame's occluder at `z`, `[texel][frame]`; empty when occluders are not modelled.
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug.
    pub fn masks(&self, z: &[f32]) -> Result<Vec<f32>, RunError> {
        Ok(self
            .sky
            .at(self.mask_grid(), &z[self.ranges()[1].clone()])?
            .map_or(Vec::new(), |at| at.masks))
    }

    /// Linearises at `z`, with the albedo at its best: the linearisation and the albedo.
    ///
    /// # Errors
    /// As [`masks`](Self::masks).
    pub fn linearise(&self, z: &[f32]) -> Result<(At<'_>, Vec<f32>), RunError> {
        let [environment, occluders] = self.ranges();
        let sky = self.sky.at(self.mask_grid(), &z[occluders])?;
        let passed = sky.as_ref().map(|at| at.passed.as_slice());
        let mut runs = self.bind(&z[environment], passed)?;
        let (half, ones) = (vec![0.5; self.albedos()], vec![1.0; self.albedos()]);
        for run in &mut runs {
            run.set("albedo", &half)?;
            self.program.jvp(run, &[("albedo", &ones)])?;
        }
        let by_albedo = joined(&runs, |run| run.tangent("residual"))?;
        let albedo = least_squares::best_albedo(
            &joined(&runs, |run| run.output("residual"))?,
            &by_albedo,
            &self.fixed.albedo_of,
            &half,
            self.albedo_precision,
        );
        for run in &mut runs {
            run.set("albedo", &albedo)?;
            self.program.forward(run)?;
        }
        let residual = joined(&runs, |run| run.output("residual"))?;
        Ok((
            At {
                shared: self,
                runs,
                sky,
                residual,
                by_albedo,
            },
            albedo,
        ))
    }

    /// Fits these values (linear RGB of every view) with these weights from here on; `observations` are those of
    /// [`Shared::new`].
    pub fn fit_to(&mut self, observations: &Observations, data: &Data) {
        let dealt = |part: &dyn Fn(usize, usize) -> f32| {
            dealt(&self.lots, self.patches, observations, part)
        };
        self.excess = data.excess;
        let value = dealt(&|i, c| data.value[i][c]);
        let weight = dealt(&|i, c| data.weight[i][c].sqrt());
        for (lot, (value, weight)) in self
            .fixed
            .lots
            .iter_mut()
            .zip(value.into_iter().zip(weight))
        {
            lot.value = value.into();
            lot.root_weight = weight.into();
        }
    }

    /// A run of the tape for each lot of frames.
    fn bind(
        &self,
        environment: &[f32],
        masks: Option<&[f32]>,
    ) -> Result<Vec<Workspace<f32>>, RunError> {
        let fixed = &self.fixed;
        let sizes = Sizes::new()
            .lanes("level", self.pyramid.len())
            .lanes("texel", self.grid.len())
            .lanes("mask texel", self.mask_grid().len())
            .lanes("patch", self.patches)
            .offsets("direction", fixed.offsets.clone())
            .axis("frame", WIDTH)
            .threads(self.threads);
        let run = |(lot, inputs): (usize, &FixedLot)| {
            let mut run = self.program.workspace::<f32>(&sizes)?;
            run.set("environment", environment)?;
            run.set("deviation", &self.deviation)?;
            run.set("log radiance", &[self.log_radiance])?;
            run.bind_index("own texel", fixed.texel.clone())?;
            run.bind("transport", fixed.weight.clone())?;
            for k in 0..4 {
                run.bind_index(CORNERS[k], inputs.lookups.corner[k].clone())?;
                run.bind(WEIGHTS[k], inputs.lookups.weight[k].clone())?;
            }
            let mask = match masks {
                Some(masks) => self.lots.columns(masks, lot),
                None => vec![1.0; self.mask_grid().len() * WIDTH],
            };
            run.set("mask", &mask)?;
            run.bind("value", inputs.value.clone())?;
            run.bind("root weight", inputs.root_weight.clone())?;
            Ok(run)
        };
        fixed.lots.iter().enumerate().map(run).collect()
    }
}

/// The residuals, or what belongs to them, of all lots one after the other.
fn joined<'w>(
    runs: &'w [Workspace<f32>],
    part: impl Fn(&'w Workspace<f32>) -> Result<&'w [f32], RunError>,
) -> Result<Vec<f32>, RunError> {
    let parts = runs.iter().map(part).collect::<Result<Vec<_>, _>>()?;
    Ok(parts.concat())
}
