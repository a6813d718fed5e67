//! What several test files record.

use autodiff::LinearMap;

/// A map of so many lanes onto themselves.
pub struct Identity(pub usize);

impl LinearMap for Identity {
    fn shape(&self) -> (usize, usize) {
        (self.0, self.0)
    }
    fn apply_f32(&self, _: usize, input: &[f32], output: &mut [f32]) {
        output.copy_from_slice(input);
    }
    fn apply_transpose_f32(&self, _: usize, input: &[f32], output: &mut [f32]) {
        output.copy_from_slice(input);
    }
    fn apply_f64(&self, _: usize, input: &[f64], output: &mut [f64]) {
        output.copy_from_slice(input);
    }
    fn apply_transpose_f64(&self, _: usize, input: &[f64], output: &mut [f64]) {
        output.copy_from_slice(input);
    }
}
