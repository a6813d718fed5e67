//! How large an effect must be to be found.

use super::{compete::LEAST_SIGMA, linear::Cholesky, reduce::System};

/// What the training data hold of an effect's own coefficients, in deviations of their prior.
pub struct Own {
    /// The most likely ones.
    pub beta: Vec<f64>,
    /// Their standard errors.
    pub error: Vec<f64>,
    /// βᵀ𝓘β: how unlikely the data are without them, in χ², whatever light, texture and the model's other effects do instead.
    pub signal: f64,
}

impl Own {
    /// Of the last coefficients of a system, which are `beta`; all before are free to follow.
    pub fn new(system: &System, beta: Vec<f64>) -> Self {
        let size = system.b.len();
        let free = size - beta.len();
        let along: Vec<f64> = (0..size)
            .map(|i| {
                let row = &system.a[i * size + free..(i + 1) * size];
                row.iter().zip(&beta).map(|(a, b)| a * b).sum()
            })
            .collect();
        // The prior of own coefficients, which the system holds, is no data.
        let own = beta.iter().zip(&along[free..]);
        let whole: f64 = own.map(|(b, a)| b * (a - b)).sum();
        let mut imitated = along[..free].to_vec();
        Cholesky::new(&system.a, free, size).forward(&mut imitated);
        let imitated: f64 = imitated.iter().map(|x| x * x).sum();
        Self {
            error: system.errors().split_off(free),
            signal: (whole - imitated).max(0.0),
            beta,
        }
    }

    /// How many of the coefficients the data determine rather than the prior (MacKay, Neural Computation 4, 1992).
    pub fn determined(&self) -> f64 {
        self.error.iter().map(|e| (1.0 - e * e).max(0.0)).sum()
    }

    /// The size from which on the gain on held-out patches is expected to stand up, where `size` is that of coefficients.
    pub fn minimum_detectable(&self, size: impl Fn(&[f64]) -> f64) -> f64 {
        let least = least_signal(self.determined());
        if self.signal > 0.0 {
            return size(&self.beta) * (least / self.signal).sqrt();
        }
        // Nothing was found: the coefficient that would be the first to show.
        let single = |k: usize| {
            let mut one = vec![0.0; self.beta.len()];
            let signal = (self.error[k].powi(-2) - 1.0).max(0.0);
            one[k] = (least / signal).sqrt();
            if one[k].is_finite() {
                size(&one)
            } else {
                f64::INFINITY
            }
        };
        (0..self.beta.len())
            .map(single)
            .fold(f64::INFINITY, f64::min)
    }
}

/// The χ² λ that `determined` coefficients must be worth for their gain to be [`LEAST_SIGMA`] of its standard errors.
///
/// What is predicted for patches left out gains λ and loses one for every number that had to be estimated. Its variance is
/// 4λ by noise in those patches and two for every number by its estimate.
fn least_signal(determined: f64) -> f64 {
    let squared = LEAST_SIGMA * LEAST_SIGMA;
    // λ − K = s √(4λ + 2K).
    let middle = determined + 2.0 * squared;
    middle + (middle * middle - determined * determined + 2.0 * squared * determined).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_at_the_limit_is_three_of_its_errors() {
        for determined in [0.2, 1.0, 24.0, 300.0] {
            let signal = least_signal(determined);
            let (gain, variance) = (signal - determined, 4.0 * signal + 2.0 * determined);
            assert!((gain / variance.sqrt() - LEAST_SIGMA).abs() < 1e-9);
        }
        // More numbers are harder to find, but by far not one by one.
        let ratio = least_signal(100.0) / least_signal(1.0);
        assert!((3.0..10.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn what_others_imitate_is_no_signal() {
        // Two columns of 50 observations' worth, the second shares some of the first; a prior of one on each.
        let system = |shared: f64| System {
            a: vec![51.0, shared, shared, 51.0],
            b: vec![0.0; 2],
        };
        let alone = Own::new(&system(0.0), vec![2.0]);
        assert!((alone.signal - 200.0).abs() < 1e-9);
        let hidden = Own::new(&system(40.0), vec![2.0]);
        assert!((hidden.signal - 4.0 * (50.0 - 1600.0 / 51.0)).abs() < 1e-9);
        let size = |beta: &[f64]| 0.01 * beta[0].abs();
        let limits = [&alone, &hidden].map(|own| own.minimum_detectable(size));
        assert!(limits[1] > 1.5 * limits[0], "{limits:?}");
        // It does not depend on what was found.
        let larger = Own::new(&system(0.0), vec![4.0]).minimum_detectable(size);
        assert!((larger - limits[0]).abs() < 1e-12);
        let nothing = Own::new(&system(0.0), vec![0.0]).minimum_detectable(size);
        assert!((nothing - limits[0]).abs() < 1e-12);
    }
}
