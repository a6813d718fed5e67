//! Errors of an environment map, raw and after the best scale per channel.

use render::{image::Image, lat_long::LatLong};

use super::{EnvironmentScore, MapErrors};

/// Scores of a map and the scale that aligns it with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aligned {
    /// The errors.
    pub score: EnvironmentScore,
    /// s per channel minimising ‖s·L̂ − L‖, each texel counting the same.
    pub scale: [f64; 3],
}

/// Compares the map `estimate` with `truth`, both equirectangular RGB; `estimate` is brought to the truth's grid.
pub fn compare(estimate: &Image, truth: &Image) -> Aligned {
    let estimate = resample(estimate, truth.width, truth.height);
    let grid = LatLong::new(truth.height, truth.width);
    let (texels, scale) = errors(&estimate, truth, |_| 1.0);
    let (solid_angle, _) = errors(&estimate, truth, |row| f64::from(grid.solid_angle(row)));
    Aligned {
        score: EnvironmentScore {
            texels,
            solid_angle,
        },
        scale,
    }
}

fn errors(estimate: &Image, truth: &Image, weight: impl Fn(usize) -> f64) -> (MapErrors, [f64; 3]) {
    let mut total = 0.0;
    let mut cross = [0.0; 3];
    let mut own = [0.0; 3];
    let mut reference = [0.0; 3];
    for row in 0..truth.height {
        let weight = weight(row);
        for column in 0..truth.width {
            let (guess, truth) = (estimate.pixel(column, row), truth.pixel(column, row));
            total += weight;
            for channel in 0..3 {
                let (guess, truth) = (f64::from(guess[channel]), f64::from(truth[channel]));
                cross[channel] += weight * guess * truth;
                own[channel] += weight * guess * guess;
                reference[channel] += weight * truth * truth;
            }
        }
    }
    let scale = std::array::from_fn(|c| if own[c] > 0.0 { cross[c] / own[c] } else { 0.0 });
    let squared = |scale: [f64; 3]| -> f64 {
        let mut sum = 0.0;
        for row in 0..truth.height {
            for column in 0..truth.width {
                let (guess, truth) = (estimate.pixel(column, row), truth.pixel(column, row));
                for channel in 0..3 {
                    let error =
                        scale[channel] * f64::from(guess[channel]) - f64::from(truth[channel]);
                    sum += weight(row) * error * error;
                }
            }
        }
        sum
    };
    let (raw, aligned) = (squared([1.0; 3]), squared(scale));
    let energy: f64 = reference.iter().sum();
    let finite = |value: f64| value.is_finite().then_some(value);
    let errors = MapErrors {
        rmse: finite((raw / (3.0 * total)).sqrt()),
        rmse_aligned: finite((aligned / (3.0 * total)).sqrt()),
        relative_rmse_aligned: finite((aligned / energy).sqrt()),
        relative_mse_aligned: finite(aligned / energy),
    };
    (errors, scale)
}

/// The map on another grid, bilinearly between texel centres: columns wrap, rows clamp.
pub(super) fn resample(map: &Image, width: usize, height: usize) -> Image {
    if (map.width, map.height) == (width, height) {
        return map.clone();
    }
    let grid = LatLong::new(map.height, map.width);
    let mut resampled = Image::filled(width, height, map.channels, 0.0);
    for y in 0..height {
        for x in 0..width {
            let u = (x as f32 + 0.5) / width as f32;
            let v = (y as f32 + 0.5) / height as f32;
            let around = grid.bilinear_at(u, v);
            for channel in 0..map.channels {
                resampled.pixel_mut(x, y)[channel] = (0..4)
                    .map(|k| {
                        around.weight[k]
                            * map.data[around.index[k] as usize * map.channels + channel]
                    })
                    .sum();
            }
        }
    }
    resampled
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: usize, height: usize, value: impl Fn(usize, usize, usize) -> f32) -> Image {
        let mut map = Image::filled(width, height, 3, 0.0);
        for y in 0..height {
            for x in 0..width {
                for c in 0..3 {
                    map.pixel_mut(x, y)[c] = value(x, y, c);
                }
            }
        }
        map
    }

    #[test]
    fn a_scaled_truth_is_aligned_perfectly_and_its_scale_recovered() {
        let truth = map(8, 4, |x, y, c| 1.0 + (x + 3 * y + c) as f32);
        let estimate = map(8, 4, |x, y, c| {
            (1.0 + (x + 3 * y + c) as f32) * [2.0, 4.0, 0.5][c]
        });
        let aligned = compare(&estimate, &truth);
        assert_eq!(aligned.scale, [0.5, 0.25, 2.0]);
        assert_eq!(aligned.score.texels.rmse_aligned, Some(0.0));
        assert_eq!(aligned.score.solid_angle.relative_mse_aligned, Some(0.0));
        assert!(aligned.score.texels.rmse.unwrap() > 1.0);
    }

    #[test]
    fn a_constant_map_scores_the_relative_standard_deviation() {
        // Two rows 1 and 3: mean 2, so 1/√5 of the RMS remains after the best scale s·1 = 2; both rows have equal solid angle.
        let truth = map(4, 2, |_, y, _| [1.0, 3.0][y]);
        let score = compare(&map(4, 2, |_, _, _| 1.0), &truth).score;
        let expected = (1.0f64 / 5.0).sqrt();
        assert!((score.texels.relative_rmse_aligned.unwrap() - expected).abs() < 1e-6);
        assert!((score.solid_angle.relative_rmse_aligned.unwrap() - expected).abs() < 1e-6);
        assert!((score.texels.relative_mse_aligned.unwrap() - 0.2).abs() < 1e-6);
        assert!((score.texels.rmse.unwrap() - 2.0f64.sqrt()).abs() < 1e-6);
        assert!((score.texels.rmse_aligned.unwrap() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn poles_count_less_by_solid_angle() {
        let truth = map(8, 4, |_, _, _| 1.0);
        let wrong_at_pole = map(8, 4, |_, y, _| if y == 0 { 0.0 } else { 1.0 });
        let score = compare(&wrong_at_pole, &truth).score;
        // The polar row is ¼ of the texels and (1 − cos 45°)/2 = 0.1464 of the sphere.
        assert!((score.texels.rmse.unwrap().powi(2) - 0.25).abs() < 1e-6);
        let share = (1.0 - std::f64::consts::FRAC_PI_4.cos()) / 2.0;
        assert!((score.solid_angle.rmse.unwrap().powi(2) - share).abs() < 1e-6);
    }

    #[test]
    fn a_black_estimate_scores_one_and_a_black_truth_nothing() {
        let ones = map(4, 2, |_, _, _| 1.0);
        let black = map(4, 2, |_, _, _| 0.0);
        assert_eq!(
            compare(&black, &ones).score.texels.relative_rmse_aligned,
            Some(1.0)
        );
        assert_eq!(
            compare(&ones, &black).score.texels.relative_rmse_aligned,
            None
        );
    }

    #[test]
    fn resampling_keeps_constants_wraps_columns_and_clamps_rows() {
        assert!(
            resample(&map(4, 2, |_, _, _| 0.7), 8, 4)
                .data
                .iter()
                .all(|&v| (v - 0.7).abs() < 1e-6)
        );
        let ramp = resample(&map(4, 1, |x, _, _| [0.0, 1.0, 2.0, 3.0][x]), 8, 1);
        // The first fine centre lies ¼ texel left of the first coarse one, towards the last column.
        assert!((ramp.pixel(0, 0)[0] - 0.75).abs() < 1e-6);
        assert!((ramp.pixel(1, 0)[0] - 0.25).abs() < 1e-6);
    }
}
