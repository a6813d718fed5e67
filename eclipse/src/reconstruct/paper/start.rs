//! Starting from the outcome of another solver instead of from nothing.

use std::path::Path;

use autodiff::RunError;
use glam::Vec3;
use render::{
    bsdf::Material,
    bvh::Bvh,
    estimator::{EstimatorOptions, MaskBasis, Unknowns},
    harmonics::Harmonics,
    image::Image,
    lat_long::LatLong,
    pyramid::Pyramid,
};

use super::{PaperError, batch::COVERED, materials::MaterialEvaluator};
use crate::{
    capture::Capture,
    checkpoint,
    evaluate::{self, Estimate},
};

/// Radiance below this share of the mean starts there: the logarithm of a black texel would be −∞, and Adam at the paper's
/// rate would not come back from far down.
const DARKEST: f32 = 1e-3;
/// Transmittances start this far from 0 and 1: further out the sigmoid has no gradient left.
const CLEAR: f32 = 0.9933;
const BLOCKED: f32 = 0.02;
/// Corrections of the projection onto harmonics, each by the residual of the last.
const CORRECTIONS: usize = 8;
/// A fall of the agreement with the photographs that is told, in decibels: what its own noise does is less.
const WORSE: f64 = 0.5;

/// What is known before the first iteration; what is empty starts as in the paper.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// Linear radiance on the environment's grid.
    pub environment: Option<Image>,
    /// Transmittance on the masks' grid, one channel, for every frame; or none.
    pub masks: Vec<Image>,
    /// Materials at places of the surface.
    pub materials: Vec<(Vec3, Material)>,
}

impl Start {
    /// What an earlier run left in `folder` for the same capture.
    ///
    /// # Errors
    /// When its files cannot be read, or its images do not fit the capture's.
    pub fn read(folder: &Path, capture: &Capture, bvh: &Bvh) -> Result<Self, PaperError> {
        let found = estimate(folder, capture)?;
        let mut materials = Vec::new();
        for (frame, image) in capture.frames.iter().zip(&found.materials) {
            let width = frame.image.width;
            for (p, value) in image.data.chunks_exact(5).enumerate() {
                if frame.mask.data[p] <= COVERED || value.iter().any(|v| !v.is_finite()) {
                    continue;
                }
                let (x, y) = ((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
                if let Some((surface, _)) = bvh.seen(&frame.camera, x, y) {
                    let material = Material {
                        albedo: [value[0], value[1], value[2]],
                        alpha: value[3],
                        kappa: value[4],
                    };
                    materials.push((surface.position, material));
                }
            }
        }
        Ok(Self {
            environment: Some(found.environment),
            masks: found.occluders,
            materials,
        })
    }

    /// Writes what is known into `unknowns` of an estimator of these options, with masks in this basis. Images of another size are
    /// left out.
    ///
    /// # Errors
    /// When memory does not suffice to fit the network.
    pub fn apply(
        &self,
        unknowns: &mut Unknowns,
        options: &EstimatorOptions,
        basis: MaskBasis,
        evaluator: &MaterialEvaluator,
        seed: u64,
    ) -> Result<(), RunError> {
        let EstimatorOptions {
            pyramid,
            degree,
            frames,
            ..
        } = options;
        let grid = pyramid.finest();
        let fits = |image: &Image, channels: usize| {
            [image.height, image.width, image.channels] == [grid.rows, grid.columns, channels]
        };
        if let Some(image) = self.environment.as_ref().filter(|image| fits(image, 3)) {
            log_radiance(image, pyramid, &mut unknowns.environment);
        }
        let known = self.masks.len() == *frames && self.masks.iter().all(|m| fits(m, 1));
        if *frames > 0 && known {
            let logits = logits(&self.masks, grid);
            unknowns.occluders = match basis {
                MaskBasis::Harmonics => projected(&logits, grid, *degree, *frames),
                MaskBasis::Texels => logits,
            };
        }
        evaluator.fit(&mut unknowns.network, &self.materials, seed)
    }
}

/// Checks that a run can start from what an earlier one left in `folder`, before a place is made for its results.
///
/// # Errors
/// As [`Start::read`].
pub fn check(folder: &Path, capture: &Capture) -> Result<(), PaperError> {
    estimate(folder, capture).map(drop)
}

/// What to say where a run that began with the result in `folder` explains the photographs worse than that did.
pub fn fell_behind(folder: &Path, psnr: Option<f64>) -> Option<String> {
    let before = evaluate::metrics(folder).ok()?.photometric.psnr?;
    let after = psnr?;
    (after < before - WORSE).then(|| {
        format!(
            "the photographs are explained worse than by the result that this run began with ({after:.1} dB after {before:.1} dB): its first \
             steps upset more than they mend; give it more time, or keep what is in {}",
            folder.display()
        )
    })
}

/// What an earlier run left, of the capture's number of images and of their sizes.
fn estimate(folder: &Path, capture: &Capture) -> Result<Estimate, PaperError> {
    let refuse = |reason: String| PaperError::Start {
        path: folder.to_owned(),
        reason,
    };
    if checkpoint::is_of(folder, capture) == Some(false) {
        return Err(refuse(
            "it was found from another capture, or from this one with other photographs, cameras, masks, mesh or axes than now: name a \
             result of this capture, read as it was then"
                .to_owned(),
        ));
    }
    let found = evaluate::estimate(folder).map_err(|error| refuse(error.to_string()))?;
    let frames = &capture.frames;
    for (what, count) in [
        ("occluders", found.occluders.len()),
        ("material images", found.materials.len()),
    ] {
        if count > 0 && count != frames.len() {
            return Err(refuse(format!(
                "it has {count} {what}, but the capture has {} photographs: name a result of the same capture",
                frames.len()
            )));
        }
    }
    for (frame, image) in frames.iter().zip(&found.materials) {
        let (width, height) = (frame.image.width, frame.image.height);
        if [image.width, image.height, image.channels] != [width, height, 5] {
            return Err(refuse(format!(
                "its materials of frame {} are {} x {} with {} channels, expected {width} x {height} with 5",
                frame.name, image.width, image.height, image.channels
            )));
        }
    }
    Ok(found)
}

/// Puts the logarithm on the finest level alone: how levels share it makes no difference to Adam, whose steps follow from
/// the gradient with respect to the sum.
fn log_radiance(image: &Image, pyramid: &Pyramid, levels: &mut [f32]) {
    let mean = image.data.iter().sum::<f32>() / image.data.len() as f32;
    let floor = (DARKEST * mean).max(f32::MIN_POSITIVE);
    let finest = pyramid.levels().len() - 1;
    let weight = pyramid.level_weight(finest) as f32;
    for (c, channel) in levels.chunks_exact_mut(pyramid.len()).enumerate() {
        channel.fill(0.0);
        let texels = image.data.iter().skip(c).step_by(3);
        for (value, &radiance) in channel[pyramid.range(finest)].iter_mut().zip(texels) {
            *value = radiance.max(floor).ln() / weight;
        }
    }
}

/// The masks' logits, `[texel][frame]`.
fn logits(masks: &[Image], grid: LatLong) -> Vec<f32> {
    let frames = masks.len();
    let mut logits = vec![0.0; grid.len() * frames];
    for (t, mask) in masks.iter().enumerate() {
        for (texel, &m) in mask.data.iter().enumerate() {
            let m = m.clamp(BLOCKED, CLEAR);
            logits[texel * frames + t] = (m / (1.0 - m)).ln();
        }
    }
    logits
}

/// Harmonics of logits, `[coefficient][frame]`: least squares over the sphere, by projection and corrections.
fn projected(target: &[f32], grid: LatLong, degree: usize, frames: usize) -> Vec<f32> {
    let harmonics = Harmonics::<f32>::new(degree, grid);
    let mut coefficients = vec![0.0; harmonics.coefficients() * frames];
    let mut values = vec![0.0; target.len()];
    let mut correction = coefficients.clone();
    for _ in 0..=CORRECTIONS {
        harmonics.synthesize(&coefficients, &mut values, frames);
        for (i, (value, target)) in values.iter_mut().zip(target).enumerate() {
            *value = (target - *value) * grid.solid_angle(i / frames / grid.columns);
        }
        harmonics.transpose(&values, &mut correction, frames);
        coefficients
            .iter_mut()
            .zip(&correction)
            .for_each(|(a, b)| *a += b);
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::{bsdf::Model, loss::LossForm, path::Lookup};

    #[test]
    fn light_masks_and_materials_are_taken_over() {
        let grid = LatLong::new(16, 32);
        let pyramid = Pyramid::new(grid, 3);
        let degree = 7;
        let options = EstimatorOptions {
            model: Model::Microfacet,
            pyramid: pyramid.clone(),
            mask_grid: grid,
            degree,
            frames: 2,
            lookup: Lookup::Stochastic,
            form: LossForm::HalfBackward,
        };
        let mut unknowns = options.start(5.0, 1, 1.0);
        let mut environment = Image::filled(32, 16, 3, 0.0);
        let wave = |i: usize| 1.0 + 0.9 * (0.1 * i as f32).sin();
        environment
            .data
            .iter_mut()
            .enumerate()
            .for_each(|(i, v)| *v = wave(i));
        // Smooth masks, within what the harmonics can express.
        let mask = |t: usize| {
            let mut mask = Image::filled(32, 16, 1, 0.0);
            for r in 0..16 {
                for c in 0..32 {
                    let d = grid.texel_direction(r, c);
                    let x = 1.5 + d.x * (1.0 + t as f32) - d.z * d.y;
                    mask.data[r * 32 + c] = 1.0 / (1.0 + (-x).exp());
                }
            }
            mask
        };
        let masks = vec![mask(0), mask(1)];
        let material = |x: f32| Material {
            albedo: [0.2 + 0.1 * x, 0.7, 0.4],
            alpha: 0.3,
            kappa: 0.04,
        };
        let start = Start {
            environment: Some(environment.clone()),
            masks: masks.clone(),
            materials: (0..64)
                .map(|i| i as f32 / 32.0 - 1.0)
                .map(|x| (Vec3::new(x, 0.0, 0.0), material(x)))
                .collect(),
        };
        let evaluator = MaterialEvaluator::new().unwrap();
        let basis = MaskBasis::Harmonics;
        start
            .apply(&mut unknowns, &options, basis, &evaluator, 3)
            .unwrap();

        let found = crate::reconstruct::paper::radiance(&unknowns.environment, &pyramid);
        for (a, b) in found.data.iter().zip(&environment.data) {
            assert!((a / b - 1.0).abs() < 1e-4);
        }
        let found = crate::reconstruct::paper::transmittance(&unknowns.occluders, grid, degree);
        for (a, b) in found.iter().zip(&masks) {
            for (a, b) in a.data.iter().zip(&b.data) {
                assert!((a - b).abs() < 0.01, "{a} for {b}");
            }
        }
        let m = unknowns.network.evaluate(Vec3::new(0.5, 0.0, 0.0));
        assert!(
            (m.albedo[0] - 0.25).abs() < 0.05 && (m.alpha - 0.3).abs() < 0.05,
            "{m:?}"
        );
    }

    #[test]
    fn free_texels_take_light_and_masks_over_as_they_are() {
        let grid = LatLong::new(6, 12);
        let options = EstimatorOptions {
            model: Model::Lambertian,
            pyramid: Pyramid::with_ratio(grid, 3, 0.5).finest_alone(),
            mask_grid: grid,
            degree: 2,
            frames: 2,
            lookup: Lookup::Stochastic,
            form: LossForm::HalfBackward,
        };
        let basis = MaskBasis::Texels;
        let mut unknowns = options.start_in(basis, 5.0, 1, 1.0);
        let wave = |i: usize| 0.5 + 0.4 * (0.7 * i as f32).sin();
        let mut environment = Image::filled(12, 6, 3, 0.0);
        let mut mask = Image::filled(12, 6, 1, 0.0);
        for image in [&mut environment, &mut mask] {
            let values = image.data.iter_mut().enumerate();
            values.for_each(|(i, v)| *v = wave(i));
        }
        let start = Start {
            environment: Some(environment.clone()),
            masks: vec![mask.clone(), Image::filled(12, 6, 1, 0.25)],
            materials: vec![(
                Vec3::X,
                Material {
                    albedo: [0.5; 3],
                    alpha: 0.5,
                    kappa: 0.04,
                },
            )],
        };
        let evaluator = MaterialEvaluator::new().unwrap();
        start
            .apply(&mut unknowns, &options, basis, &evaluator, 3)
            .unwrap();
        let light = crate::reconstruct::paper::radiance(&unknowns.environment, &options.pyramid);
        for (a, b) in light.data.iter().zip(&environment.data) {
            assert!((a / b - 1.0).abs() < 1e-4, "{a} for {b}");
        }
        let masks = crate::reconstruct::paper::free_transmittance(&unknowns.occluders, grid);
        assert!(masks[1].data.iter().all(|m| (m - 0.25).abs() < 1e-5));
        for (a, b) in masks[0].data.iter().zip(&mask.data) {
            assert!((a - b).abs() < 1e-5, "{a} for {b}");
        }
    }
}
