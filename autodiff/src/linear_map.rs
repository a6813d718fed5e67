//! Fixed linear operators supplied by the user.

/// A fixed linear operator between two domains, for example the synthesis of a basis or an upsampling.
///
/// Arrays are row-major `lanes x columns`: every column is transformed alike, and a row is contiguous. The output must be
/// overwritten wholly, must not depend on the number of threads, and `apply_transpose` must be the exact transpose of
/// `apply`: values and tangents go through the first, adjoints through the second.
pub trait LinearMap: Send + Sync {
    /// Lanes of the input, then of the output, of `apply`.
    fn shape(&self) -> (usize, usize);
    /// `output = A input` in single precision.
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]);
    /// `output = A^T input` in single precision; `input` has the output lanes of `apply`.
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]);
    /// `output = A input` in double precision.
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]);
    /// `output = A^T input` in double precision.
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]);
}
