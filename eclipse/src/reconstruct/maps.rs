//! The pyramid as a linear operator of the tape.

use std::sync::Arc;

use autodiff::LinearMap;
use render::pyramid::Pyramid;

/// Levels of a pyramid, coarsest first, to its finest grid.
pub struct PyramidMap(pub Arc<Pyramid>);

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

/// The standard deviation of every value of a pyramid whose levels, finest first, have these; the pyramid's own weight 2ᵏ
/// of a level is divided out.
pub fn level_deviations(pyramid: &Pyramid, finest_first: &[f32]) -> Vec<f32> {
    let mut deviations = vec![0.0; pyramid.len()];
    let count = pyramid.levels().len();
    for k in 0..count {
        let deviation = finest_first[(count - 1 - k).min(finest_first.len() - 1)];
        deviations[pyramid.range(k)].fill(deviation / (1u32 << k) as f32);
    }
    deviations
}
