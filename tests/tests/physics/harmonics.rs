//! Spherical harmonics against the addition theorem, which knows nothing of orders or signs.

use render::harmonics::{Harmonics, coefficient};
use render::lat_long::LatLong;

/// Legendre's polynomial by Bonnet's recursion.
fn legendre(l: usize, x: f64) -> f64 {
    let (mut previous, mut current) = (1.0, x);
    if l == 0 {
        return previous;
    }
    for k in 1..l {
        let k = k as f64;
        (previous, current) = (
            current,
            ((2.0 * k + 1.0) * x * current - k * previous) / (k + 1.0),
        );
    }
    current
}

#[test]
fn degree_24_obeys_the_addition_theorem() {
    let grid = LatLong::new(50, 100);
    let harmonics = Harmonics::<f64>::new(24, grid);
    let frames = harmonics.coefficients();
    let mut identity = vec![0.0; frames * frames];
    (0..frames).for_each(|i| identity[i * frames + i] = 1.0);
    let mut values = vec![0.0; grid.len() * frames];
    harmonics.synthesize(&identity, &mut values, frames);
    // Σ_m Y_lm(a) Y_lm(b) = (2l + 1)/4π · P_l(a · b)
    for (a, b) in [(0, 0), (17, 4931), (2550, 2550), (1234, 3210), (99, 4900)] {
        let direction = |t: usize| {
            let theta = (f64::from(t as u32 / 100) + 0.5) / 50.0 * std::f64::consts::PI;
            let phi = (0.5 - (f64::from(t as u32 % 100) + 0.5) / 100.0) * std::f64::consts::TAU;
            [
                theta.sin() * phi.cos(),
                theta.sin() * phi.sin(),
                theta.cos(),
            ]
        };
        let dot: f64 = direction(a)
            .iter()
            .zip(direction(b))
            .map(|(p, q)| p * q)
            .sum();
        for l in 0..=24_usize {
            let order = |m: isize| {
                let c = coefficient(l, m);
                values[a * frames + c] * values[b * frames + c]
            };
            let sum: f64 = (-(l as isize)..=l as isize).map(order).sum();
            let expected = (2 * l + 1) as f64 / (4.0 * std::f64::consts::PI) * legendre(l, dot);
            assert!((sum - expected).abs() < 1e-9, "l {l}: {sum} {expected}");
        }
    }
}
