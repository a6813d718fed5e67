//! The background of photographs, where it is dark: what is bright there is the sensor's and the lens's doing.

use render::image::Image;

use super::statistics::{median, normal_cdf};
use crate::capture::Capture;

/// A part of the background of a frame, where the model says that there is no light at all.
#[derive(Clone, Copy, Debug)]
pub struct Dark {
    /// The frame.
    pub frame: u32,
    /// Its middle, pixels.
    pub at: [f32; 2],
    /// Mean, linear RGB, freed of the bias of values cut off at zero.
    pub value: [f32; 3],
    /// Variance of the mean.
    pub variance: [f32; 3],
    /// Which patch of the image, for the split.
    pub patch: u32,
}

/// Frame, place in blocks, pixels across, and the values of a block by colour.
type Block = (u32, [usize; 2], usize, [Vec<f64>; 3]);

/// Blocks of background, when it is dark in most frames: then every bit of light there is the sensor's doing.
///
/// `floor` is the least variance of a value, on top of which their number is of no help.
pub fn background(capture: &Capture, floor: f32) -> Vec<Dark> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut bright = 0;
    for (t, frame) in capture.frames.iter().enumerate() {
        let (image, mask) = (&frame.image, &frame.mask);
        let object: f64 = mean_of(image, |p| mask.data[p] > 0.999);
        let size = (image.width.max(image.height) / 24).clamp(3, 32);
        for by in 0..image.height / size {
            for bx in 0..image.width / size {
                let pixels: Vec<usize> = (0..size * size)
                    .map(|k| (by * size + k / size) * image.width + bx * size + k % size)
                    .collect();
                if pixels.iter().any(|&p| mask.data[p] > 0.0) {
                    continue;
                }
                // What lies far from the object says the same again and again.
                let near = near_object(mask, bx * size + size / 2, by * size + size / 2, 12);
                if !near && (bx + 2 * by + t) % 4 != 0 {
                    continue;
                }
                let values: [Vec<f64>; 3] = [0, 1, 2].map(|c| {
                    pixels
                        .iter()
                        .map(|&p| f64::from(image.data[3 * p + c]))
                        .collect()
                });
                if is_cut_out(&values) {
                    continue;
                }
                let sum: f64 = values.iter().flatten().sum();
                if sum > 0.2 * object * (3 * pixels.len()) as f64 {
                    bright += 1;
                }
                blocks.push((t as u32, [bx, by], size, values));
            }
        }
    }
    if 5 * bright > blocks.len() {
        return Vec::new();
    }
    let sigma = cut_noise(blocks.iter().flat_map(|block| &block.3));
    blocks
        .into_iter()
        .map(|(frame, [bx, by], size, values)| {
            let mut value = [0.0; 3];
            let mut variance = [0.0; 3];
            for (c, values) in values.iter().enumerate() {
                let n = values.len() as f64;
                let mean = values.iter().sum::<f64>() / n;
                let spread = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let (mean, noise) = match sigma {
                    Some(sigma) => (unrectified(mean, sigma), spread.max(sigma * sigma)),
                    None => (mean, spread.max(1e-12)),
                };
                value[c] = mean as f32;
                // A tenth of the noise stands for what the noise's own shape leaves open.
                variance[c] = ((noise / n + 0.01 * noise) as f32).max(floor);
            }
            let middle = |b: usize| (b * size) as f32 + 0.5 * size as f32;
            Dark {
                frame,
                at: [middle(bx), middle(by)],
                value,
                variance,
                patch: (by / 4 * 97 + bx / 4) as u32,
            }
        })
        .collect()
}

/// Whether nothing was recorded: a sensor has noise, so that a part that is zero throughout was cut out by a program or lies below
/// what the file holds. Neither says that lens and sensor add no light.
fn is_cut_out(values: &[Vec<f64>; 3]) -> bool {
    values.iter().flatten().all(|value| *value == 0.0)
}

/// The noise of a background whose values below zero were cut off; `None` when they were not, as where values below zero are found.
fn cut_noise<'a>(blocks: impl Iterator<Item = &'a Vec<f64>>) -> Option<f64> {
    let mut squares: Vec<f64> = blocks
        .filter_map(|values| {
            let above: Vec<f64> = values.iter().copied().filter(|v| *v > 0.0).collect();
            let cut = values.iter().filter(|v| **v == 0.0).count();
            let below = values.len() - above.len() - cut;
            // Of noise about zero half the values are positive, and their mean square is the variance.
            (below == 0 && 5 * cut > values.len() && above.len() > 2)
                .then(|| above.iter().map(|v| v * v).sum::<f64>() / above.len() as f64)
        })
        .collect();
    (squares.len() > 8).then(|| median(&mut squares).sqrt())
}

/// The mean before values below zero were cut off, from the mean after it, for normal noise of deviation `sigma`.
///
/// The mean after it is μ Φ(μ/σ) + σ φ(μ/σ), which grows with μ.
fn unrectified(mean: f64, sigma: f64) -> f64 {
    let after = |mu: f64| {
        let z = mu / sigma;
        let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        mu * normal_cdf(z) + sigma * density
    };
    let (mut low, mut high) = (-2.0 * sigma, mean.max(0.0) + sigma);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if after(middle) < mean {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn mean_of(image: &Image, keep: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for p in (0..image.width * image.height).filter(|&p| keep(p)) {
        sum += (0..3)
            .map(|c| f64::from(image.data[3 * p + c]))
            .sum::<f64>()
            / 3.0;
        count += 1;
    }
    sum / count.max(1) as f64
}

/// Whether a pixel of the object lies within `reach` along the row or the column.
fn near_object(mask: &Image, x: usize, y: usize, reach: usize) -> bool {
    let hit = |i: usize, j: usize| i < mask.width && j < mask.height && mask.pixel(i, j)[0] > 0.5;
    (1..=reach).any(|d| {
        hit(x.wrapping_sub(d), y) || hit(x + d, y) || hit(x, y.wrapping_sub(d)) || hit(x, y + d)
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use render::{camera::Camera, mesh::Mesh, sampler::SampleKey};

    use super::*;
    use crate::capture::Frame;

    const NOISE: f32 = 0.01;

    /// The mean of the dark background of noisy photographs of nothing but a constant, `kept` as a file keeps values.
    fn mean_of_background(constant: f32, kept: impl Fn(f32) -> f32) -> f32 {
        let dark = of_constant(constant, kept);
        assert!(dark.len() > 20);
        let values = dark.iter().flat_map(|d| d.value);
        values.sum::<f32>() / (3 * dark.len()) as f32
    }

    fn of_constant(constant: f32, kept: impl Fn(f32) -> f32) -> Vec<Dark> {
        let camera = Camera::look_at(64, 64, 0.5, Vec3::new(5.0, 0.0, 0.0), Vec3::ZERO);
        let frame = |frame: u32| {
            let mut image = Image::filled(64, 64, 3, 0.0);
            for (p, value) in image.data.iter_mut().enumerate() {
                let key = SampleKey {
                    frame,
                    pixel: p as u32,
                    ..SampleKey::default()
                };
                *value = kept(constant + NOISE * key.stream().normal());
            }
            let mut mask = Image::filled(64, 64, 1, 0.0);
            for p in (0..64 * 64)
                .filter(|p| (28..36).contains(&(p / 64)) && (28..36).contains(&(p % 64)))
            {
                mask.data[p] = 1.0;
                image.data[3 * p..][..3].fill(0.5);
            }
            Frame {
                name: String::new(),
                camera: camera.clone(),
                image,
                mask,
            }
        };
        let capture = Capture {
            path: "synthesised".into(),
            frames: (0..4).map(frame).collect(),
            mesh: Mesh::sphere(Vec3::ZERO, 1.0, 4),
            centre: Vec3::ZERO,
            lamps: None,
        };
        background(&capture, 0.0)
    }

    #[test]
    fn a_background_that_was_cut_out_says_nothing() {
        assert!(of_constant(0.0, |_| 0.0).is_empty());
        // One value that is left of noise is a record.
        assert!(!of_constant(0.0, |v| (v - NOISE).max(0.0)).is_empty());
    }

    #[test]
    fn a_dark_background_is_dark_whether_noise_below_zero_is_kept_or_cut_off() {
        for constant in [0.0, 0.004] {
            let whole = mean_of_background(constant, |v| v);
            let cut = mean_of_background(constant, |v| v.max(0.0));
            assert!((whole - constant).abs() < 0.03 * NOISE, "{whole}");
            // Half a normal distribution tells less of its middle.
            assert!((cut - constant).abs() < 0.2 * NOISE, "{cut}");
        }
    }
}
