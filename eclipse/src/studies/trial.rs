//! A capture whose truth is known, and what was recovered from it.

use std::{path::Path, rc::Rc};

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bsdf::{Material, Model},
    image::Image,
    lat_long::LatLong,
};

use super::StudyError;
use crate::{
    capture::{Capture, LoadOptions},
    evaluate::{self, Estimate, Evaluation, Truth, environment},
    reconstruction::{Ended, Reconstruction},
    report::text::number,
};

/// Reflectance where the truth does not tell it.
const USUAL_ALBEDO: f32 = 0.5;

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

    /// The true light convolved with the object's own material: its lobe, and its albedo on average.
    pub fn convolved(&self) -> Image {
        let lobe = self.truth.specular;
        let model = match lobe {
            Some(_) => Model::Microfacet,
            None => Model::Lambertian,
        };
        let material = Material {
            albedo: self.mean_albedo(),
            alpha: lobe.map_or(1.0, |lobe| lobe.alpha as f32),
            kappa: lobe.map_or(0.0, |lobe| lobe.kappa as f32),
        };
        convolved(&self.light, model, &material)
    }

    /// Over the object's pixels of all photographs.
    fn mean_albedo(&self) -> [f32; 3] {
        let (mut sum, mut count) = ([0.0; 3], 0usize);
        for truth in &self.truth.albedo {
            let pixels = truth.albedo.data.chunks_exact(truth.albedo.channels);
            for (pixel, _) in pixels.zip(&truth.object).filter(|(_, object)| **object) {
                (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
                count += 1;
            }
        }
        match count {
            0 => [USUAL_ALBEDO; 3],
            n => sum.map(|sum| (sum / n as f64) as f32),
        }
    }

    /// Relative RMSE, after the best scale, of the best constant map: of who knows nothing of where light comes from.
    pub fn constant_error(&self) -> f64 {
        self.error(&Image::filled(self.light.width, self.light.height, 3, 1.0))
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
        let scale = self.scale.map(|s| 1.0 / s.max(1e-12) as f32);
        scaled(&self.own_albedo_through(frame), scale)
    }

    /// The same as it was found.
    pub fn own_albedo_through(&self, frame: usize) -> Image {
        let materials = &self.found.materials[frame];
        let pixels = materials.data.chunks_exact(materials.channels);
        Image {
            channels: 3,
            data: pixels.flat_map(|p| [p[0], p[1], p[2]]).collect(),
            ..*materials
        }
    }
}

/// What is to be said of the time of solves whose results are worse than was claimed: what can be seen of it, and no more.
pub(super) fn ends<'a>(solved: impl IntoIterator<Item = &'a Solved>, seconds: f64) -> String {
    let (mut all, mut cut, mut counted) = (0, 0, 0);
    for solve in solved {
        all += 1;
        cut += usize::from(solve.found.ended == Ended::TimeLimit);
        counted += usize::from(solve.found.ended == Ended::Iterations);
    }
    because(all, [cut, counted], seconds)
}

/// The same of so many solves, some of them cut off by their time, some after all the steps that they were given.
fn because(all: usize, [cut, counted]: [usize; 2], seconds: f64) -> String {
    match cut {
        0 if counted > 0 => format!(
            "{counted} of the {all} solves behind it ended after the steps that they were given; whether more do better was not tested"
        ),
        0 => format!(
            "none of the {all} solves behind it was cut off by its time limit: the cause was not found"
        ),
        _ => format!(
            "{cut} of the {all} solves behind it were cut off by their limit of {} s; whether a longer --time-limit does better was \
             not tested",
            number(seconds)
        ),
    }
}

fn scaled(image: &Image, scale: [f32; 3]) -> Image {
    let data = image.data.iter().enumerate();
    Image {
        data: data.map(|(i, v)| v * scale[i % 3]).collect(),
        ..*image
    }
}

/// Light convolved with a material: each direction shows what a surface facing it reflects to whoever looks at it from straight
/// in front. The best that is recovered by who does not take light and material apart.
pub fn convolved(light: &Image, model: Model, material: &Material) -> Image {
    let grid = LatLong::new(light.height, light.width);
    let directions: Vec<Vec3> = (0..grid.len())
        .map(|t| grid.texel_direction(t / grid.columns, t % grid.columns))
        .collect();
    let mut map = Image::filled(light.width, light.height, 3, 0.0);
    let texels = map.data.par_chunks_exact_mut(3).zip(&directions);
    texels.for_each(|(out, &normal)| {
        for (texel, &direction) in directions.iter().enumerate() {
            let cosine = normal.dot(direction);
            if cosine <= 0.0 {
                continue;
            }
            let reflected = model.evaluate(material, normal, direction, normal);
            let weight = cosine * grid.solid_angle(texel / grid.columns);
            for c in 0..3 {
                out[c] += weight * reflected[c] * light.data[3 * texel + c];
            }
        }
    });
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Material = Material {
        albedo: [1.0; 3],
        alpha: 1.0,
        kappa: 0.0,
    };

    /// 1, and a wave of order 3 around the vertical.
    fn wave() -> Image {
        let grid = LatLong::new(20, 40);
        let mut wave = Image::filled(40, 20, 3, 0.0);
        for (t, out) in wave.data.chunks_exact_mut(3).enumerate() {
            let d = grid.texel_direction(t / 40, t % 40);
            out.fill(1.0 + d.x * (d.x * d.x - 3.0 * d.y * d.y));
        }
        wave
    }

    /// How far a map goes from its mean, relative.
    fn contrast(map: &Image) -> f32 {
        let mean = map.data.iter().sum::<f32>() / map.data.len() as f32;
        let off = map.data.iter().map(|v| (v / mean - 1.0).abs());
        off.fold(0.0, f32::max)
    }

    #[test]
    fn light_convolved_with_a_matt_material_keeps_constants_and_loses_odd_detail() {
        let flat = convolved(&Image::filled(40, 20, 3, 0.7), Model::Lambertian, &WHITE);
        assert!(flat.data.iter().all(|v| (v - 0.7).abs() < 5e-3));
        // The wave is of odd degree: a matt surface shows nothing of it.
        let left = convolved(&wave(), Model::Lambertian, &WHITE);
        let most = left.data.iter().map(|v| (v - 1.0).abs());
        assert!(most.fold(0.0, f32::max) < 0.01);
    }

    #[test]
    fn a_shiny_material_keeps_detail_that_a_matt_one_loses() {
        let gloss = Material {
            albedo: [0.0; 3],
            alpha: 0.2,
            kappa: 0.5,
        };
        let kept = contrast(&convolved(&wave(), Model::Microfacet, &gloss));
        // By the theorem of Funk and Hecke: 0.49 of the wave, and 0.39 of it under the coat.
        assert!((0.4..0.6).contains(&kept), "{kept}");
        let coated = Material {
            albedo: [0.5; 3],
            ..gloss
        };
        let between = contrast(&convolved(&wave(), Model::Microfacet, &coated));
        assert!((0.3..kept).contains(&between), "{between} of {kept}");
    }

    #[test]
    fn time_is_blamed_only_where_it_ended_something() {
        assert!(because(3, [0, 0], 60.0).contains("the cause was not found"));
        let counted = because(3, [0, 3], 60.0);
        assert!(counted.starts_with("3 of the 3") && counted.contains("was not tested"));
        let cut = because(3, [2, 0], 60.0);
        assert!(
            cut.starts_with("2 of the 3 solves") && cut.contains("60 s"),
            "{cut}"
        );
    }
}
