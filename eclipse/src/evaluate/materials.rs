//! Errors of albedo and specular parameters on the pixels that the object covers wholly.

use std::borrow::Cow;

use render::image::Image;

use super::{AlbedoScore, EvaluateError, MaterialScore};
use crate::image_io::{reduce, reduced_size};

/// Coverage of a larger pixel from which the object covers it wholly.
const WHOLE: f32 = 0.999;

/// The true albedo through one camera.
#[derive(Clone, Debug)]
pub struct TrueAlbedo {
    /// Linear RGB in [0, 1].
    pub albedo: Image,
    /// Which pixels are the object's, row by row.
    pub object: Vec<bool>,
}

/// True parameters of the specular lobe, the same all over the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Specular {
    /// Width of the lobe.
    pub alpha: f64,
    /// Reflectance at normal incidence.
    pub kappa: f64,
}

/// PSNR of the first three channels of `estimate` divided by `scale`, pooled over frames.
///
/// # Errors
/// Counts or sizes that differ.
pub fn albedo(
    estimate: &[Image],
    truth: &[TrueAlbedo],
    scale: [f64; 3],
) -> Result<AlbedoScore, EvaluateError> {
    let truth = in_sizes_of(estimate, truth);
    check(estimate, &truth)?;
    let (mut sum, mut count) = (0.0, 0u64);
    for (estimate, truth) in estimate.iter().zip(&*truth) {
        for index in object_pixels(truth) {
            let guess = &estimate.data[index * estimate.channels..][..3];
            let truth = &truth.albedo.data[index * truth.albedo.channels..][..3];
            for channel in 0..3 {
                let error = f64::from(guess[channel]) / scale[channel] - f64::from(truth[channel]);
                sum += error * error;
                count += 1;
            }
        }
    }
    // A perfect albedo scores 200 dB: JSON has no infinity.
    let psnr = -10.0 * (sum / count as f64).max(1e-20).log10();
    Ok(AlbedoScore {
        psnr_aligned: (count > 0 && sum.is_finite()).then_some(psnr),
    })
}

/// RMS errors of channels 3 (α) and 4 (κ) of `estimate`, pooled over frames.
///
/// # Errors
/// Counts or sizes that differ.
pub fn specular(
    estimate: &[Image],
    truth: &[TrueAlbedo],
    specular: Specular,
) -> Result<MaterialScore, EvaluateError> {
    let truth = in_sizes_of(estimate, truth);
    check(estimate, &truth)?;
    let rmse = |channel: usize, expected: f64| {
        let (mut sum, mut count) = (0.0, 0u64);
        for (estimate, truth) in estimate.iter().zip(&*truth) {
            for index in object_pixels(truth) {
                let value = estimate.data[index * estimate.channels + channel];
                sum += (f64::from(value) - expected).powi(2);
                count += 1;
            }
        }
        let rmse = (sum / count as f64).sqrt();
        rmse.is_finite().then_some(rmse)
    };
    Ok(MaterialScore {
        alpha_rmse: rmse(3, specular.alpha),
        kappa_rmse: rmse(4, specular.kappa),
    })
}

/// The truth in the sizes of `estimate`, where a run reduced its photographs to them (`--max-size`), else as it is.
fn in_sizes_of<'a>(estimate: &[Image], truth: &'a [TrueAlbedo]) -> Cow<'a, [TrueAlbedo]> {
    let smaller = |estimate: &Image, truth: &TrueAlbedo| {
        let own = [truth.albedo.width, truth.albedo.height];
        let size = [estimate.width, estimate.height];
        let reduced = reduced_size(own, size[0].max(size[1])) == size;
        (size != own && reduced).then_some(size)
    };
    let sizes = estimate.iter().zip(truth);
    let sizes: Vec<_> = sizes.map(|(e, t)| smaller(e, t)).collect();
    // Another number is refused, whatever the sizes are.
    if sizes.len() != truth.len() || sizes.iter().all(Option::is_none) {
        return Cow::Borrowed(truth);
    }
    let in_size = |(truth, size): (&TrueAlbedo, &Option<[usize; 2]>)| match *size {
        Some(size) => truth.reduced(size),
        None => truth.clone(),
    };
    Cow::Owned(truth.iter().zip(&sizes).map(in_size).collect())
}

impl TrueAlbedo {
    /// What larger pixels see of it: those that the object covers wholly.
    fn reduced(&self, size: [usize; 2]) -> Self {
        let object = Image {
            channels: 1,
            data: self
                .object
                .iter()
                .map(|&object| f32::from(u8::from(object)))
                .collect(),
            ..self.albedo
        };
        let covered = reduce(&object, size).data;
        Self {
            albedo: reduce(&self.albedo, size),
            object: covered.into_iter().map(|share| share >= WHOLE).collect(),
        }
    }
}

fn object_pixels(truth: &TrueAlbedo) -> impl Iterator<Item = usize> {
    truth
        .object
        .iter()
        .enumerate()
        .filter_map(|(index, &object)| object.then_some(index))
}

fn check(estimate: &[Image], truth: &[TrueAlbedo]) -> Result<(), EvaluateError> {
    if estimate.len() != truth.len() {
        let (expected, found) = (truth.len(), estimate.len());
        return Err(EvaluateError::Count {
            what: "material images",
            expected,
            found,
        });
    }
    for (index, (estimate, truth)) in estimate.iter().zip(truth).enumerate() {
        let albedo = &truth.albedo;
        if (estimate.width, estimate.height, estimate.channels) != (albedo.width, albedo.height, 5)
        {
            return Err(EvaluateError::Size {
                what: "material image",
                index,
                expected: format!("{} × {} × 5", albedo.width, albedo.height),
                found: format!(
                    "{} × {} × {}",
                    estimate.width, estimate.height, estimate.channels
                ),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> TrueAlbedo {
        TrueAlbedo {
            albedo: Image::filled(2, 1, 3, 0.5),
            object: vec![true, false],
        }
    }

    fn estimate(object: [f32; 5]) -> Image {
        let mut data = object.to_vec();
        data.extend([9.0; 5]);
        Image {
            width: 2,
            height: 1,
            channels: 5,
            data,
        }
    }

    #[test]
    fn a_tenth_off_is_twenty_decibels_on_object_pixels_only() {
        let guess = estimate([0.6, 0.4, 0.6, 0.0, 0.0]);
        let score = albedo(&[guess], &[truth()], [1.0; 3]).unwrap();
        assert!((score.psnr_aligned.unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn the_environments_scale_is_undone_in_the_albedo() {
        // L = 2·L̂ with L̂ρ̂ = Lρ: the albedo was estimated at twice its value; then a tenth is added.
        let guess = estimate([1.2, 1.2, 1.2, 0.0, 0.0]);
        let score = albedo(&[guess], &[truth()], [2.0; 3]).unwrap();
        assert!((score.psnr_aligned.unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn specular_errors_are_root_mean_squares_over_all_frames() {
        let guesses = [
            estimate([0.0, 0.0, 0.0, 0.6, 0.1]),
            estimate([0.0, 0.0, 0.0, 0.2, 0.04]),
        ];
        let known = Specular {
            alpha: 0.6,
            kappa: 0.04,
        };
        let score = specular(&guesses, &[truth(), truth()], known).unwrap();
        assert!((score.alpha_rmse.unwrap() - 0.4 / 2f64.sqrt()).abs() < 1e-6);
        assert!((score.kappa_rmse.unwrap() - 0.06 / 2f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn other_captures_are_refused_by_count_and_size() {
        let error = albedo(&[], &[truth()], [1.0; 3]).unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("0 material images were reconstructed but the truth has 1")
        );
        let error = albedo(&[Image::filled(3, 1, 5, 0.0)], &[truth()], [1.0; 3]).unwrap_err();
        assert!(error.to_string().contains("3 × 1 × 5") && error.to_string().contains("2 × 1 × 5"));
    }

    #[test]
    fn a_run_on_reduced_photographs_is_scored_by_the_truth_reduced() {
        // Two pixels of four each: the first of albedo ½ on average, the second not wholly the object's.
        let mut truth = TrueAlbedo {
            albedo: Image::filled(4, 2, 3, 0.0),
            object: vec![true; 8],
        };
        for (x, value) in [0.4, 0.6, 0.5, 0.5].into_iter().enumerate() {
            for y in 0..2 {
                truth.albedo.pixel_mut(x, y).fill(value);
            }
        }
        truth.object[7] = false;
        let guess = [estimate([0.6, 0.4, 0.6, 0.6, 0.04])];
        let truth = [truth];
        let score = albedo(&guess, &truth, [1.0; 3]).unwrap();
        assert!((score.psnr_aligned.unwrap() - 20.0).abs() < 1e-5);
        let known = Specular {
            alpha: 0.5,
            kappa: 0.04,
        };
        let score = specular(&guess, &truth, known).unwrap();
        assert!((score.alpha_rmse.unwrap() - 0.1).abs() < 1e-6);
        // Another shape is another capture.
        let square = [Image::filled(2, 2, 5, 0.0)];
        assert!(albedo(&square, &truth, [1.0; 3]).is_err());
    }

    #[test]
    fn a_perfect_albedo_has_a_finite_score() {
        let score = albedo(&[estimate([0.5; 5])], &[truth()], [1.0; 3]).unwrap();
        assert_eq!(score.psnr_aligned, Some(200.0));
    }

    #[test]
    fn no_object_pixels_score_nothing() {
        let nothing = TrueAlbedo {
            object: vec![false; 2],
            ..truth()
        };
        let score = albedo(&[estimate([0.0; 5])], &[nothing], [1.0; 3]).unwrap();
        assert_eq!(score.psnr_aligned, None);
    }
}
