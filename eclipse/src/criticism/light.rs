//! What is fitted of the light: its logarithm, as a linear function of a few numbers or of thousands.

use std::sync::Arc;

use autodiff::LinearMap;
use render::{lat_long::LatLong, maps::PyramidMap, pyramid::Pyramid};

use super::transport::Number;
use crate::reconstruct::pyramid::level_deviations;

/// Standard deviations of the logarithm of radiance added by each level, finest first, as in the solver.
const LIGHT_DEVIATIONS: [f32; 6] = [0.12, 0.25, 0.5, 0.8, 1.0, 1.0];
/// Standard deviation of the logarithm of known lamps' common scale, by colour: albedo and exposure leave it open.
const SCALE_DEVIATION: f32 = 1.0;

/// What is known of the light beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Nothing: an environment far away is fitted.
    Environment,
    /// One lamp a frame but for a scale that all share.
    Lamps,
}

/// The light's logarithm: `base + map · (deviation · numbers)`, by source and colour.
pub struct LightModel {
    /// From numbers to sources: texels of a grid, or lamps.
    pub map: Arc<dyn LinearMap>,
    /// Prior deviation of each number.
    pub deviation: Vec<f32>,
    /// Logarithm of radiance at zero, `[source][colour]`.
    pub base: Vec<f32>,
}

impl LightModel {
    /// A pyramid on `grid` about the mean of `radiance`, `[texel][colour]`.
    pub fn environment(grid: LatLong, radiance: &[f32]) -> Self {
        let mean = radiance.iter().map(|&l| f64::from(l)).sum::<f64>() / radiance.len() as f64;
        let pyramid = Pyramid::new(grid, LIGHT_DEVIATIONS.len());
        let deviation = level_deviations(&pyramid, &LIGHT_DEVIATIONS);
        Self {
            map: Arc::new(PyramidMap(pyramid)),
            deviation,
            base: vec![mean.max(1e-6).ln() as f32; radiance.len()],
        }
    }

    /// Lamps of this radiance, `[lamp][colour]`, but for one scale that all share.
    pub fn lamps(radiance: &[f32]) -> Self {
        Self {
            map: Arc::new(Scale(radiance.len() / 3)),
            deviation: vec![SCALE_DEVIATION],
            base: radiance.iter().map(|l| l.max(1e-6).ln()).collect(),
        }
    }

    /// How many numbers are fitted, by colour.
    pub fn len(&self) -> usize {
        self.deviation.len()
    }

    /// Whether none is.
    pub fn is_empty(&self) -> bool {
        self.deviation.is_empty()
    }

    /// How many sources there are.
    pub fn sources(&self) -> usize {
        self.base.len() / 3
    }

    /// The change of the logarithm of radiance by numbers in units of their deviations, `[source][colour]`.
    pub fn change(&self, numbers: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; self.base.len()];
        self.map.apply_f32(3, &self.scaled(numbers), &mut out);
        out
    }

    /// Numbers whose radiance comes close to `radiance`, `[source][colour]`, by damped least squares.
    pub fn like(&self, radiance: &[f32]) -> Vec<f32> {
        let target: Vec<f32> = radiance
            .iter()
            .zip(&self.base)
            .map(|(&l, base)| l.max(1e-6).ln() - base)
            .collect();
        let mut z = vec![0.0f32; 3 * self.len()];
        let transpose = |r: &[f32]| {
            let mut out = vec![0.0; 3 * self.len()];
            self.map.apply_transpose_f32(3, r, &mut out);
            self.scaled(&out)
        };
        // A tenth of a unit of the logarithm is close enough.
        const PRECISION: f32 = 100.0;
        let product = |v: &[f32]| -> Vec<f32> {
            let back = transpose(&self.change(v));
            v.iter().zip(back).map(|(v, b)| v + PRECISION * b).collect()
        };
        let right: Vec<f32> = transpose(&target).iter().map(|b| PRECISION * b).collect();
        super::linear::conjugate_gradients(&mut z, &right, 40, 1e-4, product);
        z
    }

    fn scaled(&self, numbers: &[f32]) -> Vec<f32> {
        (0..numbers.len())
            .map(|i| numbers[i] * self.deviation[i / 3])
            .collect()
    }
}

/// One number for so many lamps.
struct Scale(usize);

impl Scale {
    fn forward<T: Number>(columns: usize, input: &[T], output: &mut [T]) {
        for out in output.chunks_exact_mut(columns) {
            out.copy_from_slice(&input[..columns]);
        }
    }

    fn transpose<T: Number>(columns: usize, input: &[T], output: &mut [T]) {
        output.fill(T::default());
        for source in input.chunks_exact(columns) {
            output.iter_mut().zip(source).for_each(|(o, &x)| *o += x);
        }
    }
}

impl LinearMap for Scale {
    fn shape(&self) -> (usize, usize) {
        (1, self.0)
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        Self::forward(columns, input, output);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        Self::transpose(columns, input, output);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        Self::forward(columns, input, output);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        Self::transpose(columns, input, output);
    }
}
