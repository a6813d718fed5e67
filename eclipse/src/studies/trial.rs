//! A capture whose truth is known, and what was recovered from it.

use std::{f32::consts::PI, path::Path, rc::Rc};

use render::{image::Image, lat_long::LatLong};

use super::StudyError;
use crate::{
    capture::{Capture, LoadOptions},
    evaluate::{self, Estimate, Evaluation, Truth, environment},
    reconstruction::Reconstruction,
};

/// A capture and its truth.
pub struct Trial {
    /// The folder's name.
    pub name: String,
    /// The photographs.
    pub capture: Rc<Capture>,
    /// What they are of.
    pub truth: Truth,
    /// The true radiance.
    pub light: Image,
}

impl Trial {
    /// Reads a capture with its folder `truth`.
    ///
    /// # Errors
    /// Files that cannot be read, or a truth without light.
    pub fn load(folder: &Path) -> Result<Self, StudyError> {
        let truth = evaluate::truth(&folder.join("truth"))?;
        let name = name_of(folder);
        let light = truth.environment.clone();
        Ok(Self {
            light: light.ok_or_else(|| StudyError::NoLight(name.clone()))?,
            capture: Rc::new(Capture::load(folder, &LoadOptions::default())?),
            name,
            truth,
        })
    }

    /// Whether somebody stood in the light.
    pub fn occluded(&self) -> bool {
        self.truth.occluders.is_some()
    }

    /// Relative RMSE, after the best scale, of a map of light.
    pub fn error(&self, map: &Image) -> f64 {
        let score = environment::compare(map, &self.light).score;
        score.texels.relative_rmse_aligned.unwrap_or(f64::NAN)
    }
}

/// What a capture is called: its folder's name.
pub fn name_of(folder: &Path) -> String {
    let name = folder.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// What was recovered, and how far from the truth it is.
pub struct Solved {
    /// The solver's result.
    pub found: Reconstruction,
    /// Its scores.
    pub scores: Evaluation,
    /// What the recovered light must be multiplied with, a channel each.
    pub scale: [f64; 3],
}

impl Solved {
    /// Scores a result.
    ///
    /// # Errors
    /// A truth of another capture.
    pub fn new(found: Reconstruction, trial: &Trial) -> Result<Self, StudyError> {
        let estimate = Estimate {
            environment: found.environment.clone(),
            occluders: found.occluders.clone(),
            materials: found.materials.clone(),
            metrics: found.metrics.clone(),
        };
        Ok(Self {
            scores: evaluate::score(&estimate, &trial.truth)?,
            scale: environment::compare(&found.environment, &trial.light).scale,
            found,
        })
    }

    /// Relative RMSE after the best scale of each channel.
    pub fn environment_error(&self) -> f64 {
        let score = self.scores.environment.texels;
        score.relative_rmse_aligned.unwrap_or(f64::NAN)
    }

    /// Decibels, after undoing that scale.
    pub fn albedo(&self) -> f64 {
        self.scores.albedo.psnr_aligned.unwrap_or(f64::NAN)
    }

    /// The recovered light in the truth's scale.
    pub fn light(&self) -> Image {
        let scale = self.scale.map(|s| s as f32);
        scaled(&self.found.environment, scale)
    }

    /// The recovered albedo through a camera, in the truth's scale: R, G, B.
    pub fn albedo_through(&self, frame: usize) -> Image {
        let materials = &self.found.materials[frame];
        let pixels = materials.data.chunks_exact(materials.channels);
        let rgb = Image {
            channels: 3,
            data: pixels.flat_map(|p| [p[0], p[1], p[2]]).collect(),
            ..*materials
        };
        scaled(&rgb, self.scale.map(|s| 1.0 / s.max(1e-12) as f32))
    }
}

fn scaled(image: &Image, scale: [f32; 3]) -> Image {
    let data = image.data.iter().enumerate();
    Image {
        data: data.map(|(i, v)| v * scale[i % 3]).collect(),
        ..*image
    }
}

/// Light convolved with a matt material: each direction shows what a white surface facing it reflects. The best that is
/// recovered by who does not take light and material apart.
pub fn convolved(light: &Image) -> Image {
    let grid = LatLong::new(light.height, light.width);
    let directions: Vec<_> = (0..grid.len())
        .map(|t| grid.texel_direction(t / grid.columns, t % grid.columns))
        .collect();
    let mut map = Image::filled(light.width, light.height, 3, 0.0);
    for (out, normal) in map.data.chunks_exact_mut(3).zip(&directions) {
        for (texel, direction) in directions.iter().enumerate() {
            let weight =
                normal.dot(*direction).max(0.0) * grid.solid_angle(texel / grid.columns) / PI;
            for c in 0..3 {
                out[c] += weight * light.data[3 * texel + c];
            }
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn convolved_light_keeps_constants_and_loses_odd_detail() {
        let flat = convolved(&Image::filled(40, 20, 3, 0.7));
        assert!(flat.data.iter().all(|v| (v - 0.7).abs() < 5e-3));
        // A wave of order 3 around the vertical is of odd degree: a matt surface shows nothing of it.
        let grid = LatLong::new(20, 40);
        let mut wave = Image::filled(40, 20, 3, 0.0);
        for (t, out) in wave.data.chunks_exact_mut(3).enumerate() {
            let d = grid.texel_direction(t / 40, t % 40);
            out.fill(1.0 + d.x * (d.x * d.x - 3.0 * d.y * d.y));
        }
        let left = convolved(&wave);
        let most = left.data.iter().map(|v| (v - 1.0).abs());
        assert!(most.fold(0.0, f32::max) < 0.01);
    }
}
