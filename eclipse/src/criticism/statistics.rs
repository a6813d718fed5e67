//! The few distributions and robust measures that tests need.

use render::sampler::SampleKey;

/// The standard normal distribution function (Abramowitz & Stegun 7.1.26 is too coarse in the tails; this is W. J. Cody's
/// continued fraction for large arguments and the series for small ones).
pub fn normal_cdf(x: f64) -> f64 {
    1.0 - normal_tail(x)
}

/// The share of a standard normal distribution above `x`, accurate in the far tail.
pub fn normal_tail(x: f64) -> f64 {
    if x < 0.0 {
        return 1.0 - normal_tail(-x);
    }
    let density = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    if x < 3.0 {
        // Φ(x) − ½ = φ(x) Σ x^(2k+1)/(1·3·5…(2k+1)).
        let (mut term, mut sum, mut k) = (x, x, 1.0);
        while term > 1e-17 * sum.max(1e-300) && k < 400.0 {
            term *= x * x / (2.0 * k + 1.0);
            sum += term;
            k += 1.0;
        }
        return 0.5 - density * sum;
    }
    let mut fraction = x;
    for k in (1..60).rev() {
        fraction = x + f64::from(k) / fraction;
    }
    density / fraction
}

/// The middle of the values; NaN without any.
pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Holm's step-down correction of p-values for as many tests.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_unstable_by(|&a, &b| p[a].total_cmp(&p[b]).then(a.cmp(&b)));
    let mut corrected = vec![1.0; p.len()];
    let mut least = 0.0f64;
    for (rank, &i) in order.iter().enumerate() {
        least = least.max((p[i] * (p.len() - rank) as f64).min(1.0));
        corrected[i] = least;
    }
    corrected
}

/// Benjamini and Hochberg's false discovery rate: which tests stand at level `q`.
pub fn discoveries(p: &[f64], q: f64) -> Vec<bool> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_unstable_by(|&a, &b| p[a].total_cmp(&p[b]).then(a.cmp(&b)));
    let count = order
        .iter()
        .enumerate()
        .filter(|(rank, i)| p[**i] <= q * (rank + 1) as f64 / p.len() as f64)
        .map(|(rank, _)| rank + 1)
        .max()
        .unwrap_or(0);
    let mut found = vec![false; p.len()];
    order[..count].iter().for_each(|&i| found[i] = true);
    found
}

/// The sum of differences and its standard error from their scatter.
pub fn paired(differences: &[f64]) -> (f64, f64) {
    let n = differences.len() as f64;
    let sum: f64 = differences.iter().sum();
    if n < 2.0 {
        return (sum, f64::INFINITY);
    }
    let mean = sum / n;
    let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
    (sum, (squares * n / (n - 1.0)).sqrt())
}

/// Sums of `values` by cluster: what is in one is not independent.
pub fn clustered(values: impl Iterator<Item = (usize, f64)>) -> Vec<f64> {
    let mut sums = std::collections::BTreeMap::new();
    for (cluster, value) in values {
        *sums.entry(cluster).or_insert(0.0) += value;
    }
    sums.into_values().collect()
}

/// How often random signs of the blocks give as large a sum; beyond what sampling resolves, the normal approximation.
pub fn sign_flips(differences: &[f64]) -> f64 {
    const DRAWS: usize = 4000;
    let sum: f64 = differences.iter().sum();
    let power: f64 = differences.iter().map(|d| d * d).sum::<f64>().sqrt();
    if power == 0.0 || sum <= 0.0 {
        return 1.0;
    }
    let mut stream = SampleKey {
        dimension: 74,
        ..SampleKey::default()
    }
    .stream();
    let as_large = (0..DRAWS)
        .filter(|_| {
            let flipped: f64 = differences
                .iter()
                .map(|d| if stream.uniform() < 0.5 { -d } else { *d })
                .sum();
            flipped >= sum
        })
        .count();
    if as_large >= 10 {
        return as_large as f64 / DRAWS as f64;
    }
    let (_, error) = paired(differences);
    normal_tail(sum / error.max(1e-300)).max(1e-300)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_tables() {
        for (x, tail) in [
            (0.0, 0.5),
            (1.0, 0.158_655_253_931_457),
            (2.9, 1.865_813_300_384_05e-3),
            (3.1, 9.676_032_132_183_56e-4),
            (6.0, 9.865_876_450_376_98e-10),
        ] {
            let found = normal_tail(x);
            assert!((found / tail - 1.0).abs() < 1e-9, "{x}: {found}");
        }
        assert!((normal_cdf(-1.0) - 0.158_655_253_931_457).abs() < 1e-12);
    }

    #[test]
    fn corrections_for_many_tests() {
        assert_eq!(holm(&[0.01, 0.04, 0.03]), vec![0.03, 0.06, 0.06]);
        assert_eq!(discoveries(&[0.01, 0.9, 0.02], 0.05), [true, false, true]);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
    }
}
