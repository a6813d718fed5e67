//! The noise of photographs, estimated from themselves.
//!
//! The difference of two Laplacians (Immerkær, CVIU 64, 1996) does not see planes or edges along the axes and turns noise
//! of variance σ² into 36 σ². Its magnitude is collected by brightness, inside the object; of each brightness a low
//! quantile counts, which is set by the smooth parts: texture and shadow edges are in the upper ones. A sensor's law,
//! var = read² + shot²·I + (relative·I)², is then fitted through the levels with terms that are not negative.

use render::image::Image;

use crate::{capture::Frame, reconstruction::Noise};

/// The quantile of the magnitudes that counts, and what it is for a normal distribution of unit variance.
const QUANTILE: f64 = 0.25;
const NORMAL_QUANTILE: f64 = 0.318_639_364;
/// Levels of brightness.
const LEVELS: usize = 24;
/// Fewer magnitudes than this say nothing about a level.
const LEAST: usize = 64;
/// Photographs are never taken to be better than this share of their brightness: eight bits, or a path tracer's rest.
const FLOOR: f64 = 1e-3;

/// Estimates the noise of the photographs inside their masks.
///
/// With too few pixels to tell (a tiny object), 1 % of the brightness is assumed.
pub fn estimate(frames: &[Frame]) -> Noise {
    let mut samples: Vec<(f32, f32)> = frames
        .iter()
        .flat_map(|frame| magnitudes(&frame.image, &frame.mask))
        .collect();
    samples.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let size = (samples.len() / LEVELS).max(LEAST);
    let levels: Vec<Level> = samples
        .chunks(size)
        .filter(|chunk| chunk.len() >= LEAST)
        .map(Level::new)
        .collect();
    // Of photographs that are black for the most part, their mean: noise of 0 would make every pixel infinitely sure.
    let middle = levels.get(levels.len() / 2).map(|level| level.brightness);
    let mean = levels.iter().map(|level| level.brightness).sum::<f64>() / levels.len() as f64;
    let mut bright = [middle, Some(mean)].into_iter().flatten();
    let typical = bright.find(|level| *level > 0.0).unwrap_or(1.0);
    fit(&levels).map_or(
        Noise {
            read: FLOOR * typical,
            shot: 0.0,
            relative: 0.01,
        },
        |[read, shot, relative]| Noise {
            read: read.sqrt().max(FLOOR * typical),
            shot: shot.sqrt(),
            relative: relative.sqrt(),
        },
    )
}

/// Brightness and magnitude of the response wherever 3 × 3 pixels lie inside the object, of all channels.
fn magnitudes(image: &Image, mask: &Image) -> Vec<(f32, f32)> {
    const RESPONSE: [f32; 9] = [1.0, -2.0, 1.0, -2.0, 4.0, -2.0, 1.0, -2.0, 1.0];
    let mut found = Vec::new();
    for y in 1..image.height.saturating_sub(1) {
        for x in 1..image.width.saturating_sub(1) {
            let around = || (0..9).map(|k| (x + k % 3 - 1, y + k / 3 - 1));
            if around().any(|(x, y)| mask.pixel(x, y)[0] < 0.999) {
                continue;
            }
            for c in 0..3 {
                let (mut sum, mut response) = (0.0, 0.0);
                for ((x, y), weight) in around().zip(RESPONSE) {
                    let value = image.pixel(x, y)[c];
                    sum += value / 9.0;
                    response += weight * value;
                }
                found.push((sum, response.abs()));
            }
        }
    }
    found
}

/// Photographs' variance at one brightness.
struct Level {
    brightness: f64,
    variance: f64,
}

impl Level {
    fn new(samples: &[(f32, f32)]) -> Self {
        let mut magnitudes: Vec<f32> = samples.iter().map(|s| s.1).collect();
        magnitudes.sort_unstable_by(f32::total_cmp);
        let low = f64::from(magnitudes[(QUANTILE * magnitudes.len() as f64) as usize]);
        Self {
            brightness: samples.iter().map(|s| f64::from(s.0)).sum::<f64>() / samples.len() as f64,
            variance: (low / (6.0 * NORMAL_QUANTILE)).powi(2),
        }
    }
}

/// The three variances' coefficients (of 1, I, I²), none negative, that fit best relative to the levels' own size.
fn fit(levels: &[Level]) -> Option<[f64; 3]> {
    let largest = levels.iter().map(|l| l.variance).fold(0.0, f64::max);
    if levels.len() < 3 || largest <= 0.0 {
        return None;
    }
    // Every subset of the terms: the best of those whose coefficients are not negative is the constrained optimum.
    (1..8u32)
        .filter_map(|subset| {
            let terms: Vec<usize> = (0..3).filter(|k| subset >> k & 1 == 1).collect();
            let coefficients = solve(levels, &terms, 1e-3 * largest)?;
            let mut all = [0.0; 3];
            terms
                .iter()
                .zip(&coefficients)
                .for_each(|(&k, &c)| all[k] = c);
            let error: f64 = levels
                .iter()
                .map(|l| residual(l, &all, 1e-3 * largest).powi(2))
                .sum();
            all.iter().all(|&c| c >= 0.0).then_some((error, all))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, all)| all)
}

fn basis(level: &Level) -> [f64; 3] {
    [1.0, level.brightness.max(0.0), level.brightness.powi(2)]
}

fn residual(level: &Level, coefficients: &[f64; 3], floor: f64) -> f64 {
    let predicted: f64 = basis(level)
        .iter()
        .zip(coefficients)
        .map(|(b, c)| b * c)
        .sum();
    (predicted - level.variance) / (level.variance + floor)
}

/// Weighted least squares over `terms` by Gaussian elimination; `None` when they cannot be told apart.
fn solve(levels: &[Level], terms: &[usize], floor: f64) -> Option<Vec<f64>> {
    let n = terms.len();
    let mut system = vec![vec![0.0; n + 1]; n];
    for level in levels {
        let weight = 1.0 / (level.variance + floor).powi(2);
        let basis = basis(level);
        for i in 0..n {
            for j in 0..n {
                system[i][j] += weight * basis[terms[i]] * basis[terms[j]];
            }
            system[i][n] += weight * basis[terms[i]] * level.variance;
        }
    }
    for i in 0..n {
        let scale = system[i][i].abs();
        let pivot = (i..n).max_by(|&a, &b| system[a][i].abs().total_cmp(&system[b][i].abs()))?;
        system.swap(i, pivot);
        if system[i][i].abs() <= 1e-12 * scale || system[i][i] == 0.0 {
            return None;
        }
        for j in 0..n {
            if j != i {
                let factor = system[j][i] / system[i][i];
                for k in i..=n {
                    system[j][k] -= factor * system[i][k];
                }
            }
        }
    }
    Some((0..n).map(|i| system[i][n] / system[i][i]).collect())
}

#[cfg(test)]
mod tests {
    use render::{camera::Camera, sampler::SampleKey};

    use super::*;

    /// A lit ball on black with noise of the given law; with `texture`, a fifth of it is chequered.
    fn photograph(noise: &Noise, texture: bool, seed: u64) -> Frame {
        let (size, radius) = (160usize, 70.0f32);
        let mut image = Image::filled(size, size, 3, 0.0);
        let mut mask = Image::filled(size, size, 1, 0.0);
        let mut stream = SampleKey {
            seed,
            ..SampleKey::default()
        }
        .stream();
        for p in 0..size * size {
            let (x, y) = (
                (p % size) as f32 - size as f32 / 2.0,
                (p / size) as f32 - size as f32 / 2.0,
            );
            let r = x.hypot(y) / radius;
            if r > 1.0 {
                continue;
            }
            mask.data[p] = 1.0;
            let light = 0.02 + 0.9 * (0.6 * (1.0 - r * r).sqrt() + 0.4 * (x / radius)).max(0.0);
            let patch = texture && x > 28.0;
            let tone = if patch && (p % size + p / size) % 2 == 0 {
                0.6
            } else {
                1.0
            };
            for c in 0..3 {
                let value = f64::from(light * tone);
                let radius = (-2.0 * f64::from(1.0 - stream.uniform()).ln()).sqrt();
                let normal = radius * (f64::from(stream.uniform()) * std::f64::consts::TAU).cos();
                image.data[3 * p + c] = (value + noise.sigma(value) * normal) as f32;
            }
        }
        Frame {
            name: "ball".into(),
            camera: Camera::look_at(size, size, 0.5, 4.0 * glam::Vec3::X, glam::Vec3::ZERO),
            image,
            mask,
        }
    }

    #[test]
    fn a_planted_law_is_recovered_texture_or_not() {
        let laws = [(2e-3, 4e-3, 0.01), (5e-3, 0.0, 0.0), (1e-3, 2e-2, 0.0)];
        for (read, shot, relative) in laws {
            let law = Noise {
                read,
                shot,
                relative,
            };
            for (texture, tolerance) in [(false, 0.1), (true, 0.45)] {
                let found = estimate(&[photograph(&law, texture, 1), photograph(&law, texture, 2)]);
                for value in [0.05, 0.3, 0.6] {
                    let ratio = found.sigma(value) / law.sigma(value);
                    assert!(
                        (ratio - 1.0).abs() < tolerance,
                        "{law:?} {found:?} at {value}: {ratio}"
                    );
                }
            }
        }
    }

    #[test]
    fn black_is_not_known_infinitely_well() {
        let none = Noise {
            read: 0.0,
            shot: 0.0,
            relative: 0.0,
        };
        let mut frame = photograph(&none, false, 1);
        for (p, pixel) in frame.image.data.chunks_exact_mut(3).enumerate() {
            if p % 160 < 140 {
                pixel.fill(0.0);
            }
        }
        assert!(estimate(&[frame]).sigma(0.0) > 1e-6);
    }

    #[test]
    fn photographs_without_noise_or_without_pixels_still_have_a_law() {
        let none = Noise {
            read: 0.0,
            shot: 0.0,
            relative: 0.0,
        };
        for frames in [vec![], vec![photograph(&none, false, 1)]] {
            let found = estimate(&frames);
            assert!(
                found.sigma(0.5) > 1e-5 && found.sigma(0.5) < 0.02,
                "{found:?}"
            );
        }
    }
}
