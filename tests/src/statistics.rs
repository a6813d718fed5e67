//! The few statistics that Monte Carlo tests need.

/// Mean and standard error of independent values.
pub fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Pearson's χ² of counts against expectations as a number of standard deviations (Wilson & Hilferty 1931).
///
/// Cells expected fewer than 5 times are pooled.
pub fn chi_square_z(counts: &[f64], expected: &[f64]) -> f64 {
    let (mut statistic, mut cells) = (0.0, 0.0);
    let mut pool = (0.0, 0.0);
    let mut add = |observed: f64, expected: f64| {
        statistic += (observed - expected).powi(2) / expected;
        cells += 1.0;
    };
    for (&o, &e) in counts.iter().zip(expected) {
        if e >= 5.0 {
            add(o, e);
        } else {
            pool = (pool.0 + o, pool.1 + e);
        }
    }
    if pool.1 >= 5.0 {
        add(pool.0, pool.1);
    } else if pool.0 > 5.0 * (pool.1 + 1.0) {
        // Samples where none may fall.
        return f64::INFINITY;
    }
    let dof: f64 = cells - 1.0;
    let spread = 2.0 / (9.0 * dof);
    ((statistic / dof).cbrt() - (1.0 - spread)) / spread.sqrt()
}
