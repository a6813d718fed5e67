//! How much of the paper's budget an iteration takes here.
//!
//! The paper draws 2 × 2¹⁶ pixels of 1024 rays an iteration on a GPU. The expected gradient is the same for any batch, and
//! Adam gains more from many noisy steps than from few exact ones, so a CPU takes small batches.

use crate::settings::Settings;

/// The paper's pixels an iteration.
pub const MOST_PIXELS: u64 = 1 << 16;
/// The paper's rays from a surface point.
const MOST_RAYS: u64 = 1024;
/// Fewer pixels than this leave most frames without one.
const LEAST_PIXELS: u64 = 512;
/// Rays from a point where time is short.
const LEAST_RAYS: u64 = 32;
/// Pixels without a time limit to derive them from.
const USUAL_PIXELS: u64 = 2048;
/// Samples that one core shades in a second, shadow rays and derivatives included: it scales the batch, no more.
const SAMPLES_PER_SECOND: f64 = 1.5e6;
/// Iterations that a time limit should allow for.
const WANTED_ITERATIONS: f64 = 2500.0;
/// Share of the time limit kept for materials and renders.
const FINISH_SHARE: f64 = 0.12;
/// Memory that a sample takes while an iteration runs, in bytes.
const BYTES_PER_SAMPLE: u64 = 256;
/// Iterations without a limit of either kind.
const USUAL_ITERATIONS: u64 = 10_000;

/// The size of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Pixels, each rendered twice.
    pub pixels: u64,
    /// Rays a render of a pixel: half from the light, half from the material.
    pub rays: u64,
}

impl Plan {
    /// A batch that suits the time limit and stays within the memory. It does not depend on the threads.
    pub fn new(settings: &Settings) -> Self {
        let usual = 2 * USUAL_PIXELS * LEAST_RAYS;
        let affordable = settings.time_limit.map_or(usual, |limit| {
            (limit * SAMPLES_PER_SECOND / WANTED_ITERATIONS) as u64
        });
        let samples = affordable.min(settings.memory / 2 / BYTES_PER_SAMPLE);
        let pixels = (samples / (2 * LEAST_RAYS)).clamp(LEAST_PIXELS, MOST_PIXELS);
        // Pixels first: they tell more than rays do.
        let rays = (samples / (2 * pixels)).clamp(LEAST_RAYS, MOST_RAYS);
        Self { pixels, rays }
    }
}

/// How far a run has come, of [0, 1]: by iterations or by time, whichever is further.
pub fn progress(settings: &Settings, iteration: u64, seconds: f64) -> f64 {
    let by_time = self::seconds(settings).map_or(0.0, |limit| seconds / limit);
    let by_count = iterations(settings).map_or(0.0, |most| iteration as f64 / most as f64);
    by_time.max(by_count).min(1.0)
}

/// The seconds for iterations: the time limit without the share that materials and renders take at the end.
pub fn seconds(settings: &Settings) -> Option<f64> {
    settings
        .time_limit
        .map(|limit| (1.0 - FINISH_SHARE) * limit)
}

/// The most iterations, when time does not limit them.
pub fn iterations(settings: &Settings) -> Option<u64> {
    settings
        .iterations
        .or(settings.time_limit.is_none().then_some(USUAL_ITERATIONS))
}

/// The share of the learning rates at a [`progress`]: all, then falling to a hundredth over the last third, which lets the
/// noise of small batches average out.
pub fn rate(progress: f64) -> f32 {
    let fall = ((progress - 2.0 / 3.0) * 3.0).clamp(0.0, 1.0);
    0.01f64.powf(fall) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_grow_with_time_up_to_the_papers_and_stay_within_memory() {
        let plan = |time_limit, memory| {
            Plan::new(&Settings {
                time_limit,
                memory,
                ..Settings::default()
            })
        };
        let usual = plan(Some(150.0), 4 << 30);
        assert!((1000..4000).contains(&usual.pixels), "{usual:?}");
        let paper = plan(Some(1e7), 1 << 60);
        assert_eq!((paper.pixels, paper.rays), (1 << 16, 1024));
        let small = plan(Some(1e7), 64 << 20);
        assert!(2 * small.pixels * small.rays * BYTES_PER_SAMPLE <= 32 << 20);
    }

    #[test]
    fn rates_hold_then_fall_to_a_hundredth() {
        let settings = Settings {
            time_limit: None,
            iterations: Some(300),
            ..Settings::default()
        };
        assert_eq!(rate(progress(&settings, 200, 1e9)), 1.0);
        assert!((rate(progress(&settings, 250, 0.0)) - 0.1).abs() < 1e-3);
        assert!((rate(progress(&settings, 400, 0.0)) - 0.01).abs() < 1e-6);
    }
}
