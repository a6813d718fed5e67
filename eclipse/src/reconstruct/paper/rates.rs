//! Learning rates over a run, as shares of the paper's.

use super::plan::MOST_PIXELS;

/// Share at a start from another solver's result: what it knows must not be shaken off.
const START_SHARE: f64 = 0.1;
/// Further share of the occluders' rate at a start: a step of theirs changes logits by far more than one of light or materials,
/// and outlines that are sharp already would be shaken off by the noise of small batches.
const START_OCCLUDER_SHARE: f32 = 0.1;
/// Part of a run from a start during which rates rise from zero, until Adam's second moments tell how noisy gradients are.
const WARM_UP: f64 = 0.02;
/// What rates fall to.
const LAST: f64 = 0.01;
/// When they begin to fall in a run from nothing.
const FALL: f64 = 2.0 / 3.0;

/// The share of the learning rates at a `progress` of [0, 1].
///
/// From nothing: all, then falling to a hundredth over the last third, which lets the noise of small batches average out.
/// From a start: a tenth, falling to a hundredth of that over the whole run.
pub fn share(progress: f64, from_start: bool) -> f32 {
    let share = if from_start {
        let warm = (progress / WARM_UP).min(1.0);
        let fall = ((progress - WARM_UP) / (1.0 - WARM_UP)).max(0.0);
        START_SHARE * warm * LAST.powf(fall)
    } else {
        LAST.powf(((progress - FALL) / (1.0 - FALL)).clamp(0.0, 1.0))
    };
    share as f32
}

/// The shares of one iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Of the rate of light and materials.
    pub own: f32,
    /// Of the rate of occluders.
    pub occluders: f32,
}

/// The shares at a `progress` of [0, 1] with batches of so many pixels.
///
/// Smaller batches than the paper's lower them by the square root of their size (Malladi et al., NeurIPS 2022). Where noise decides the
/// sign of a step, unknowns walk at random as far as their rate allows: masks end up anyhow, and light, whose levels add up, runs away
/// from the albedo. From a start light and materials have a tenth of their rate already, and keep that.
pub fn shares(progress: f64, from_start: bool, pixels: u64) -> Shares {
    let share = share(progress, from_start);
    let of_batch = (pixels as f32 / MOST_PIXELS as f32).sqrt();
    if from_start {
        Shares {
            own: share,
            occluders: share * of_batch * START_OCCLUDER_SHARE,
        }
    } else {
        Shares {
            own: share * of_batch,
            occluders: share * of_batch,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_hold_then_fall_to_a_hundredth() {
        let near = |a: f32, b: f32| (a - b).abs() < 1e-3 * b;
        assert_eq!(share(0.0, false), 1.0);
        assert_eq!(share(0.66, false), 1.0);
        assert!(near(share(5.0 / 6.0, false), 0.1));
        assert!(near(share(1.0, false), 0.01));
    }

    #[test]
    fn a_good_start_is_approached_gently() {
        assert_eq!(share(0.0, true), 0.0);
        let shares: Vec<f32> = (0..=50).map(|i| share(f64::from(i) / 50.0, true)).collect();
        assert!(shares.iter().all(|&s| s <= 0.1));
        assert!(shares[1..].windows(2).all(|w| w[1] < w[0]));
        assert!((shares[50] - 1e-3).abs() < 1e-6);
    }

    #[test]
    fn small_batches_take_short_steps_and_the_papers_its_own() {
        let all = Shares {
            own: 1.0,
            occluders: 1.0,
        };
        assert_eq!(shares(0.0, false, MOST_PIXELS), all);
        let quarter = Shares {
            own: 0.25,
            occluders: 0.25,
        };
        assert_eq!(shares(0.5, false, MOST_PIXELS / 16), quarter);
        let started = shares(0.5, true, MOST_PIXELS / 16);
        assert!((started.own - share(0.5, true)).abs() < 1e-9);
        assert!((started.occluders - 0.025 * started.own).abs() < 1e-9);
    }
}
