//! What is varied, one thing at a time.

use super::{LAMPS, NOISE, PERSON, ROUGHNESS};
use crate::studies::{bench::Bench, small::Setup};

/// One thing that is varied.
pub(super) struct Sweep {
    /// For files.
    pub name: &'static str,
    /// Along the axis.
    pub label: &'static str,
    /// Of the axis.
    pub logarithmic: bool,
    /// Each value with its case.
    pub points: Vec<(f64, Case)>,
}

/// A capture, and how it is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Case {
    /// The capture.
    pub setup: Setup,
    /// How it is solved.
    pub how: How,
}

/// How a capture is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum How {
    /// By the fast preset, in as many steps as a quick run has time for.
    Fast,
    /// The same in all steps of its coarse stage.
    Longer,
    /// By the paper's algorithm with so many rays from each surface point.
    Rays(u64),
}

impl From<Setup> for Case {
    fn from(setup: Setup) -> Self {
        Self {
            setup,
            how: How::Fast,
        }
    }
}

/// What is varied, and over which values: at a glance, quick, and in full. Quick ones have a third value where a part of the
/// claim is about a trend, but for roughness, whose solves are the longest.
pub(super) fn sweeps(bench: &Bench<'_>) -> Vec<Sweep> {
    let base = Setup::telling(bench.scale);
    let sweep = |name, label, logarithmic, values: [&[f32]; 3], set: &dyn Fn(f32) -> Case| Sweep {
        name,
        label,
        logarithmic,
        points: bench
            .of_scale(values)
            .iter()
            .map(|&value| (in_words(value), set(value)))
            .collect(),
    };
    vec![
        sweep(
            LAMPS,
            "radius of lamps at 1/e, degrees",
            false,
            [
                &[12.0, 30.0],
                &[5.0, 12.0, 30.0],
                &[4.0, 7.0, 12.0, 20.0, 30.0, 45.0],
            ],
            &|lamp| Setup { lamp, ..base }.into(),
        ),
        sweep(
            ROUGHNESS,
            "roughness α (1 is matt)",
            false,
            [&[0.2, 1.0], &[0.2, 1.0], &[0.1, 0.2, 0.35, 0.5, 0.7, 1.0]],
            &|alpha| {
                Setup {
                    alpha: (alpha < 1.0).then_some(alpha),
                    ..base
                }
                .into()
            },
        ),
        sweep(
            PERSON,
            "height of the person, relative",
            false,
            [
                &[1.0, 1.6],
                &[0.5, 1.0, 1.6],
                &[0.3, 0.5, 0.75, 1.0, 1.3, 1.6],
            ],
            &|person| {
                Setup {
                    person: Some(person),
                    ..base
                }
                .into()
            },
        ),
        sweep(
            NOISE,
            "noise σ at a pixel value of 0.75",
            true,
            [
                &[0.005],
                &[0.005, 0.05],
                &[0.001, 0.002, 0.005, 0.01, 0.02, 0.05],
            ],
            &|noise| Setup { noise, ..base }.into(),
        ),
        sweep(
            "rays",
            "secondary rays of the paper's algorithm",
            true,
            [&[4.0], &[4.0, 64.0], &[4.0, 8.0, 16.0, 64.0, 256.0]],
            &|rays| Case {
                setup: Setup::noisy(bench.scale),
                how: How::Rays(rays as u64),
            },
        ),
        // Last: cameras elsewhere have to look anew.
        sweep(
            "images",
            "photographs",
            false,
            [&[6.0], &[24.0, 48.0], &[8.0, 16.0, 32.0, 48.0, 96.0]],
            &|frames| {
                Setup {
                    frames: frames as usize,
                    ..base
                }
                .into()
            },
        ),
    ]
}

/// The number that people read: 0.2, not the nearest one of single precision.
fn in_words(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(value.into())
}
