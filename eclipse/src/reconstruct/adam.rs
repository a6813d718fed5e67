//! Adam (Kingma & Ba, ICLR 2015, algorithm 1), with its published constants.

/// Decay of the first moment.
const BETA_1: f32 = 0.9;
/// Decay of the second moment.
const BETA_2: f32 = 0.999;
/// Keeps a parameter without gradient where it is.
const EPSILON: f32 = 1e-8;

/// The moments of one group of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Decaying mean of the gradient.
    pub first: Vec<f32>,
    /// Decaying mean of its square.
    pub second: Vec<f32>,
}

impl Adam {
    /// Moments of `length` parameters before the first step.
    pub fn new(length: usize) -> Self {
        Self {
            first: vec![0.0; length],
            second: vec![0.0; length],
        }
    }

    /// Takes step number `step`, counted from 1, with learning rate `rate`.
    ///
    /// Parameters and gradient are as long as the moments.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f32, step: u64) {
        // Powers in double precision: 1 − 0.999ᵗ has few digits left in single precision.
        let correction = |beta: f32| 1.0 - f64::from(beta).powf(step as f64);
        let first_scale = (1.0 / correction(BETA_1)) as f32;
        let second_scale = (1.0 / correction(BETA_2)) as f32;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, &g), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *first = BETA_1 * *first + (1.0 - BETA_1) * g;
            *second = BETA_2 * *second + (1.0 - BETA_2) * g * g;
            *parameter -=
                rate * (*first * first_scale) / ((*second * second_scale).sqrt() + EPSILON);
        }
    }
}
