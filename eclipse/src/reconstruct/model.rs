//! The image formation of patches on the tape: light through masks onto patches of diffuse albedo.
//!
//! Every parameter is in units of its prior's standard deviation, so that the prior is ½‖z‖². For patch p and frame t,
//! value = albedo_p Σ_d W_pd L_d M_t[S(p, d)]: the sum over directions is a contraction that works on all frames at once.

use std::{ops::Range, sync::Arc};

use autodiff::{Array, Differentiable, Graph, GraphError, Program, RunError, Sizes, Workspace};
use glam::Vec3;
use render::{lat_long::LatLong, maps::PyramidMap, pyramid::Pyramid};

use super::{
    least_squares::{self, Linearisation},
    patches::{Observations, View},
    pyramid::level_deviations,
    shell::Shell,
    sky::{SkyAt, SkyModel},
};

/// Standard deviations of the logarithm of radiance added by each level, finest (50 × 100) first.
const ENVIRONMENT_DEVIATIONS: [f32; 6] = [0.12, 0.25, 0.5, 0.8, 1.0, 1.0];
/// Colour varies less than brightness: standard deviation of each chroma component relative to luminance.
const CHROMA: f64 = 0.68;

/// Everything about a capture that the tape reads and that does not change during a stage.
pub struct Shared {
    /// Grid of light, masks and transport.
    pub grid: LatLong,
    /// Where rays look masks up.
    pub shell: Shell,
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
    patches: usize,
    frames: usize,
    pyramid: Pyramid,
    deviation: Vec<f32>,
    program: Program,
    fixed: Fixed,
}

/// Inputs of the tape, bound without copies.
struct Fixed {
    offsets: Arc<[u32]>,
    texel: Arc<[u32]>,
    weight: Arc<[f32]>,
    corner: [Arc<[u32]>; 4],
    corner_weight: [Arc<[f32]>; 4],
    value: Arc<[f32]>,
    root_weight: Arc<[f32]>,
    groups: Arc<[u32]>,
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
        frames: usize,
        shell: Shell,
        sky: SkyModel,
        threads: usize,
    ) -> Result<Self, GraphError> {
        let levels = ENVIRONMENT_DEVIATIONS.len() - usize::from(grid.rows <= 25);
        let pyramid = Pyramid::new(grid, levels);
        let deviation = level_deviations(
            &pyramid,
            &ENVIRONMENT_DEVIATIONS[ENVIRONMENT_DEVIATIONS.len() - levels..],
        );
        let fixed = Fixed::new(grid, rows, observations, frames, &shell);
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
            shell,
            sky,
            // Albedo one half explains the mean of the photographs.
            log_radiance: (mean.max(1e-9) / (0.5 * received.max(1e-9))).ln() as f32,
            albedo_precision: 16.0,
            threads,
            samples: fixed.texel.len() * frames,
            patches: observations.patches.len(),
            frames,
            program: record(&pyramid)?,
            pyramid,
            deviation,
            fixed,
        })
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

    /// The largest change of a texel's log luminance or of a silhouette's logit over a step.
    pub fn largest_change(&self, delta: &[f32]) -> f32 {
        let scaled: Vec<f32> = delta
            .iter()
            .zip(&self.deviation)
            .map(|(z, sd)| z * sd)
            .collect();
        let mut values = vec![0.0; self.grid.len()];
        self.pyramid.apply(&scaled, &mut values, 1);
        let light = values.iter().fold(1e-9f32, |m, v| m.max(v.abs()));
        light.max(0.75 * self.sky.largest_change(&delta[self.ranges()[1].clone()]))
    }

    /// Transmittance of every frame's occluder at `z`, `[texel][frame]`; empty when occluders are not modelled.
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug.
    pub fn masks(&self, z: &[f32]) -> Result<Vec<f32>, RunError> {
        Ok(self
            .sky
            .at(self.grid, &z[self.ranges()[1].clone()])?
            .map_or(Vec::new(), |at| at.masks))
    }

    /// Linearises at `z`, with the albedo at its best: the linearisation and the albedo.
    ///
    /// # Errors
    /// As [`masks`](Self::masks).
    pub fn linearise(&self, z: &[f32]) -> Result<(At<'_>, Vec<f32>), RunError> {
        let [environment, occluders] = self.ranges();
        let sky = self.sky.at(self.grid, &z[occluders])?;
        let mut ws = self.bind(&z[environment], sky.as_ref().map(|at| at.masks.as_slice()))?;
        let (half, ones) = (vec![0.5; self.albedos()], vec![1.0; self.albedos()]);
        ws.set("albedo", &half)?;
        self.program.jvp(&mut ws, &[("albedo", &ones)])?;
        let by_albedo = ws.tangent("residual")?.to_vec();
        let groups = &self.fixed.groups;
        let albedo = least_squares::best_albedo(
            ws.output("residual")?,
            &by_albedo,
            groups,
            &half,
            self.albedo_precision,
        );
        ws.set("albedo", &albedo)?;
        self.program.forward(&mut ws)?;
        let residual = ws.output("residual")?.to_vec();
        Ok((
            At {
                shared: self,
                ws,
                sky,
                residual,
                by_albedo,
            },
            albedo,
        ))
    }

    /// Fits the photographs less `part` (linear RGB of every view) from here on; `observations` are those of [`Shared::new`].
    pub fn subtract(&mut self, observations: &Observations, part: &[[f32; 3]]) {
        let mut value = vec![0.0; self.fixed.value.len()];
        for (view, part) in observations.views.iter().zip(part) {
            for c in 0..3 {
                let row = c * self.patches + view.patch as usize;
                value[row * self.frames + view.frame as usize] = view.value[c] - part[c];
            }
        }
        self.fixed.value = value.into();
    }

    fn bind(&self, environment: &[f32], masks: Option<&[f32]>) -> Result<Workspace<f32>, RunError> {
        let fixed = &self.fixed;
        let sizes = Sizes::new()
            .lanes("level", self.pyramid.len())
            .lanes("texel", self.grid.len())
            .lanes("patch", self.patches)
            .offsets("direction", fixed.offsets.clone())
            .axis("frame", self.frames)
            .threads(self.threads);
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("environment", environment)?;
        ws.set("deviation", &self.deviation)?;
        ws.set("log radiance", &[self.log_radiance])?;
        ws.bind_index("own texel", fixed.texel.clone())?;
        ws.bind("transport", fixed.weight.clone())?;
        for k in 0..4 {
            ws.bind_index(&format!("corner {k}"), fixed.corner[k].clone())?;
            ws.bind(
                &format!("corner weight {k}"),
                fixed.corner_weight[k].clone(),
            )?;
        }
        let clear;
        let masks = match masks {
            Some(masks) => masks,
            None => {
                clear = vec![1.0; self.grid.len() * self.frames];
                &clear
            }
        };
        ws.set("mask", masks)?;
        ws.bind("value", fixed.value.clone())?;
        ws.bind("root weight", fixed.root_weight.clone())?;
        Ok(ws)
    }
}

impl Fixed {
    fn new(
        grid: LatLong,
        rows: &[f32],
        observations: &Observations,
        frames: usize,
        shell: &Shell,
    ) -> Self {
        let (mut offsets, mut texel, mut weight) = (vec![0u32], Vec::new(), Vec::new());
        let mut corner: [Vec<u32>; 4] = Default::default();
        let mut corner_weight: [Vec<f32>; 4] = Default::default();
        let directions: Vec<Vec3> = (0..grid.len())
            .map(|d| grid.texel_direction(d / grid.columns, d % grid.columns))
            .collect();
        for (row, patch) in rows.chunks_exact(grid.len()).zip(&observations.patches) {
            for (d, &w) in row.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                texel.push(d as u32);
                weight.push(w);
                let lookup = shell.lookup(grid, patch.position, directions[d]);
                for k in 0..4 {
                    corner[k].push(lookup.index[k]);
                    corner_weight[k].push(lookup.weight[k]);
                }
            }
            offsets.push(texel.len() as u32);
        }
        let patches = observations.patches.len();
        let dense = |part: &dyn Fn(&View, usize) -> f32| -> Arc<[f32]> {
            let mut all = vec![0.0; 3 * patches * frames];
            for view in &observations.views {
                for c in 0..3 {
                    all[(c * patches + view.patch as usize) * frames + view.frame as usize] =
                        part(view, c);
                }
            }
            all.into()
        };
        Self {
            offsets: offsets.into(),
            texel: texel.into(),
            weight: weight.into(),
            corner: corner.map(Into::into),
            corner_weight: corner_weight.map(Into::into),
            value: dense(&|v, c| v.value[c]),
            root_weight: dense(&|v, c| v.weight[c].sqrt()),
            groups: (0..3 * patches * frames)
                .map(|i| (i / frames) as u32)
                .collect(),
        }
    }
}

/// The model linearised at a point.
pub struct At<'a> {
    shared: &'a Shared,
    ws: Workspace<f32>,
    sky: Option<SkyAt>,
    residual: Vec<f32>,
    by_albedo: Vec<f32>,
}

impl At<'_> {
    /// Radiance, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn radiance(&self) -> Result<Vec<f32>, RunError> {
        let planar = self.ws.output("radiance")?;
        let n = self.shared.grid.len();
        Ok((0..3 * n).map(|i| planar[(i % 3) * n + i / 3]).collect())
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
        &self.shared.fixed.groups
    }

    fn jvp(&mut self, v: &[f32]) -> Vec<f32> {
        let [environment, occluders] = self.shared.ranges();
        let mask = self
            .sky
            .as_mut()
            .map(|sky| self.shared.sky.push(sky, &v[occluders]));
        let mut direction = vec![("environment", &v[environment])];
        if let Some(mask) = &mask {
            direction.push(("mask", mask));
        }
        self.shared
            .program
            .jvp(&mut self.ws, &direction)
            .expect("a direction of the model's own size");
        self.ws
            .tangent("residual")
            .expect("an output of the model")
            .to_vec()
    }

    fn vjp(&mut self, w: &[f32]) -> Vec<f32> {
        self.shared
            .program
            .vjp_with(&mut self.ws, &[("residual", w)])
            .expect("a cotangent of the model's own size");
        let mut z = self
            .ws
            .gradient("environment")
            .expect("a parameter of the model")
            .to_vec();
        if let Some(sky) = &mut self.sky {
            let masks = self.ws.gradient("mask").expect("a parameter of the model");
            z.extend(self.shared.sky.pull(sky, masks));
        }
        z
    }
}

fn record(pyramid: &Pyramid) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (level, texel, patch) = (g.domain("level"), g.domain("texel"), g.domain("patch"));
    let direction = g.segments("direction", &patch);
    let frame = g.axis("frame");

    // Light (Eq. 7): luminance and two chroma components.
    let coefficients = g.param("environment", &level, 3) * g.input("deviation", &level, 1);
    let log = coefficients.linear_map(&texel, Arc::new(PyramidMap(pyramid.clone())));
    let luminance = log.channel(0) + g.input("log radiance", &g.uniform(), 1);
    let red_green = log.channel(1) * (CHROMA / 2f64.sqrt());
    let blue_yellow = log.channel(2) * (CHROMA / 6f64.sqrt());
    let log = Array::stack(&[
        &(&luminance + &red_green + &blue_yellow),
        &(&luminance - &red_green + &blue_yellow),
        &(&luminance - &blue_yellow * 2.0),
    ]);
    let radiance = log.clamp(-20.0, 14.0).exp();

    let arriving = radiance.gather(&g.index("own texel", &direction, &texel))
        * g.input("transport", &direction, 1);
    let corners: Vec<_> = (0..4)
        .map(|k| g.index(&format!("corner {k}"), &direction, &texel))
        .collect();
    let weights: Vec<_> = (0..4)
        .map(|k| g.input(&format!("corner weight {k}"), &direction, 1))
        .collect();
    let lookups: Vec<_> = corners.iter().zip(&weights).collect();
    let masks = g
        .param_along("mask", &texel, 1, &frame)
        .gather_weighted(&lookups);
    let received = arriving.segment_dot(&masks);

    let albedo = g.param("albedo", &patch, 3);
    let value = g.input_along("value", &patch, 3, &frame);
    let residual = (albedo * received - value) * g.input_along("root weight", &patch, 3, &frame);
    g.compile::<_, Differentiable>(&[("residual", &residual), ("radiance", &radiance)])
}
