//! What the examples share: a small optimiser, reproducible randomness, pictures.

#![allow(dead_code)]

use std::path::PathBuf;

/// Adam on one array.
pub struct Adam {
    /// The length of a step; let it fall.
    pub rate: f32,
    step: i32,
    mean: Vec<f32>,
    square: Vec<f32>,
}

impl Adam {
    pub fn new(n: usize, rate: f32) -> Self {
        Adam {
            rate,
            step: 0,
            mean: vec![0.0; n],
            square: vec![0.0; n],
        }
    }

    pub fn update(&mut self, x: &mut [f32], gradient: &[f32]) {
        self.step += 1;
        let (mean, square) = (1.0 - 0.9f32.powi(self.step), 1.0 - 0.999f32.powi(self.step));
        for i in 0..x.len() {
            self.mean[i] += 0.1 * (gradient[i] - self.mean[i]);
            self.square[i] += 0.001 * (gradient[i] * gradient[i] - self.square[i]);
            x[i] -= self.rate * (self.mean[i] / mean) / ((self.square[i] / square).sqrt() + 1e-8);
        }
    }
}

/// Numbers in [0, 1).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Saves panels of `width x height` pixels side by side; each gives red, green and blue in [0, 1].
pub fn save(
    name: &str,
    (width, height): (usize, usize),
    zoom: usize,
    panels: &[&dyn Fn(usize, usize) -> [f32; 3]],
) -> Result<PathBuf, image::ImageError> {
    let gap = 4;
    let panel = width * zoom + gap;
    let size = (panel * panels.len() - gap, height * zoom);
    let picture = image::RgbImage::from_fn(size.0 as u32, size.1 as u32, |x, y| {
        let (which, x) = (x as usize / panel, x as usize % panel / zoom);
        if x >= width {
            return image::Rgb([255; 3]);
        }
        let color = panels[which](x, y as usize / zoom);
        image::Rgb(color.map(|c| (c.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8))
    });
    // A test has arguments of its own.
    let path = match std::env::args().nth(1).filter(|_| !cfg!(test)) {
        Some(path) => PathBuf::from(path),
        None => std::env::temp_dir().join(name),
    };
    picture.save(&path)?;
    Ok(path)
}
