//! Errors of the occluders' masks, weighted by the light that they take away.

use render::{image::Image, lat_long::LatLong};

use super::{EvaluateError, OccluderScore, environment};

/// Compares masks (transmittance, first channel) with the truth, pooled over frames; L is the sum of `light`'s channels.
///
/// No estimate at all counts as "all light passes".
///
/// # Errors
/// Counts that differ.
pub fn compare(
    estimate: &[Image],
    truth: &[Image],
    light: &Image,
) -> Result<OccluderScore, EvaluateError> {
    let (mut difference, mut blocked) = (0.0, 0.0);
    let (mut intersection, mut union) = (0.0, 0.0);
    each_texel(estimate, truth, light, |weight, [guess, mask]| {
        difference += weight * (guess - mask).abs();
        blocked += weight * (1.0 - mask);
        let (guess, mask) = (guess < 0.5, mask < 0.5);
        intersection += if guess && mask { weight } else { 0.0 };
        union += if guess || mask { weight } else { 0.0 };
    })?;
    Ok(OccluderScore {
        energy_weighted_error: ratio(difference, blocked),
        iou: ratio(intersection, union),
    })
}

/// The energy-weighted error after the best factor common to all masks, and that factor: photographs cannot tell masks that all let
/// through half as much from the same under half the light, whose error is taken after its best scale as well.
///
/// # Errors
/// As [`compare`].
pub fn compare_scaled(
    estimate: &[Image],
    truth: &[Image],
    light: &Image,
) -> Result<Option<Scaled>, EvaluateError> {
    let mut pairs = Vec::new();
    each_texel(estimate, truth, light, |weight, [guess, mask]| {
        pairs.push((weight, [guess, mask]));
    })?;
    // Σ w|f·guess − mask| is least in f at a weighted median of what each pair asks for.
    let mut asked: Vec<[f64; 2]> = pairs
        .iter()
        .filter(|(weight, [guess, _])| weight * guess > 0.0)
        .map(|(weight, [guess, mask])| [mask / guess, weight * guess])
        .collect();
    asked.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
    let half = 0.5 * asked.iter().map(|a| a[1]).sum::<f64>();
    let mut below = 0.0;
    let median = asked.iter().find(|a| {
        below += a[1];
        below >= half
    });
    let factor = median.map_or(1.0, |a| a[0]);
    let (mut difference, mut blocked) = (0.0, 0.0);
    for (weight, [guess, mask]) in pairs {
        difference += weight * (factor * guess - mask).abs();
        blocked += weight * (1.0 - mask);
    }
    Ok(ratio(difference, blocked).map(|error| Scaled { error, factor }))
}

/// Masks after the best factor common to all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaled {
    /// As [`OccluderScore::energy_weighted_error`].
    pub error: f64,
    /// What all masks are multiplied by, and light is divided by.
    pub factor: f64,
}

fn ratio(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole)
}

/// Gives `take` every direction of every frame: the light from it times its solid angle, and the estimate beside the truth.
fn each_texel(
    estimate: &[Image],
    truth: &[Image],
    light: &Image,
    mut take: impl FnMut(f64, [f64; 2]),
) -> Result<(), EvaluateError> {
    if !estimate.is_empty() && estimate.len() != truth.len() {
        let (expected, found) = (truth.len(), estimate.len());
        return Err(EvaluateError::Count {
            what: "masks",
            expected,
            found,
        });
    }
    for (frame, truth) in truth.iter().enumerate() {
        let light = environment::resample(light, truth.width, truth.height);
        let clear = || Image::filled(truth.width, truth.height, 1, 1.0);
        let resample = |mask| environment::resample(mask, truth.width, truth.height);
        let estimate = estimate.get(frame).map_or_else(clear, resample);
        let grid = LatLong::new(truth.height, truth.width);
        for row in 0..truth.height {
            let solid_angle = f64::from(grid.solid_angle(row));
            for column in 0..truth.width {
                let radiance: f32 = light.pixel(column, row)[..3].iter().sum();
                let weight = f64::from(radiance) * solid_angle;
                let of = |mask: &Image| f64::from(mask.pixel(column, row)[0]);
                take(weight, [of(&estimate), of(truth)]);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 4 × 2 mask; both rows of that grid span the same solid angle.
    fn mask(values: [f32; 8]) -> Image {
        Image {
            width: 4,
            height: 2,
            channels: 1,
            data: values.to_vec(),
        }
    }

    fn light() -> Image {
        let mut light = Image::filled(4, 2, 3, 1.0);
        light.pixel_mut(1, 0).fill(3.0);
        light
    }

    #[test]
    fn a_perfect_mask_scores_zero_and_one() {
        let truth = [mask([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])];
        let score = compare(&truth, &truth, &light()).unwrap();
        assert_eq!(
            score,
            OccluderScore {
                energy_weighted_error: Some(0.0),
                iou: Some(1.0)
            }
        );
    }

    #[test]
    fn no_mask_scores_one_and_zero() {
        let truth = [mask([0.0, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])];
        let clear = [mask([1.0; 8])];
        for estimate in [&clear[..], &[]] {
            let score = compare(estimate, &truth, &light()).unwrap();
            assert!((score.energy_weighted_error.unwrap() - 1.0).abs() < 1e-7);
            assert_eq!(score.iou, Some(0.0));
        }
    }

    #[test]
    fn texels_count_by_their_light_pooled_over_frames() {
        let truth = [
            mask([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
            mask([1.0; 8]),
        ];
        // Frame 0 misses the bright texel (weight 3 of 4); frame 1 blocks one of weight 1 by 0.6.
        let estimate = [
            mask([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
            mask([1.0, 1.0, 1.0, 0.4, 1.0, 1.0, 1.0, 1.0]),
        ];
        let score = compare(&estimate, &truth, &light()).unwrap();
        assert!((score.energy_weighted_error.unwrap() - 3.6 / 4.0).abs() < 1e-6);
        assert!((score.iou.unwrap() - 1.0 / 5.0).abs() < 1e-12);
    }

    #[test]
    fn masks_that_are_all_darker_are_as_good_under_brighter_light() {
        let truth = [
            mask([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
            mask([1.0; 8]),
        ];
        let dark = truth.clone().map(|mut mask| {
            mask.data.iter_mut().for_each(|v| *v *= 0.25);
            mask
        });
        let of = |estimate: &[Image]| {
            let scaled = compare_scaled(estimate, &truth, &light()).unwrap();
            scaled.unwrap()
        };
        let as_found = compare(&dark, &truth, &light()).unwrap();
        assert!(as_found.energy_weighted_error.unwrap() > 2.0);
        let scaled = of(&dark);
        assert!((scaled.error).abs() < 1e-6 && (scaled.factor - 4.0).abs() < 1e-6);
        // What is right as it is stays, and no factor makes masks of nothing.
        assert_eq!(
            of(&truth),
            Scaled {
                error: 0.0,
                factor: 1.0
            }
        );
        assert!((of(&[]).error - 1.0).abs() < 1e-6);
        // One more that is dark where nothing is: the others stay right.
        let mut wrong = dark.clone();
        wrong[1].data[7] = 0.0;
        let scaled = of(&wrong);
        assert!((scaled.error - 0.25).abs() < 1e-6 && (scaled.factor - 4.0).abs() < 1e-6);
        let clear = [mask([1.0; 8])];
        assert_eq!(compare_scaled(&clear, &clear, &light()).unwrap(), None);
    }

    #[test]
    fn frames_that_do_not_match_are_refused() {
        let truth = [mask([0.0; 8]), mask([0.0; 8])];
        let error = compare(&truth[..1], &truth, &light()).unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("1 masks were reconstructed but the truth has 2")
        );
    }

    #[test]
    fn truth_that_blocks_nothing_has_no_score() {
        let clear = [mask([1.0; 8])];
        assert_eq!(
            compare(&clear, &clear, &light()).unwrap(),
            OccluderScore::default()
        );
    }
}
