//! The order of the work and its shares of the time.

use super::super::fast::Stage;

/// Coarse light on few patches finds its way in seconds; the fine stage then has the rest of the time. Each has a number
/// of rounds, which begin with fresh data from the finer model, and takes its steps in each.
pub(super) const STAGES: [(&str, Stage, usize); 2] = [
    (
        "coarse light and occluders",
        Stage {
            rows: 25,
            patches: 800,
            members: 8,
            steps: 4,
            products: 25,
        },
        5,
    ),
    (
        "fine light and occluders",
        Stage {
            rows: 50,
            patches: 2000,
            members: 4,
            steps: 3,
            products: 25,
        },
        8,
    ),
];
/// The damping with which a later round begins: near the solution, but on changed data.
pub(super) const SECOND_DAMPING: f32 = 1.0;
/// Share of the time limit after which the coarse stage ends.
pub(super) const COARSE_SHARE: f64 = 0.3;
/// Share of the time limit kept for materials and images.
pub(super) const FINISH_SHARE: f64 = 0.15;

/// Where in the schedule a run stands.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) stage: usize,
    pub(super) round: usize,
    pub(super) rounds: usize,
}

impl Place {
    pub(super) fn is_last(self) -> bool {
        self.stage + 1 == STAGES.len() && self.round + 1 == self.rounds
    }

    /// Share of the time limit after which its steps end.
    pub(super) fn share(self) -> f64 {
        let (from, to) = if self.stage + 1 < STAGES.len() {
            (0.0, COARSE_SHARE)
        } else {
            (COARSE_SHARE, 1.0 - FINISH_SHARE)
        };
        from + (to - from) * (self.round + 1) as f64 / self.rounds as f64
    }
}
