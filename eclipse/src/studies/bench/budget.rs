//! How long a reconstruction of a capture that was given may take.

use std::{cell::OnceCell, time::Instant};

use super::Scale;

/// Seconds for one: at a glance; quick, at most; in full.
const SECONDS: [f64; 3] = [2.0, 120.0, 600.0];
/// Seconds that all of them may take together where everything is quick.
///
/// `study all --quick` is to end within two hours on two cores. With four captures and a real one it makes 24 (`recovery`;
/// `relighting` and `lambertian` use the same, as does `masks`) + 3 (`masks` of free ones, and `time`) + 21 (`time`, most for a part of
/// the limit) + 9 (`real`) = 57 solves: 46 limits, of 80 s then.
const QUICK_BUDGET: f64 = 3660.0;
/// Seconds in which everything is to be over where everything is quick, a little less than two hours. What studies before the first
/// solve of a given capture took, which is longer on a slower machine, is taken from the solves.
const QUICK_END: f64 = 6900.0;
/// Seconds that go to waste for each limit: loading, the last step, scoring, pages, and what is solved beside it.
const AROUND: f64 = 15.0;
/// Seconds that a solve is given however late it is: less shows nothing.
const LEAST: f64 = 20.0;
/// What a quick run solves for, in limits: of each capture with occluders modelled and without; of the one whose quality over
/// time is looked at, beyond that (see `time` and `masks`); of a real one with either assumption on occluders and without.
const QUICK_LIMITS: [f64; 3] = [2.0, 4.25, 3.0];

/// The time of a run of studies.
pub(super) struct Budget {
    began: Instant,
    /// Seconds for a quick solve, the same for all of a run once one has asked: solves are shared.
    share: OnceCell<f64>,
}

impl Budget {
    /// Of a run that begins now.
    pub(super) fn start() -> Self {
        Self {
            began: Instant::now(),
            share: OnceCell::new(),
        }
    }

    /// Seconds for a solve, where all of them together take so many `limits`, which is asked once.
    pub(super) fn seconds(&self, scale: Scale, limits: impl FnOnce() -> f64) -> f64 {
        let [glance, quick, full] = SECONDS;
        let spent = || self.began.elapsed().as_secs_f64();
        match scale {
            Scale::Glance => glance,
            Scale::Quick => *self
                .share
                .get_or_init(|| quick.min(share(limits(), spent()))),
            Scale::Full => full,
        }
    }
}

/// How many times the limit all studies together reconstruct for, with so many captures and maybe a real one.
pub(super) fn limits(captures: usize, real: bool, seeds: u64) -> f64 {
    let [each, over_time, of_real] = QUICK_LIMITS;
    seeds as f64 * (each * captures as f64 + over_time + of_real * f64::from(u8::from(real)))
}

/// Seconds for each of so many limits, when so many seconds are over.
fn share(limits: f64, spent: f64) -> f64 {
    let left = (QUICK_END - spent) / limits - AROUND;
    left.min(QUICK_BUDGET / limits).max(LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_came_before_is_taken_from_solves_so_that_all_ends_in_time() {
        let limits = limits(4, true, 3);
        assert_eq!(limits, 45.75);
        assert_eq!(share(limits, 0.0), 80.0);
        assert_eq!(share(limits, 2500.0), 80.0);
        let late = share(limits, 4000.0);
        assert!(late < 80.0 && 4000.0 + limits * (late + AROUND) <= QUICK_END + 1.0);
        assert_eq!(share(limits, 9000.0), LEAST);
    }

    #[test]
    fn the_first_share_is_everybodys() {
        let budget = Budget::start();
        let first = budget.seconds(Scale::Quick, || 50.0);
        assert_eq!(budget.seconds(Scale::Quick, || 1.0), first);
    }
}
