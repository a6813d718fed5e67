//! The image formation of patches on the tape: light through masks onto patches of diffuse albedo.
//!
//! Every parameter is in units of its prior's standard deviation, so that the prior is ½‖z‖². For patch p and frame t,
//! value = albedo_p Σ_d W_pd L_d M_t[S(p, d)]: the sum over directions is a contraction that works on all frames at once.

use std::{ops::Range, sync::Arc};

use autodiff::{
    Array, Differentiable, Graph, GraphError, Program, RunError, Sizes, Var, Workspace,
};
use glam::Vec3;
use render::{lat_long::LatLong, maps::PyramidMap, pyramid::Pyramid};

use super::{
    detail::Data,
    least_squares::{self, Linearisation},
    patches::{Observations, View},
    pyramid::level_deviations,
    shell::{Shell, Shells},
    sky::{SkyAt, SkyModel},
};

/// Standard deviations of the logarithm of radiance added by each level, finest (50 × 100) first.
const ENVIRONMENT_DEVIATIONS: [f32; 6] = [0.12, 0.25, 0.5, 0.8, 1.0, 1.0];
/// Colour varies less than brightness: standard deviation of each chroma component relative to luminance.
const CHROMA: f64 = 0.68;

/// Texels of a mask along the side of one of light.
const MASK_SIDE: usize = 2;

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
    patches: usize,
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
    groups: Vec<FixedGroup>,
    /// Which albedo each residual depends on.
    albedo_of: Arc<[u32]>,
}

/// Inputs of a group of frames; values are `[channel][patch][frame of the group]`.
struct FixedGroup {
    corner: [Arc<[u32]>; 4],
    corner_weight: [Arc<[f32]>; 4],
    value: Arc<[f32]>,
    root_weight: Arc<[f32]>,
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
        let fixed = Fixed::new(grid, rows, observations, &shells);
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
            patches: observations.patches.len(),
            program: record(&pyramid, shells.groups.len())?,
            shells,
            pyramid,
            deviation,
            fixed,
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
        let mut ws = self.bind(&z[environment], sky.as_ref().map(|at| at.masks.as_slice()))?;
        let (half, ones) = (vec![0.5; self.albedos()], vec![1.0; self.albedos()]);
        ws.set("albedo", &half)?;
        self.program.jvp(&mut ws, &[("albedo", &ones)])?;
        let by_albedo = self.joined(|name| ws.tangent(name))?;
        let albedo = least_squares::best_albedo(
            &self.joined(|name| ws.output(name))?,
            &by_albedo,
            &self.fixed.albedo_of,
            &half,
            self.albedo_precision,
        );
        ws.set("albedo", &albedo)?;
        self.program.forward(&mut ws)?;
        let residual = self.joined(|name| ws.output(name))?;
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

    /// The residuals of all groups of frames, one after the other.
    fn joined<'w>(
        &self,
        part: impl Fn(&str) -> Result<&'w [f32], RunError>,
    ) -> Result<Vec<f32>, RunError> {
        let mut all = Vec::with_capacity(self.fixed.albedo_of.len());
        for g in 0..self.shells.groups.len() {
            all.extend_from_slice(part(&named("residual", g))?);
        }
        Ok(all)
    }

    /// The columns of one group of `[texel][frame]`.
    fn columns(&self, masks: &[f32], group: usize) -> Vec<f32> {
        let frames = &self.shells.groups[group].frames;
        masks
            .chunks_exact(self.shells.frames())
            .flat_map(|of_texel| frames.iter().map(|&t| of_texel[t]))
            .collect()
    }

    /// Fits these values (linear RGB of every view) with these weights from here on; `observations` are those of
    /// [`Shared::new`].
    pub fn fit_to(&mut self, observations: &Observations, data: &Data) {
        let group = |part: &dyn Fn(usize, usize) -> f32| {
            grouped(&self.shells, self.patches, observations, part)
        };
        let value = group(&|i, c| data.value[i][c]);
        let weight = group(&|i, c| data.weight[i][c].sqrt());
        for (group, (value, weight)) in self
            .fixed
            .groups
            .iter_mut()
            .zip(value.into_iter().zip(weight))
        {
            group.value = value.into();
            group.root_weight = weight.into();
        }
    }

    fn bind(&self, environment: &[f32], masks: Option<&[f32]>) -> Result<Workspace<f32>, RunError> {
        let fixed = &self.fixed;
        let mut sizes = Sizes::new()
            .lanes("level", self.pyramid.len())
            .lanes("texel", self.grid.len())
            .lanes("mask texel", self.mask_grid().len())
            .lanes("patch", self.patches)
            .offsets("direction", fixed.offsets.clone())
            .threads(self.threads);
        for (g, group) in self.shells.groups.iter().enumerate() {
            sizes = sizes.axis(&named("frame", g), group.frames.len());
        }
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("environment", environment)?;
        ws.set("deviation", &self.deviation)?;
        ws.set("log radiance", &[self.log_radiance])?;
        ws.bind_index("own texel", fixed.texel.clone())?;
        ws.bind("transport", fixed.weight.clone())?;
        for (g, group) in fixed.groups.iter().enumerate() {
            for k in 0..4 {
                ws.bind_index(&named(CORNERS[k], g), group.corner[k].clone())?;
                ws.bind(&named(WEIGHTS[k], g), group.corner_weight[k].clone())?;
            }
            let mask = match masks {
                Some(masks) => self.columns(masks, g),
                None => vec![1.0; self.mask_grid().len() * self.shells.groups[g].frames.len()],
            };
            ws.set(&named("mask", g), &mask)?;
            ws.bind(&named("value", g), group.value.clone())?;
            ws.bind(&named("root weight", g), group.root_weight.clone())?;
        }
        Ok(ws)
    }
}

/// The masks' grid beside that of light.
pub(super) fn mask_grid(grid: LatLong) -> LatLong {
    LatLong::new(MASK_SIDE * grid.rows, MASK_SIDE * grid.columns)
}

const CORNERS: [&str; 4] = ["corner 0", "corner 1", "corner 2", "corner 3"];
const WEIGHTS: [&str; 4] = ["weight 0", "weight 1", "weight 2", "weight 3"];

/// The name of what the tape holds once for every group of frames.
fn named(what: &str, group: usize) -> String {
    format!("{what} of group {group}")
}

/// Values of all views by group of frames, `[channel][patch][frame of the group]`; zero where there is no view.
fn grouped(
    shells: &Shells,
    patches: usize,
    observations: &Observations,
    part: &dyn Fn(usize, usize) -> f32,
) -> Vec<Vec<f32>> {
    let counts: Vec<usize> = shells.groups.iter().map(|g| g.frames.len()).collect();
    let mut all: Vec<Vec<f32>> = counts.iter().map(|n| vec![0.0; 3 * patches * n]).collect();
    for (i, view) in observations.views.iter().enumerate() {
        let [group, k] = shells.place[view.frame as usize];
        for c in 0..3 {
            let row = c * patches + view.patch as usize;
            all[group][row * counts[group] + k] = part(i, c);
        }
    }
    all
}

impl Fixed {
    fn new(grid: LatLong, rows: &[f32], observations: &Observations, shells: &Shells) -> Self {
        let (mut offsets, mut texel, mut weight) = (vec![0u32], Vec::new(), Vec::new());
        for row in rows.chunks_exact(grid.len()) {
            for (d, &w) in row.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                texel.push(d as u32);
                weight.push(w);
            }
            offsets.push(texel.len() as u32);
        }
        let patches = observations.patches.len();
        let views = &observations.views;
        let values = grouped(shells, patches, observations, &|i, c| views[i].value[c]);
        let weights = grouped(shells, patches, observations, &|i, c| {
            views[i].weight[c].sqrt()
        });
        let mut albedo_of = Vec::new();
        let groups = shells
            .groups
            .iter()
            .zip(values.into_iter().zip(weights))
            .map(|(group, (value, root_weight))| {
                let count = group.frames.len();
                albedo_of.extend((0..3 * patches * count).map(|i| (i / count) as u32));
                let (corner, corner_weight) =
                    lookups(grid, &offsets, &texel, observations, group.shell);
                FixedGroup {
                    corner: corner.map(Into::into),
                    corner_weight: corner_weight.map(Into::into),
                    value: value.into(),
                    root_weight: root_weight.into(),
                }
            })
            .collect();
        Self {
            groups,
            albedo_of: albedo_of.into(),
            offsets: offsets.into(),
            texel: texel.into(),
            weight: weight.into(),
        }
    }
}

/// Where the rays of all patches look masks up: four texels each, and their weights.
fn lookups(
    grid: LatLong,
    offsets: &[u32],
    texel: &[u32],
    observations: &Observations,
    shell: Shell,
) -> ([Vec<u32>; 4], [Vec<f32>; 4]) {
    let directions: Vec<Vec3> = (0..grid.len())
        .map(|d| grid.texel_direction(d / grid.columns, d % grid.columns))
        .collect();
    let mut corner: [Vec<u32>; 4] = std::array::from_fn(|_| Vec::with_capacity(texel.len()));
    let mut weight: [Vec<f32>; 4] = std::array::from_fn(|_| Vec::with_capacity(texel.len()));
    for (ends, patch) in offsets.windows(2).zip(&observations.patches) {
        for &d in &texel[ends[0] as usize..ends[1] as usize] {
            let lookup = shell.lookup(mask_grid(grid), patch.position, directions[d as usize]);
            for k in 0..4 {
                corner[k].push(lookup.index[k]);
                weight[k].push(lookup.weight[k]);
            }
        }
    }
    (corner, weight)
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
    /// What the model says about every view, linear RGB.
    ///
    /// # Errors
    /// As [`Shared::masks`].
    pub fn predicted(&self, observations: &Observations) -> Result<Vec<[f32; 3]>, RunError> {
        let shared = self.shared;
        let mut predicted = Vec::with_capacity(shared.shells.groups.len());
        for g in 0..shared.shells.groups.len() {
            predicted.push(self.ws.output(&named("predicted", g))?);
        }
        let of_view = |view: &View| {
            let [group, k] = shared.shells.place[view.frame as usize];
            let count = shared.shells.groups[group].frames.len();
            let row = |c: usize| c * shared.patches + view.patch as usize;
            std::array::from_fn(|c| predicted[group][row(c) * count + k])
        };
        Ok(observations.views.iter().map(of_view).collect())
    }

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
        &self.shared.fixed.albedo_of
    }

    fn jvp(&mut self, v: &[f32]) -> Vec<f32> {
        let [environment, occluders] = self.shared.ranges();
        let mask = self
            .sky
            .as_mut()
            .map(|sky| self.shared.sky.push(sky, &v[occluders]));
        let masks: Vec<(String, Vec<f32>)> = (0..self.shared.shells.groups.len())
            .filter_map(|g| Some((named("mask", g), self.shared.columns(mask.as_ref()?, g))))
            .collect();
        let mut direction = vec![("environment", &v[environment])];
        direction.extend(
            masks
                .iter()
                .map(|(name, mask)| (name.as_str(), mask.as_slice())),
        );
        self.shared
            .program
            .jvp(&mut self.ws, &direction)
            .expect("a direction of the model's own size");
        self.shared
            .joined(|name| self.ws.tangent(name))
            .expect("outputs of the model")
    }

    fn vjp(&mut self, w: &[f32]) -> Vec<f32> {
        let groups = &self.shared.shells.groups;
        let mut rest = w;
        let seeds: Vec<(String, &[f32])> = groups
            .iter()
            .enumerate()
            .map(|(g, group)| {
                let (own, others) = rest.split_at(3 * self.shared.patches * group.frames.len());
                rest = others;
                (named("residual", g), own)
            })
            .collect();
        let seeds: Vec<(&str, &[f32])> = seeds.iter().map(|(n, w)| (n.as_str(), *w)).collect();
        self.shared
            .program
            .vjp_with(&mut self.ws, &seeds)
            .expect("a cotangent of the model's own size");
        let mut z = self
            .ws
            .gradient("environment")
            .expect("a parameter of the model")
            .to_vec();
        if let Some(sky) = &mut self.sky {
            let frames = self.shared.shells.frames();
            let mut masks = vec![0.0; self.shared.mask_grid().len() * frames];
            for (g, group) in groups.iter().enumerate() {
                let name = named("mask", g);
                let own = self.ws.gradient(&name).expect("a parameter of the model");
                for (to, from) in masks
                    .chunks_exact_mut(frames)
                    .zip(own.chunks_exact(group.frames.len()))
                {
                    group.frames.iter().zip(from).for_each(|(&t, &m)| to[t] = m);
                }
            }
            z.extend(self.shared.sky.pull(sky, &masks));
        }
        z
    }
}

fn record(pyramid: &Pyramid, groups: usize) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (level, texel, patch) = (g.domain("level"), g.domain("texel"), g.domain("patch"));
    let mask_texel = g.domain("mask texel");
    let direction = g.segments("direction", &patch);

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
    let albedo = g.param("albedo", &patch, 3);
    let mut outputs = vec![("radiance".to_owned(), radiance)];
    for group in 0..groups {
        let frame = g.axis(&named("frame", group));
        let corners = CORNERS.map(|k| g.index(&named(k, group), &direction, &mask_texel));
        let weights = WEIGHTS.map(|k| g.input(&named(k, group), &direction, 1));
        let lookups: Vec<_> = corners.iter().zip(&weights).collect();
        let masks = g
            .param_along(&named("mask", group), &mask_texel, 1, &frame)
            .gather_weighted(&lookups);
        let received = arriving.segment_dot(&masks);
        let value = g.input_along(&named("value", group), &patch, 3, &frame);
        let weight = g.input_along(&named("root weight", group), &patch, 3, &frame);
        let predicted = &albedo * received;
        outputs.push((named("residual", group), (&predicted - value) * weight));
        outputs.push((named("predicted", group), predicted));
    }
    let outputs: Vec<(&str, &Var)> = outputs
        .iter()
        .map(|(name, value)| (name.as_str(), value))
        .collect();
    g.compile::<_, Differentiable>(&outputs)
}
