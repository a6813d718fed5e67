//! Image formation on the tape: light, through transport, onto a textured surface, into every view.
//!
//! value = (½ + Φ w + ε) · D L + S L with L the exponential of what is fitted of the [light](super::light), everything along an inner axis that holds the colour channels
//! and, for products with many directions at once, several of them side by side. Every parameter is in units of its
//! prior's standard deviation except ε, the albedo's deviation of each site from the smooth texture Φ w.

use std::sync::Arc;

use autodiff::{Differentiable, Graph, GraphError, LinearMap, Program, RunError, Sizes, Workspace};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    light::LightModel,
    observe::Observations,
    split::farthest,
    transport::{Number, Transport},
};

/// Bumps of the smooth texture.
const BUMPS: usize = 220;
/// Standard deviation of a bump's weight.
const BUMP_DEVIATION: f32 = 0.25;

/// The unchanging part of the model of a capture.
pub struct Formation {
    /// What is fitted of the light.
    pub light: Arc<LightModel>,
    /// The smooth part of the albedo.
    pub texture: Arc<Bumps>,
    program: Program,
    half: Arc<[u32]>,
    other_half: Arc<[u32]>,
    site: Arc<[u32]>,
    transport: Arc<Transport>,
}

/// Parameters of the formation.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// Of light, `[value][colour]`.
    pub light: Vec<f32>,
    /// Of the texture, `[bump][colour]`.
    pub texture: Vec<f32>,
    /// Albedo of each site beyond the texture, `[site][colour]`.
    pub deviation: Vec<f32>,
}

impl Formation {
    /// For these views under this transport.
    ///
    /// # Errors
    /// When the tape does not compile, which would be a bug.
    pub fn new(
        light: Arc<LightModel>,
        transport: Arc<Transport>,
        seen: &Observations,
        texture: Arc<Bumps>,
    ) -> Result<Self, GraphError> {
        let program = record(&light, &transport, &texture)?;
        let views = seen.views.len() as u32;
        Ok(Self {
            light,
            texture,
            program,
            half: (0..views).map(|v| 2 * v).collect(),
            other_half: (0..views).map(|v| 2 * v + 1).collect(),
            site: seen.views.iter().map(|v| v.site).collect(),
            transport,
        })
    }

    /// The transport it was made with.
    pub fn transport(&self) -> &Arc<Transport> {
        &self.transport
    }

    /// All parameters at zero.
    pub fn zero(&self) -> Parameters {
        Parameters {
            light: vec![0.0; 3 * self.light.len()],
            texture: vec![0.0; 3 * self.texture.bumps],
            deviation: vec![0.0; 3 * self.texture.sites],
        }
    }

    /// A workspace for `probes` directions side by side, at these parameters.
    ///
    /// # Errors
    /// When the tape refuses what it is given, which would be a bug.
    pub fn workspace(&self, at: &Parameters, probes: usize) -> Result<Workspace<f32>, RunError> {
        let sizes = Sizes::new()
            .lanes("level", self.light.len())
            .lanes("texel", self.light.sources())
            .lanes("half", 2 * self.site.len())
            .lanes("view", self.site.len())
            .lanes("site", self.texture.sites)
            .lanes("bump", self.texture.bumps)
            .axis("colour", 3 * probes);
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        ws.set("light", &tiled(&at.light, probes))?;
        ws.set("texture", &tiled(&at.texture, probes))?;
        ws.set("deviation", &tiled(&at.deviation, probes))?;
        ws.set("light deviation", &self.light.deviation)?;
        ws.set("base", &tiled(&self.light.base, probes))?;
        ws.bind_index("diffuse half", self.half.clone())?;
        ws.bind_index("specular half", self.other_half.clone())?;
        ws.bind_index("own site", self.site.clone())?;
        Ok(ws)
    }

    /// Values of all views; afterwards outputs `value`, `diffuse`, `specular` and `radiance` can be read.
    ///
    /// # Errors
    /// As [`workspace`](Self::workspace).
    pub fn forward(&self, ws: &mut Workspace<f32>) -> Result<(), RunError> {
        self.program.forward(ws)
    }

    /// Change of the values along a direction of light and texture.
    ///
    /// # Errors
    /// As [`workspace`](Self::workspace).
    pub fn push(
        &self,
        ws: &mut Workspace<f32>,
        light: &[f32],
        texture: &[f32],
    ) -> Result<Vec<f32>, RunError> {
        self.program
            .jvp(ws, &[("light", light), ("texture", texture)])?;
        Ok(ws.tangent("value")?.to_vec())
    }

    /// The gradients by light and texture of the inner product of the values with `weights`.
    ///
    /// # Errors
    /// As [`workspace`](Self::workspace).
    pub fn pull(
        &self,
        ws: &mut Workspace<f32>,
        weights: &[f32],
    ) -> Result<(Vec<f32>, Vec<f32>), RunError> {
        self.program.vjp_with(ws, &[("value", weights)])?;
        Ok((
            ws.gradient("light")?.to_vec(),
            ws.gradient("texture")?.to_vec(),
        ))
    }
}

/// Each lane's three colours `probes` times over.
fn tiled(values: &[f32], probes: usize) -> Vec<f32> {
    values
        .chunks_exact(3)
        .flat_map(|rgb| (0..3 * probes).map(move |k| rgb[k % 3]))
        .collect()
}

fn record(
    light: &LightModel,
    transport: &Arc<Transport>,
    texture: &Arc<Bumps>,
) -> Result<Program, GraphError> {
    let g = Graph::new();
    let colour = g.axis("colour");
    let (level, texel, half) = (g.domain("level"), g.domain("texel"), g.domain("half"));
    let (view, site, bump) = (g.domain("view"), g.domain("site"), g.domain("bump"));

    let coefficients =
        g.param_along("light", &level, 1, &colour) * g.input("light deviation", &level, 1);
    let log = coefficients.linear_map(&texel, light.map.clone())
        + g.input_along("base", &texel, 1, &colour);
    let radiance = log.clamp(-20.0, 14.0).exp();
    let reflected = radiance.linear_map(&half, transport.clone());
    let diffuse = reflected.gather(&g.index("diffuse half", &view, &half));
    let specular = reflected.gather(&g.index("specular half", &view, &half));

    let smooth = g
        .param_along("texture", &bump, 1, &colour)
        .linear_map(&site, texture.clone());
    let albedo = smooth.affine(1.0, 0.5) + g.param_along("deviation", &site, 1, &colour);
    let value = albedo.gather(&g.index("own site", &view, &site)) * &diffuse + &specular;
    g.compile::<_, Differentiable>(&[
        ("value", &value),
        ("diffuse", &diffuse),
        ("specular", &specular),
        ("radiance", &radiance),
        ("albedo", &albedo),
    ])
}

/// Smooth functions on the surface: Gaussian bumps around points that are far from each other.
pub struct Bumps {
    /// How many functions.
    pub bumps: usize,
    /// How many sites.
    pub sites: usize,
    /// `[site][bump]`.
    values: Vec<f32>,
}

impl Bumps {
    /// The texture's own functions at these places.
    pub fn texture(positions: &[Vec3]) -> Self {
        Self::new(positions, BUMPS, BUMP_DEVIATION)
    }

    /// `count` bumps whose width is their distance, times `scale`.
    pub fn new(positions: &[Vec3], count: usize, scale: f32) -> Self {
        let seeds = farthest(positions, count);
        let mut gaps: Vec<f64> = seeds
            .iter()
            .map(|&a| {
                let others = seeds.iter().filter(|&&b| b != a);
                others
                    .map(|&b| f64::from(positions[a].distance(positions[b])))
                    .fold(f64::INFINITY, f64::min)
            })
            .collect();
        let width = 1.2 * super::statistics::median(&mut gaps).max(1e-9) as f32;
        let values = positions
            .iter()
            .flat_map(|p| {
                let near = seeds.iter().map(move |&s| {
                    let d = p.distance_squared(positions[s]) / (width * width);
                    scale * (-0.5 * d).exp()
                });
                near.collect::<Vec<_>>()
            })
            .collect();
        Self {
            bumps: seeds.len(),
            sites: positions.len(),
            values,
        }
    }

    /// The values of all bumps at a site.
    pub fn at(&self, site: usize) -> &[f32] {
        &self.values[site * self.bumps..(site + 1) * self.bumps]
    }

    fn forward<T: Number>(&self, columns: usize, input: &[T], output: &mut [T]) {
        for (site, out) in output.chunks_exact_mut(columns).enumerate() {
            out.fill(T::default());
            for (&b, source) in self.at(site).iter().zip(input.chunks_exact(columns)) {
                out.iter_mut()
                    .zip(source)
                    .for_each(|(o, &x)| *o += T::from(b) * x);
            }
        }
    }

    fn transpose<T: Number>(&self, columns: usize, input: &[T], output: &mut [T]) {
        output.fill(T::default());
        for (site, source) in input.chunks_exact(columns).enumerate() {
            for (&b, out) in self.at(site).iter().zip(output.chunks_exact_mut(columns)) {
                out.iter_mut()
                    .zip(source)
                    .for_each(|(o, &x)| *o += T::from(b) * x);
            }
        }
    }
}

impl LinearMap for Bumps {
    fn shape(&self) -> (usize, usize) {
        (self.bumps, self.sites)
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.forward(columns, input, output);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.transpose(columns, input, output);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.forward(columns, input, output);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.transpose(columns, input, output);
    }
}

/// Smallest squared projections that count as part of a subspace.
const INDEPENDENT: f32 = 1e-4;

/// Orthonormal rows that span those of `rows` (each of `length` numbers), by Gram-Schmidt, twice for accuracy.
pub fn orthonormal(rows: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
    let mut basis: Vec<Vec<f32>> = Vec::new();
    for mut row in rows {
        let before = dot(&row, &row).sqrt();
        for _ in 0..2 {
            let parts: Vec<f32> = basis.par_iter().map(|b| dot(b, &row)).collect();
            for (b, part) in basis.iter().zip(&parts) {
                row.iter_mut().zip(b).for_each(|(r, b)| *r -= part * b);
            }
        }
        let norm = dot(&row, &row).sqrt();
        if norm > INDEPENDENT * before && norm > 0.0 {
            row.iter_mut().for_each(|r| *r /= norm);
            basis.push(row);
        }
    }
    basis
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 8];
    let (a8, a1) = a.as_chunks::<8>();
    let (b8, b1) = b.as_chunks::<8>();
    for (x, y) in a8.iter().zip(b8) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    lanes.iter().sum::<f32>() + a1.iter().zip(b1).map(|(x, y)| x * y).sum::<f32>()
}
