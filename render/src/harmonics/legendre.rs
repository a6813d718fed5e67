//! Associated Legendre functions.

/// √(2 if m > 0) K_lm P_lm(cos θ) for l = m..=degree, by the stable recurrence in l on fully normalised functions
/// (Holmes & Featherstone 2002).
pub(super) fn normalised_legendre(degree: usize, m: usize, theta: f64) -> Vec<f64> {
    let (sin, x) = theta.sin_cos();
    let mut start = (1.0 / (4.0 * std::f64::consts::PI)).sqrt();
    for k in 1..=m {
        start *= sin * ((2 * k + 1) as f64 / (2 * k) as f64).sqrt();
    }
    if m > 0 {
        start *= std::f64::consts::SQRT_2;
    }
    let mut values = vec![start];
    for l in m + 1..=degree {
        let (lf, mf) = (l as f64, m as f64);
        let a = ((4.0 * lf * lf - 1.0) / (lf * lf - mf * mf)).sqrt();
        let previous = values[l - m - 1];
        let next = if l == m + 1 {
            a * x * previous
        } else {
            let b = (((lf - 1.0).powi(2) - mf * mf) / (4.0 * (lf - 1.0).powi(2) - 1.0)).sqrt();
            a * (x * previous - b * values[l - m - 2])
        };
        values.push(next);
    }
    values
}
