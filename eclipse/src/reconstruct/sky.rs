//! The masks of all frames as functions of their parameters, on the tape: `[texel][frame]`, 1 where light passes.

use std::sync::Arc;

use autodiff::{
    Array, Differentiable, Graph, GraphError, Program, RunError, Sizes, Var, Workspace,
};
use render::{
    harmonics::Harmonics,
    lat_long::LatLong,
    maps::{HarmonicMap, PyramidMap},
    pyramid::Pyramid,
};

use super::{
    cutout::{self, Cutout, FRAME_PARAMETERS, FRAME_SD, Stand, TEXTURE},
    model::MASK_SIDE,
    pyramid::level_deviations,
    tent::soften,
};

/// Standard deviations of the silhouette's logit by level, finest first.
const TEXTURE_DEVIATIONS: [f32; 5] = [1.5, 2.0, 3.0, 3.0, 3.0];
/// Logit of transmittance where nothing is known: light passes, and the gradient of the sigmoid is not lost.
const PASSING: f32 = 5.0;

/// What occluders are made of.
pub enum SkyModel {
    /// None: light always passes.
    Clear,
    /// One silhouette for all frames, standing behind the cameras.
    Cutout(Box<CutoutModel>),
    /// Spherical harmonics of each frame's logit (Eq. 6).
    Harmonics(Box<HarmonicModel>),
}

/// The tape of the cutout.
pub struct CutoutModel {
    /// Where each frame's cutout stands.
    pub stands: Vec<Stand>,
    /// The silhouette at z = 0, logits of opacity.
    pub start: Vec<f32>,
    pyramid: Pyramid,
    deviation: Vec<f32>,
    program: Program,
}

/// The tape of the harmonics.
pub struct HarmonicModel {
    frames: usize,
    coefficients: usize,
    harmonics: Harmonics<f32>,
    deviation: Vec<f32>,
    program: Program,
}

/// Masks at a point, and the tape to move them.
pub struct SkyAt {
    /// Transmittance, `[texel][frame]`.
    pub masks: Vec<f32>,
    /// The same as the light of each texel meets it, through its tent.
    pub passed: Vec<f32>,
    grid: LatLong,
    /// For the cutout, which entries the tape's lanes are.
    entry: Option<Vec<u32>>,
    ws: Workspace<f32>,
}

impl SkyModel {
    /// A silhouette behind these cameras.
    ///
    /// # Errors
    /// When the tape does not compile, which would be a bug.
    pub fn cutout(stands: Vec<Stand>) -> Result<Self, GraphError> {
        let pyramid = Pyramid::new(TEXTURE, TEXTURE_DEVIATIONS.len());
        let deviation = level_deviations(&pyramid, &TEXTURE_DEVIATIONS);
        let program = record_cutout(&pyramid)?;
        let start = cutout::someone();
        Ok(Self::Cutout(Box::new(CutoutModel {
            stands,
            start,
            pyramid,
            deviation,
            program,
        })))
    }

    /// Harmonics up to `degree` for each of `frames`, their deviations falling as 1/(1 + (l/4)²).
    ///
    /// # Errors
    /// As [`cutout`](Self::cutout).
    pub fn harmonics(degree: usize, grid: LatLong, frames: usize) -> Result<Self, GraphError> {
        let harmonics = Harmonics::new(degree, grid);
        let coefficients = harmonics.coefficients();
        let deviation = (0..=degree)
            .flat_map(|l| std::iter::repeat_n(5.0 / (1.0 + (l as f32 / 4.0).powi(2)), 2 * l + 1))
            .collect();
        let program = record_harmonics(degree, grid)?;
        Ok(Self::Harmonics(Box::new(HarmonicModel {
            frames,
            coefficients,
            harmonics,
            deviation,
            program,
        })))
    }

    /// Holds the finest `levels` of the silhouette still: first where somebody stands and how large, then the outline.
    pub fn withhold(&mut self, levels: usize) {
        if let Self::Cutout(model) = self {
            let mut deviations = TEXTURE_DEVIATIONS;
            deviations[..levels.min(TEXTURE_DEVIATIONS.len())].fill(0.0);
            model.deviation = level_deviations(&model.pyramid, &deviations);
        }
    }

    /// The number of parameters.
    pub fn parameters(&self) -> usize {
        match self {
            Self::Clear => 0,
            Self::Cutout(m) => m.pyramid.len() + FRAME_PARAMETERS * m.stands.len(),
            Self::Harmonics(m) => m.coefficients * m.frames,
        }
    }

    /// Masks at `z` on `grid`, `MASK_SIDE` times as fine as that of light; `None` when light always passes.
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug.
    pub fn at(&self, grid: LatLong, z: &[f32]) -> Result<Option<SkyAt>, RunError> {
        match self {
            Self::Clear => Ok(None),
            Self::Cutout(model) => model.at(grid, z).map(Some),
            Self::Harmonics(model) => model.at(grid, z).map(Some),
        }
    }

    /// The change along `v` of what passes.
    pub(super) fn push(&self, at: &mut SkyAt, v: &[f32]) -> Vec<f32> {
        let mut change = self.change(at, v);
        through_tents(at.grid, &mut change);
        change
    }

    /// The change along `v` of the masks themselves.
    pub(super) fn change(&self, at: &mut SkyAt, v: &[f32]) -> Vec<f32> {
        let bug = "a direction of the model's own size";
        match self {
            Self::Clear => Vec::new(),
            Self::Cutout(model) => {
                let (silhouette, frames) = v.split_at(model.pyramid.len());
                model
                    .program
                    .jvp(
                        &mut at.ws,
                        &[("silhouette", silhouette), ("frames", frames)],
                    )
                    .expect(bug);
                let mut change = vec![0.0; at.masks.len()];
                let opacity = at.ws.tangent("opacity").expect("an output of the model");
                for (&entry, o) in at.entry.iter().flatten().zip(opacity) {
                    change[entry as usize] = -o;
                }
                change
            }
            Self::Harmonics(model) => {
                model
                    .program
                    .jvp(&mut at.ws, &[("harmonics", v)])
                    .expect(bug);
                at.ws
                    .tangent("mask")
                    .expect("an output of the model")
                    .to_vec()
            }
        }
    }

    /// The gradient of what has the gradient `passed` with respect to what passes.
    pub(super) fn pull(&self, at: &mut SkyAt, mut passed: Vec<f32>) -> Vec<f32> {
        through_tents(at.grid, &mut passed);
        let masks = passed;
        let bug = "a cotangent of the model's own size";
        match self {
            Self::Clear => Vec::new(),
            Self::Cutout(model) => {
                let opacity: Vec<f32> = at
                    .entry
                    .iter()
                    .flatten()
                    .map(|&e| -masks[e as usize])
                    .collect();
                model
                    .program
                    .vjp_with(&mut at.ws, &[("opacity", &opacity)])
                    .expect(bug);
                ["silhouette", "frames"]
                    .iter()
                    .flat_map(|name| at.ws.gradient(name).expect("a parameter").to_vec())
                    .collect()
            }
            Self::Harmonics(model) => {
                model
                    .program
                    .vjp_with(&mut at.ws, &[("mask", &masks)])
                    .expect(bug);
                at.ws.gradient("harmonics").expect("a parameter").to_vec()
            }
        }
    }

    /// The largest change of a logit along `v`.
    pub fn largest_change(&self, v: &[f32]) -> f32 {
        let logits = match self {
            Self::Clear => return 0.0,
            Self::Cutout(model) => model.logits(&v[..model.pyramid.len()]),
            Self::Harmonics(model) => model.logits(v),
        };
        logits.iter().fold(0.0, |m, x| m.max(x.abs()))
    }
}

impl SkyAt {
    fn new(grid: LatLong, masks: Vec<f32>, entry: Option<Vec<u32>>, ws: Workspace<f32>) -> Self {
        let mut passed = masks.clone();
        through_tents(grid, &mut passed);
        Self {
            masks,
            passed,
            grid,
            entry,
            ws,
        }
    }
}

/// The operator from transmittance to what passes, which is its own transpose.
fn through_tents(grid: LatLong, values: &mut [f32]) {
    soften(
        grid,
        grid.rows / MASK_SIDE,
        values.len() / grid.len(),
        values,
    );
}

impl CutoutModel {
    fn logits(&self, z: &[f32]) -> Vec<f32> {
        let scaled: Vec<f32> = z
            .iter()
            .zip(&self.deviation)
            .map(|(z, sd)| z * sd)
            .collect();
        let mut logits = vec![0.0; TEXTURE.len()];
        self.pyramid.apply(&scaled, &mut logits, 1);
        logits
    }

    /// The silhouette that `z` describes.
    pub fn silhouette(&self, z: &[f32]) -> Cutout {
        let (silhouette, frames) = z.split_at(self.pyramid.len());
        let mut texture = self.logits(silhouette);
        texture
            .iter_mut()
            .zip(&self.start)
            .for_each(|(l, s)| *l += s);
        let count = self.stands.len();
        let frames = (0..count)
            .map(|t| std::array::from_fn(|k| frames[k * count + t]))
            .collect();
        Cutout {
            texture,
            frames,
            stands: self.stands.clone(),
        }
    }

    fn at(&self, grid: LatLong, z: &[f32]) -> Result<SkyAt, RunError> {
        let sky = self.silhouette(z).sky(grid);
        let (silhouette, frames) = z.split_at(self.pyramid.len());
        let sizes = Sizes::new()
            .lanes("level", self.pyramid.len())
            .lanes("texture", TEXTURE.len())
            .lanes("frame", self.stands.len())
            .lanes("sky", sky.entry.len());
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("silhouette", silhouette)?;
        ws.set("deviation", &self.deviation)?;
        ws.set("start", &self.start)?;
        ws.set("frames", frames)?;
        ws.set_index("sky frame", &sky.frame)?;
        for (i, axis) in ["u", "v"].iter().enumerate() {
            ws.set(&format!("{axis} met"), &sky.met[i])?;
            ws.set(&format!("{axis} cell"), &sky.cell[i])?;
        }
        for (k, corner) in sky.corners.iter().enumerate() {
            ws.set_index(&format!("corner {k}"), corner)?;
        }
        self.program.forward(&mut ws)?;
        let mut masks = vec![1.0; grid.len() * self.stands.len()];
        for (&entry, opacity) in sky.entry.iter().zip(ws.output("opacity")?) {
            masks[entry as usize] = 1.0 - opacity;
        }
        Ok(SkyAt::new(grid, masks, Some(sky.entry), ws))
    }
}

impl HarmonicModel {
    /// The logits that `z` adds, `[texel][frame]`.
    fn logits(&self, z: &[f32]) -> Vec<f32> {
        let scaled: Vec<f32> = z
            .chunks_exact(self.frames)
            .zip(&self.deviation)
            .flat_map(|(z, sd)| z.iter().map(move |z| z * sd))
            .collect();
        let mut logits = vec![0.0; self.harmonics.grid().len() * self.frames];
        self.harmonics.synthesize(&scaled, &mut logits, self.frames);
        logits
    }

    fn at(&self, grid: LatLong, z: &[f32]) -> Result<SkyAt, RunError> {
        let sizes = Sizes::new()
            .lanes("coefficient", self.coefficients)
            .lanes("texel", grid.len())
            .axis("frame", self.frames);
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("harmonics", z)?;
        ws.set("deviation", &self.deviation)?;
        self.program.forward(&mut ws)?;
        let masks = ws.output("mask")?.to_vec();
        Ok(SkyAt::new(grid, masks, None, ws))
    }
}

fn record_harmonics(degree: usize, grid: LatLong) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (coefficient, texel, frame) = (g.domain("coefficient"), g.domain("texel"), g.axis("frame"));
    let scaled =
        g.param_along("harmonics", &coefficient, 1, &frame) * g.input("deviation", &coefficient, 1);
    let logit = scaled.linear_map(&texel, Arc::new(HarmonicMap::new(degree, grid, 1)));
    let mask = logit.affine(1.0, f64::from(PASSING)).sigmoid();
    g.compile::<_, Differentiable>(&[("mask", &mask)])
}

fn record_cutout(pyramid: &Pyramid) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (level, texture) = (g.domain("level"), g.domain("texture"));
    let (frame, sky) = (g.domain("frame"), g.domain("sky"));
    let logits = (g.param("silhouette", &level, 1) * g.input("deviation", &level, 1))
        .linear_map(&texture, Arc::new(PyramidMap(pyramid.clone())))
        + g.input("start", &texture, 1);
    let z = g.param("frames", &frame, FRAME_PARAMETERS);
    let part = |k: usize| z.channel(k) * f64::from(FRAME_SD[k]);
    let inverse_scale = (part(2) * -1.0).exp();
    let inverse_width = &inverse_scale * (part(3) * -1.0).exp();
    let stand = Array::stack(&[&part(0), &part(1), &inverse_width, &inverse_scale])
        .gather(&g.index("sky frame", &sky, &frame));
    let place = |axis: &str, shift: usize, scale: usize, to_texture: [f32; 2]| -> Var {
        let moved = (g.input(&format!("{axis} met"), &sky, 1) - stand.channel(shift))
            * stand.channel(scale);
        let [origin, unit] = to_texture.map(f64::from);
        moved.affine(unit - origin, origin) - g.input(&format!("{axis} cell"), &sky, 1)
    };
    let x = place("u", 0, 2, [cutout::texture_x(0.0), cutout::texture_x(1.0)]);
    let y = place("v", 1, 3, [cutout::texture_y(0.0), cutout::texture_y(1.0)]);
    let (rest_x, rest_y) = (x.affine(-1.0, 1.0), y.affine(-1.0, 1.0));
    let weights = [&rest_x * &rest_y, &x * &rest_y, &rest_x * &y, &x * &y];
    let corners: Vec<_> = (0..4)
        .map(|k| g.index(&format!("corner {k}"), &sky, &texture))
        .collect();
    let lookups: Vec<_> = corners.iter().zip(&weights).collect();
    let opacity = logits.gather_weighted(&lookups).sigmoid();
    g.compile::<_, Differentiable>(&[("opacity", &opacity)])
}
