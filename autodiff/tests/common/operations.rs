//! A user's operations, which random graphs and fuzzed ones record.

use autodiff::{CustomOp, CustomVecOp, FirstOrderOnly, Fma, LinearMap, Real, Scalar};

/// A user's smooth operation.
pub struct Ratio;

impl CustomOp<2> for Ratio {
    fn name(&self) -> &'static str {
        "ratio"
    }
    fn eval<R: Real, F: Fma>(&self, [a, b]: [R; 2]) -> R {
        a / (R::from_f64(1.0) + b * b)
    }
}

/// One of two results.
pub struct SumAndShare;

impl CustomVecOp<2, 2> for SumAndShare {
    fn name(&self) -> &'static str {
        "sum and share"
    }
    fn eval<R: Real, F: Fma>(&self, [a, b]: [R; 2]) -> [R; 2] {
        [a + b, a * b / (R::from_f64(1.0) + a * a)]
    }
}

/// A user's operator on so many lanes.
pub struct Mix(pub usize);

impl Mix {
    fn run<S: Scalar>(&self, columns: usize, transpose: bool, input: &[S], output: &mut [S]) {
        output.fill(S::default());
        for to in 0..self.0 {
            for from in 0..self.0 {
                let (row, column) = if transpose { (from, to) } else { (to, from) };
                let entry = S::from_f64(((3 * row + column) as f64).sin() * 0.4);
                for c in 0..columns {
                    let sum = output[to * columns + c] + entry * input[from * columns + c];
                    output[to * columns + c] = sum;
                }
            }
        }
    }
}

impl LinearMap for Mix {
    fn shape(&self) -> (usize, usize) {
        (self.0, self.0)
    }
    fn apply_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.run(columns, false, input, output);
    }
    fn apply_transpose_f32(&self, columns: usize, input: &[f32], output: &mut [f32]) {
        self.run(columns, true, input, output);
    }
    fn apply_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.run(columns, false, input, output);
    }
    fn apply_transpose_f64(&self, columns: usize, input: &[f64], output: &mut [f64]) {
        self.run(columns, true, input, output);
    }
}

/// A cube that tells its slope only, and tells so many times its slope: once is right.
pub struct Cube {
    pub factor: f64,
}

impl FirstOrderOnly<1> for Cube {
    fn name(&self) -> &'static str {
        "cube"
    }
    fn eval(&self, [x]: [f64; 1]) -> f64 {
        x * x * x
    }
    fn partials(&self, [x]: [f64; 1], _: f64) -> [f64; 1] {
        [self.factor * 3.0 * x * x]
    }
}
