//! Learning rates over a run, as shares of the paper's.

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

/// The occluders' part of [`share`].
pub fn occluder_share(from_start: bool) -> f32 {
    if from_start {
        START_OCCLUDER_SHARE
    } else {
        1.0
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
}
