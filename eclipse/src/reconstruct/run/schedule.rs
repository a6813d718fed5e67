//! The order of the work and its shares of the time.

use super::{super::fast::Stage, uncertainty::SHARE as DEVIATIONS};

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
            steps: 6,
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
/// The damping with which a round begins at least: its data have changed. Small steps first, so that light and occluders are
/// found together: a long first step piles light up in the wrong place, and shadows then follow it there.
pub(super) const ROUND_DAMPING: f32 = 300.0;
/// Share of the time limit after which the coarse stage ends.
const COARSE_SHARE: f64 = 0.4;
/// Share that it has at least of what is left when it can begin: from nothing, the fine stage finds nothing.
const LEAST_COARSE_SHARE: f64 = 0.25;
/// Seconds kept for materials and images, with a share of the time limit, which is longer where there is more to do; and what suffices.
const FINISH: (f64, f64, f64) = (3.0, 0.05, 45.0);

/// Where in the schedule a run stands.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) stage: usize,
    pub(super) round: usize,
}

impl Place {
    pub(super) fn is_last_stage(self) -> bool {
        self.stage + 1 == LEGS.len()
    }

    /// Seconds of a limit after which the steps of the stage end, in a run whose first step could begin after `ready` of them.
    pub(super) fn end(self, limit: f64, ready: f64) -> f64 {
        let all = end_of_steps(limit);
        if self.is_last_stage() {
            all
        } else {
            (COARSE_SHARE * all).max(ready + LEAST_COARSE_SHARE * (all - ready).max(0.0))
        }
    }
}

/// Seconds of a limit after which all steps end.
pub(super) fn end_of_steps(limit: f64) -> f64 {
    // Standard deviations come last and take a share of all that was spent before.
    let (least, share, most) = FINISH;
    // Who gives a second has little to be finished, or wants steps all the same.
    let least = least.min(limit / 4.0);
    limit / (1.0 + DEVIATIONS) - (least + share * limit).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_runs_have_time_for_steps() {
        for limit in [0.1, 1.0, 3.0, 10.0, 100.0, 1e4] {
            assert!(end_of_steps(limit) > 0.55 * limit, "{limit}");
        }
    }

    #[test]
    fn the_coarse_stage_has_time_however_late_it_begins() {
        let [coarse, fine] = [0, 1].map(|stage| Place { stage, round: 0 });
        let all = end_of_steps(100.0);
        assert_eq!(fine.end(100.0, 0.0), all);
        assert_eq!(fine.end(100.0, 60.0), all);
        assert_eq!(coarse.end(100.0, 10.0), COARSE_SHARE * all);
        let late = coarse.end(100.0, 60.0);
        assert!(late > 60.0 && late < all);
        // What is over is over.
        assert_eq!(coarse.end(100.0, 100.0), 100.0);
    }
}
