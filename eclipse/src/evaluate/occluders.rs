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
    if !estimate.is_empty() && estimate.len() != truth.len() {
        let (expected, found) = (truth.len(), estimate.len());
        return Err(EvaluateError::Count {
            what: "masks",
            expected,
            found,
        });
    }
    let (mut difference, mut blocked) = (0.0, 0.0);
    let (mut intersection, mut union) = (0.0, 0.0);
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
                let guess = f64::from(estimate.pixel(column, row)[0]);
                let mask = f64::from(truth.pixel(column, row)[0]);
                difference += weight * (guess - mask).abs();
                blocked += weight * (1.0 - mask);
                let (guess, mask) = (guess < 0.5, mask < 0.5);
                intersection += if guess && mask { weight } else { 0.0 };
                union += if guess || mask { weight } else { 0.0 };
            }
        }
    }
    let ratio = |part: f64, whole: f64| (whole > 0.0).then(|| part / whole);
    Ok(OccluderScore {
        energy_weighted_error: ratio(difference, blocked),
        iou: ratio(intersection, union),
    })
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
