//! The fixed linear operators of the model as the tape applies them: pyramid upsampling and harmonic synthesis.

use autodiff::LinearMap;

use crate::harmonics::Harmonics;
use crate::lat_long::LatLong;
use crate::pyramid::Pyramid;

/// [`Pyramid`] from its values, coarsest level first, to the finest texels.
#[derive(Clone, Debug)]
pub struct PyramidMap(pub Pyramid);

impl LinearMap for PyramidMap {
    fn shape(&self) -> (usize, usize) {
        (self.0.len(), self.0.finest().len())
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.0.apply(input, output, columns);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.0.apply_transpose(input, output, columns);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.0.apply(input, output, columns);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.0.apply_transpose(input, output, columns);
    }
}

/// [`Harmonics`] from coefficients to texels, for several frames.
///
/// The frames may be the tape's inner axis (`frames` 1: lanes are coefficients and texels) or part of the lanes (lanes are
/// coefficient × frames + frame and texel × frames + frame), which lets a sample look up its own frame's mask alone. The
/// numbers lie in memory alike.
#[derive(Clone, Debug)]
pub struct HarmonicMap {
    single: Harmonics<f32>,
    double: Harmonics<f64>,
    frames: usize,
}

impl HarmonicMap {
    /// Synthesis up to `degree` on `grid`, with `frames` frames in the lanes.
    pub fn new(degree: usize, grid: LatLong, frames: usize) -> Self {
        Self {
            single: Harmonics::new(degree, grid),
            double: Harmonics::new(degree, grid),
            frames,
        }
    }
}

impl LinearMap for HarmonicMap {
    fn shape(&self) -> (usize, usize) {
        (
            self.single.coefficients() * self.frames,
            self.single.grid().len() * self.frames,
        )
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.single.synthesize(input, output, self.frames * columns);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.single.transpose(input, output, self.frames * columns);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.double.synthesize(input, output, self.frames * columns);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.double.transpose(input, output, self.frames * columns);
    }
}
