//! The image formation of patches on the tape: light, the operator's cutout, diffuse albedo.
//!
//! Every parameter is in units of its prior's standard deviation, so that the prior is ½‖z‖². The light that a patch
//! receives is a sum over the texels it sees, once for all frames; what the cutout takes away is a sum over the few rays
//! that pass near it, for every view.

use std::sync::Arc;

use autodiff::{Array, Differentiable, Graph, Program, RunError, Sizes, Var, Workspace};
use glam::Vec3;
use render::{lat_long::LatLong, pyramid::Pyramid};

use super::{
    cutout::{self, Cutout, FRAME_PARAMETERS, FRAME_SD, ShadowRays, Stand, TEXTURE},
    least_squares::{self, Linearisation},
    maps::{PyramidMap, level_deviations},
    patches::Observations,
};

/// Standard deviations of the logarithm of radiance added by each level, finest (50 × 100) first.
pub const ENVIRONMENT_DEVIATIONS: [f32; 6] = [0.12, 0.25, 0.5, 0.8, 1.0, 1.0];
/// Colour varies less than brightness: standard deviation of each chroma component relative to luminance.
const CHROMA: f64 = 0.68;
/// Standard deviations of the silhouette's logit by level, finest first.
const TEXTURE_DEVIATIONS: [f32; 5] = [1.5, 2.0, 3.0, 3.0, 3.0];

/// Everything about a capture that the tape reads and that does not change during the solve.
pub struct Shared {
    /// Grid of light and transport.
    pub grid: LatLong,
    /// `[patch][texel]`.
    pub rows: Vec<f32>,
    /// Patch positions.
    pub positions: Vec<Vec3>,
    /// (patch, frame) of each view.
    pub views: Vec<(u32, u32)>,
    /// Where each frame's cutout stands; empty when occluders are not modelled.
    pub stands: Vec<Stand>,
    /// The silhouette at z = 0, logits of opacity.
    pub start: Vec<f32>,
    /// Logarithm of the radiance at z = 0.
    pub log_radiance: f32,
    /// Precision of the prior of the albedo about one half.
    pub albedo_precision: f32,
    /// Worker threads.
    pub threads: usize,
    pub(crate) program: Program,
    fixed: Fixed,
}

struct Fixed {
    direction_offsets: Arc<[u32]>,
    direction_texel: Arc<[u32]>,
    direction_weight: Arc<[f32]>,
    view_offsets: Arc<[u32]>,
    view_frame: Arc<[u32]>,
    value: Arc<[f32]>,
    root_weight: Arc<[f32]>,
    groups: Arc<[u32]>,
    environment_deviation: Vec<f32>,
    texture_deviation: Vec<f32>,
    pyramids: [Arc<Pyramid>; 2],
}

impl Shared {
    /// Prepares the tape for these observations.
    ///
    /// # Panics
    /// Never: the program is the same for every capture, and a test compiles it.
    pub fn new(
        grid: LatLong,
        rows: Vec<f32>,
        observations: &Observations,
        stands: Vec<Stand>,
        albedo_precision: f32,
        threads: usize,
    ) -> Self {
        let levels = (0..)
            .take_while(|k| grid.rows >> k > 0 && (grid.rows - 1) >> k > 0)
            .count();
        let environment = Arc::new(Pyramid::new(grid, levels));
        let texture = Arc::new(Pyramid::new(TEXTURE, TEXTURE_DEVIATIONS.len()));
        let finest_first = &ENVIRONMENT_DEVIATIONS[usize::from(grid.rows <= 25)..];
        let patches = &observations.patches;
        let views = &observations.views;
        let mut direction_offsets = vec![0u32];
        let (mut direction_texel, mut direction_weight) = (Vec::new(), Vec::new());
        for row in rows.chunks_exact(grid.len()) {
            for (texel, &weight) in row.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                direction_texel.push(texel as u32);
                direction_weight.push(weight);
            }
            direction_offsets.push(direction_texel.len() as u32);
        }
        let by_channel = |part: &dyn Fn(&super::patches::View, usize) -> f32| -> Arc<[f32]> {
            (0..3)
                .flat_map(|c| views.iter().map(move |v| part(v, c)))
                .collect()
        };
        let groups = (0..3)
            .flat_map(|c| {
                views
                    .iter()
                    .map(move |v| (c * patches.len()) as u32 + v.patch)
            })
            .collect();
        let fixed = Fixed {
            direction_offsets: direction_offsets.into(),
            direction_texel: direction_texel.into(),
            direction_weight: direction_weight.into(),
            view_offsets: observations.offsets().into(),
            view_frame: views.iter().map(|v| v.frame).collect(),
            value: by_channel(&|v, c| v.value[c]),
            root_weight: by_channel(&|v, c| v.weight[c].sqrt()),
            groups,
            environment_deviation: level_deviations(&environment, finest_first),
            texture_deviation: level_deviations(&texture, &TEXTURE_DEVIATIONS),
            pyramids: [environment, texture],
        };
        let mean: f64 = fixed.value.iter().map(|&v| f64::from(v)).sum::<f64>()
            / fixed.value.len().max(1) as f64;
        let received: f64 =
            rows.iter().map(|&w| f64::from(w)).sum::<f64>() / patches.len().max(1) as f64;
        let program = record(&fixed).expect("the patch model compiles");
        Self {
            grid,
            positions: patches.iter().map(|p| p.position).collect(),
            views: views.iter().map(|v| (v.patch, v.frame)).collect(),
            start: cutout::person(2.8, 0.35),
            // Albedo one half explains the mean of the photographs.
            log_radiance: (mean.max(1e-9) / (0.5 * received.max(1e-9))).ln() as f32,
            rows,
            stands,
            albedo_precision,
            threads,
            program,
            fixed,
        }
    }

    /// How many parameters: environment, then silhouette, then frames.
    pub fn parameters(&self) -> usize {
        self.ranges()[2].end
    }

    /// Where environment, silhouette and frames lie in z.
    pub fn ranges(&self) -> [std::ops::Range<usize>; 3] {
        let environment = 3 * self.fixed.pyramids[0].len();
        let (texture, frames) = if self.stands.is_empty() {
            (0, 0)
        } else {
            (
                self.fixed.pyramids[1].len(),
                FRAME_PARAMETERS * self.stands.len(),
            )
        };
        [
            0..environment,
            environment..environment + texture,
            environment + texture..environment + texture + frames,
        ]
    }

    /// The largest change of a texel's log luminance or of a silhouette's logit over a step.
    pub fn largest_change(&self, delta: &[f32]) -> f32 {
        let [environment, texture, _] = self.ranges();
        let fixed = &self.fixed;
        let largest = |z: &[f32], deviation: &[f32], pyramid: &Pyramid| {
            let scaled: Vec<f32> = z.iter().zip(deviation).map(|(z, sd)| z * sd).collect();
            let mut values = vec![0.0; pyramid.finest().len()];
            pyramid.apply(&scaled, &mut values, 1);
            values.iter().fold(1e-9f32, |m, v| m.max(v.abs()))
        };
        let luminance = environment.start..environment.start + fixed.pyramids[0].len();
        let light = largest(
            &delta[luminance],
            &fixed.environment_deviation,
            &fixed.pyramids[0],
        );
        if texture.is_empty() {
            return light;
        }
        light.max(
            0.75 * largest(
                &delta[texture],
                &fixed.texture_deviation,
                &fixed.pyramids[1],
            ),
        )
    }

    /// The number of albedo values: `[channel][patch]`.
    pub fn albedos(&self) -> usize {
        3 * self.positions.len()
    }

    /// The cutout that `z` describes; `None` when occluders are not modelled.
    pub fn cutout(&self, z: &[f32]) -> Option<Cutout> {
        if self.stands.is_empty() {
            return None;
        }
        let [_, texture, frames] = self.ranges();
        let scaled: Vec<f32> = z[texture]
            .iter()
            .zip(&self.fixed.texture_deviation)
            .map(|(z, sd)| z * sd)
            .collect();
        let mut logits = vec![0.0; TEXTURE.len()];
        self.fixed.pyramids[1].apply(&scaled, &mut logits, 1);
        logits
            .iter_mut()
            .zip(&self.start)
            .for_each(|(l, s)| *l += s);
        let (z, count) = (&z[frames], self.stands.len());
        let frames = (0..count)
            .map(|t| std::array::from_fn(|k| z[k * count + t]))
            .collect();
        Some(Cutout {
            texture: logits,
            frames,
            stands: self.stands.clone(),
        })
    }

    /// Linearises at `z`, with the albedo at its best: the linearisation and the albedo.
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug of this module.
    pub fn linearise(&self, z: &[f32]) -> Result<(At<'_>, Vec<f32>), RunError> {
        let rays = match self.cutout(z) {
            Some(cutout) => cutout.rays(self.grid, &self.positions, &self.rows, &self.views),
            None => ShadowRays {
                offsets: vec![0; self.views.len() + 1],
                ..ShadowRays::default()
            },
        };
        let mut at = At {
            samples: self.samples(rays.texel.len()),
            ws: self.bind(z, rays)?,
            shared: self,
            residual: vec![],
            by_albedo: vec![],
        };
        let ones = vec![1.0; self.albedos()];
        at.ws.set("albedo", &vec![0.5; self.albedos()])?;
        self.program.jvp(&mut at.ws, &[("albedo", &ones)])?;
        at.by_albedo = at.ws.tangent("residual")?.to_vec();
        let half = at.ws.output("residual")?.to_vec();
        let current = vec![0.5; self.albedos()];
        let albedo = least_squares::best_albedo(
            &half,
            &at.by_albedo,
            &self.fixed.groups,
            &current,
            self.albedo_precision,
        );
        at.ws.set("albedo", &albedo)?;
        self.program.forward(&mut at.ws)?;
        at.residual = at.ws.output("residual")?.to_vec();
        Ok((at, albedo))
    }

    /// Shaded samples of one pass over the data.
    fn samples(&self, rays: usize) -> usize {
        self.fixed.direction_texel.len() + rays
    }

    fn bind(&self, z: &[f32], rays: ShadowRays) -> Result<Workspace<f32>, RunError> {
        let [environment, texture, frames] = self.ranges();
        let frame_count = self.stands.len().max(1);
        let fixed = &self.fixed;
        let sizes = Sizes::new()
            .lanes("level", fixed.pyramids[0].len())
            .lanes("texel", self.grid.len())
            .lanes("texture level", fixed.pyramids[1].len())
            .lanes("texture", TEXTURE.len())
            .lanes("frame", frame_count)
            .lanes("patch", self.positions.len())
            .offsets("direction", fixed.direction_offsets.clone())
            .offsets("view", fixed.view_offsets.clone())
            .offsets("ray", rays.offsets)
            .threads(self.threads);
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("environment", &z[environment])?;
        ws.set("environment deviation", &fixed.environment_deviation)?;
        ws.set("log radiance", &[self.log_radiance])?;
        ws.bind_index("direction texel", fixed.direction_texel.clone())?;
        ws.bind("direction weight", fixed.direction_weight.clone())?;
        let modelled = !self.stands.is_empty();
        let nothing = vec![0.0; fixed.pyramids[1].len().max(FRAME_PARAMETERS)];
        ws.set(
            "silhouette",
            if modelled {
                &z[texture]
            } else {
                &nothing[..fixed.pyramids[1].len()]
            },
        )?;
        ws.set("silhouette deviation", &fixed.texture_deviation)?;
        ws.set("silhouette start", &self.start)?;
        ws.set(
            "frames",
            if modelled {
                &z[frames]
            } else {
                &nothing[..FRAME_PARAMETERS]
            },
        )?;
        let inverse: Vec<f32> = self.stands.iter().map(|s| 1.0 / s.distance).collect();
        ws.set(
            "inverse distance",
            if modelled { &inverse } else { &nothing[..1] },
        )?;
        let view_frame = if modelled {
            fixed.view_frame.clone()
        } else {
            vec![0; self.views.len()].into()
        };
        ws.bind_index("view frame", view_frame)?;
        ws.bind_index("ray texel", rays.texel.into())?;
        ws.bind("ray weight", rays.weight.into())?;
        for (i, axis) in ["u", "v"].iter().enumerate() {
            ws.bind(
                &format!("{axis} from origin"),
                rays.from_origin[i].as_slice().into(),
            )?;
            ws.bind(
                &format!("{axis} parallax"),
                rays.parallax[i].as_slice().into(),
            )?;
            ws.bind(&format!("{axis} cell"), rays.cell[i].as_slice().into())?;
        }
        for (k, corner) in rays.corners.into_iter().enumerate() {
            ws.bind_index(&format!("corner {k}"), corner.into())?;
        }
        ws.bind("value", fixed.value.clone())?;
        ws.bind("root weight", fixed.root_weight.clone())?;
        Ok(ws)
    }

    /// Radiance at `z`, `[texel][channel]`.
    ///
    /// # Errors
    /// As [`linearise`](Self::linearise).
    pub fn radiance(&self, at: &At<'_>) -> Result<Vec<f32>, RunError> {
        let planar = at.ws.output("radiance")?;
        let n = self.grid.len();
        Ok((0..3 * n).map(|i| planar[(i % 3) * n + i / 3]).collect())
    }
}

/// The model linearised at a point.
pub struct At<'a> {
    shared: &'a Shared,
    ws: Workspace<f32>,
    residual: Vec<f32>,
    by_albedo: Vec<f32>,
    /// Shaded samples of one pass over the data.
    pub samples: usize,
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
        let [environment, texture, frames] = self.shared.ranges();
        let mut direction: Vec<(&str, &[f32])> = vec![("environment", &v[environment])];
        if !texture.is_empty() {
            direction.push(("silhouette", &v[texture]));
            direction.push(("frames", &v[frames]));
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
        let mut z = Vec::with_capacity(self.shared.parameters());
        let names: &[&str] = if self.shared.stands.is_empty() {
            &["environment"]
        } else {
            &["environment", "silhouette", "frames"]
        };
        for name in names {
            z.extend_from_slice(self.ws.gradient(name).expect("a parameter of the model"));
        }
        z
    }
}

fn record(fixed: &Fixed) -> Result<Program, autodiff::GraphError> {
    let g = Graph::new();
    let (level, texel) = (g.domain("level"), g.domain("texel"));
    let (texture_level, texture) = (g.domain("texture level"), g.domain("texture"));
    let (frame, patch) = (g.domain("frame"), g.domain("patch"));
    let direction = g.segments("direction", &patch);
    let view = g.segments("view", &patch);
    let ray = g.segments("ray", &view);

    // Light (Eq. 7), luminance and two chroma components decorrelated.
    let coefficients =
        g.param("environment", &level, 3) * g.input("environment deviation", &level, 1);
    let log = coefficients.linear_map(&texel, Arc::new(PyramidMap(fixed.pyramids[0].clone())));
    let [luminance, red_green, blue_yellow] = [
        log.channel(0),
        log.channel(1) * (CHROMA / 2f64.sqrt()),
        log.channel(2) * (CHROMA / 6f64.sqrt()),
    ];
    let shifted = luminance + g.input("log radiance", &g.uniform(), 1);
    let log = Array::stack(&[
        &(&shifted + &red_green + &blue_yellow),
        &(&shifted - &red_green + &blue_yellow),
        &(&shifted - &blue_yellow * 2.0),
    ]);
    let radiance = log.clamp(-20.0, 14.0).exp();
    let received = radiance
        .gather(&g.index("direction texel", &direction, &texel))
        .segment_dot(&g.input("direction weight", &direction, 1));

    // The cutout.
    let logits = (g.param("silhouette", &texture_level, 1)
        * g.input("silhouette deviation", &texture_level, 1))
    .linear_map(&texture, Arc::new(PyramidMap(fixed.pyramids[1].clone())))
        + g.input("silhouette start", &texture, 1);
    let stands = stands(&g, &frame)
        .gather(&g.index("view frame", &view, &frame))
        .expand(&ray);
    let inverse_distance = stands.channel(4);
    let place = |axis: &str, shift: usize, scale: usize, sign: f64, offset: f64| -> Var {
        let met = g.input(&format!("{axis} from origin"), &ray, 1)
            + &inverse_distance * g.input(&format!("{axis} parallax"), &ray, 1);
        let moved = (met - stands.channel(shift)) * stands.channel(scale);
        moved.affine(sign, offset) - g.input(&format!("{axis} cell"), &ray, 1)
    };
    let (per_u, per_v) = (
        f64::from(cutout::texture_x(1.0) - cutout::texture_x(0.0)),
        f64::from(cutout::texture_y(1.0) - cutout::texture_y(0.0)),
    );
    let x = place("u", 0, 2, per_u, f64::from(cutout::texture_x(0.0)));
    let y = place("v", 1, 3, per_v, f64::from(cutout::texture_y(0.0)));
    let (rest_x, rest_y) = (x.affine(-1.0, 1.0), y.affine(-1.0, 1.0));
    let weights = [&rest_x * &rest_y, &x * &rest_y, &rest_x * &y, &x * &y];
    let corners: Vec<_> = (0..4)
        .map(|k| g.index(&format!("corner {k}"), &ray, &texture))
        .collect();
    let lookups: Vec<_> = corners.iter().zip(&weights).collect();
    let opacity = logits.gather_weighted(&lookups).sigmoid();
    let taken = radiance
        .gather(&g.index("ray texel", &ray, &texel))
        .segment_dot(&(opacity * g.input("ray weight", &ray, 1)));

    let arriving = received.expand(&view) - taken;
    let albedo = g.param("albedo", &patch, 3);
    let residual = (albedo.expand(&view) * arriving - g.input("value", &view, 3))
        * g.input("root weight", &view, 3);
    g.compile::<_, Differentiable>(&[("residual", &residual), ("radiance", &radiance)])
}

/// Side shift, upward shift, inverse width, inverse scale, inverse distance of every frame.
fn stands(g: &Graph, frame: &autodiff::Domain) -> Var {
    let z = g.param("frames", frame, FRAME_PARAMETERS);
    let part = |k: usize| z.channel(k) * f64::from(FRAME_SD[k]);
    let inverse_scale = (part(2) * -1.0).exp();
    let inverse_width = &inverse_scale * (part(3) * -1.0).exp();
    let inverse_distance = (part(4) * -1.0).exp() * g.input("inverse distance", frame, 1);
    Array::stack(&[
        &part(0),
        &part(1),
        &inverse_width,
        &inverse_scale,
        &inverse_distance,
    ])
}
