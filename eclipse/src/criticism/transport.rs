//! Light transport from the sources (texels of an environment, or lamps) to every view of the surface: a fixed linear operator
//! the tape applies.
//!
//! A row is one view (a surface site seen in one frame). It has two halves, what an albedo of one reflects and what the
//! specular lobe adds; both are linear in radiance. Geometry never changes, so rows are plain numbers.

use std::{
    f32::consts::FRAC_1_PI,
    ops::{AddAssign, Mul},
};

use autodiff::LinearMap;
use glam::Vec3;
use rayon::prelude::*;
use render::bsdf::{Cosines, microfacet};

use super::{
    glossy::{Arriving, Reflected},
    horizon::Horizon,
    observe::Observations,
};
pub use crate::reconstruct::shading::Lobe;
use crate::reconstruct::shading::just_seen;

/// Chunks that sums over views are cut into, so that they do not depend on the number of threads.
const CHUNKS: usize = 16;

impl Lobe {
    /// The lobe that is expected of a surface nobody has measured; its logarithm of α and its κ scatter about this one.
    pub const USUAL: Self = Self {
        alpha: 0.45,
        kappa: 0.04,
    };
}

/// The operator for all views of the surface.
pub struct Transport {
    texels: usize,
    offsets: Vec<u32>,
    texel: Vec<u16>,
    /// Diffuse and specular weight of every entry.
    weight: Vec<[f32; 2]>,
}

impl Transport {
    /// Rows of every view in `seen`, for surfaces with this lobe or Lambertian ones.
    pub fn new(horizon: &Horizon, seen: &Observations, lobe: Option<Lobe>) -> Self {
        let rows: Vec<(Vec<u16>, Vec<[f32; 2]>)> = seen
            .views
            .par_iter()
            .map_init(<(Arriving, Reflected)>::default, |(light, by), view| {
                light.replace(horizon.row(seen, view));
                light.see(
                    seen.sites[view.site as usize].point.normal,
                    seen.outgoing(view),
                );
                light.reflect(lobe, by);
                let both = by.diffuse.iter().zip(&by.specular);
                let weights = light.weight.iter().zip(both);
                (
                    light.source.iter().map(|&source| source as u16).collect(),
                    weights.map(|(w, (d, s))| [w * d, w * s]).collect(),
                )
            })
            .collect();
        let mut transport = Self {
            texels: horizon.directions.len(),
            offsets: vec![0],
            texel: Vec::new(),
            weight: Vec::new(),
        };
        for (texel, weight) in rows {
            transport.texel.extend(texel);
            transport.weight.extend(weight);
            transport.offsets.push(transport.texel.len() as u32);
        }
        transport
    }

    /// How many views.
    pub fn views(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The entries of a view: texel, diffuse and specular weight.
    pub fn row(&self, view: usize) -> impl Iterator<Item = (usize, [f32; 2])> + '_ {
        let range = self.offsets[view] as usize..self.offsets[view + 1] as usize;
        self.texel[range.clone()]
            .iter()
            .zip(&self.weight[range])
            .map(|(&texel, &weight)| (usize::from(texel), weight))
    }

    /// Lets each entry pass the share that `pass(view, texel)` says: occluders between the light and the surface.
    pub fn masked(&self, pass: impl Fn(usize, usize) -> f32 + Sync) -> Self {
        let mut weight = self.weight.clone();
        let mut rows: Vec<&mut [[f32; 2]]> = Vec::with_capacity(self.views());
        let mut rest = weight.as_mut_slice();
        for v in 0..self.views() {
            let (row, after) = rest.split_at_mut((self.offsets[v + 1] - self.offsets[v]) as usize);
            rows.push(row);
            rest = after;
        }
        rows.par_iter_mut().enumerate().for_each(|(view, row)| {
            let start = self.offsets[view] as usize;
            for (i, entry) in row.iter_mut().enumerate() {
                let share = pass(view, usize::from(self.texel[start + i]));
                *entry = entry.map(|w| share * w);
            }
        });
        Self {
            texels: self.texels,
            offsets: self.offsets.clone(),
            texel: self.texel.clone(),
            weight,
        }
    }

    fn forward<T: Number>(&self, columns: usize, input: &[T], output: &mut [T]) {
        output
            .par_chunks_mut(2 * columns)
            .enumerate()
            .for_each(|(view, out)| {
                if columns == 3 {
                    let mut sums = [T::default(); 6];
                    for (texel, [d, s]) in self.row(view) {
                        let (d, s) = (T::from(d), T::from(s));
                        let source: &[T; 3] = &input.as_chunks().0[texel];
                        for c in 0..3 {
                            sums[c] += d * source[c];
                            sums[3 + c] += s * source[c];
                        }
                    }
                    out.copy_from_slice(&sums);
                    return;
                }
                out.fill(T::default());
                let (diffuse, specular) = out.split_at_mut(columns);
                for (texel, [d, s]) in self.row(view) {
                    let (d, s) = (T::from(d), T::from(s));
                    let source = &input[texel * columns..][..columns];
                    for ((a, b), &x) in diffuse.iter_mut().zip(specular.iter_mut()).zip(source) {
                        *a += d * x;
                        *b += s * x;
                    }
                }
            });
    }

    fn transpose<T: Number>(&self, columns: usize, input: &[T], output: &mut [T]) {
        let size = self.views().div_ceil(CHUNKS).max(1);
        let parts: Vec<Vec<T>> = (0..self.views().div_ceil(size))
            .into_par_iter()
            .map(|chunk| {
                let mut sum = vec![T::default(); self.texels * columns];
                for view in chunk * size..((chunk + 1) * size).min(self.views()) {
                    let (diffuse, specular) =
                        input[2 * view * columns..][..2 * columns].split_at(columns);
                    if columns == 3 {
                        for (texel, [d, s]) in self.row(view) {
                            let (d, s) = (T::from(d), T::from(s));
                            let target: &mut [T; 3] = &mut sum.as_chunks_mut().0[texel];
                            for c in 0..3 {
                                target[c] += d * diffuse[c] + s * specular[c];
                            }
                        }
                        continue;
                    }
                    for (texel, [d, s]) in self.row(view) {
                        let (d, s) = (T::from(d), T::from(s));
                        let target = &mut sum[texel * columns..][..columns];
                        for ((t, &a), &b) in target.iter_mut().zip(diffuse).zip(specular) {
                            *t += d * a + s * b;
                        }
                    }
                }
                sum
            })
            .collect();
        output.fill(T::default());
        for part in parts {
            output.iter_mut().zip(part).for_each(|(o, p)| *o += p);
        }
    }
}

/// What the two precisions of the tape have in common here.
pub(super) trait Number:
    Copy
    + Default
    + From<f32>
    + Mul<Output = Self>
    + std::ops::Add<Output = Self>
    + AddAssign
    + Send
    + Sync
{
}
impl Number for f32 {}
impl Number for f64 {}

impl LinearMap for Transport {
    fn shape(&self) -> (usize, usize) {
        (self.texels, 2 * self.views())
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

/// Reflectance (1/sr) of an albedo of one, and of the lobe; [`Arriving`] is for many directions.
pub fn reflect(lobe: Option<Lobe>, normal: Vec3, incident: Vec3, outgoing: Vec3) -> (f32, f32) {
    let Some(lobe) = lobe else {
        return (FRAC_1_PI, 0.0);
    };
    // A tent of light reaches above the horizon from a centre below it.
    let incident = just_seen(normal, incident);
    match Cosines::new(normal, incident, just_seen(normal, outgoing)) {
        Some(cosines) => {
            let (factor, specular) = microfacet(cosines, lobe.alpha, lobe.kappa);
            (FRAC_1_PI * factor, specular)
        }
        None => (0.0, 0.0),
    }
}
