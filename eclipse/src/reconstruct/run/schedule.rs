//! The order of the work and its shares of the time.

use super::super::fast::Stage;

/// A stage of the work and its rounds.
pub(super) struct Leg {
    /// What it is called in progress.
    pub(super) name: &'static str,
    /// Grid and patches.
    pub(super) stage: Stage,
    /// How many of the silhouette's finest levels are held in each round: its place comes before its outline. A round
    /// begins with fresh data from the finer model.
    pub(super) held: &'static [usize],
}

/// Coarse light on few patches finds its way in seconds; the fine stage then has the rest of the time.
pub(super) const LEGS: [Leg; 2] = [
    Leg {
        name: "coarse light and occluders",
        stage: Stage {
            rows: 25,
            patches: 800,
            members: 8,
            steps: 4,
            products: 25,
        },
        held: &[2, 2, 1, 1],
    },
    Leg {
        name: "fine light and occluders",
        stage: Stage {
            rows: 50,
            patches: 1500,
            members: 4,
            steps: 3,
            products: 25,
        },
        held: &[0; 10],
    },
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
        self.stage + 1 == LEGS.len() && self.round + 1 == self.rounds
    }

    /// Share of the time limit after which its steps end.
    pub(super) fn share(self) -> f64 {
        let (from, to) = if self.stage + 1 < LEGS.len() {
            (0.0, COARSE_SHARE)
        } else {
            (COARSE_SHARE, 1.0 - FINISH_SHARE)
        };
        from + (to - from) * (self.round + 1) as f64 / self.rounds as f64
    }
}
