//! How long the work ahead takes, judged by what went before: a run that begins what it cannot end overstays its limit.

use super::{
    super::fast::Stage,
    LEGS, Run,
    schedule::{Place, end_of_steps},
};
use crate::reconstruction::Ended;

/// Steps that a finer stage has to have time for, else a coarse one goes on. After fewer, light is further from the truth than the coarse
/// stage has it in the same time, whose steps take a seventh: of potatoes-lambertian in 80 s, .58 against .46, of spot in 120 s, with time
/// for four steps, .77 against .66.
pub(super) const BEFORE_COARSE: f64 = 12.0;
/// The same where the coarse one is through.
pub(super) const BEFORE_NOTHING: f64 = 4.0;

/// Seconds that parts of the work took when they were last done; zero before, which holds nothing up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// A step, for each unit of [`work`].
    step: f64,
    /// The patches and the tape of a stage.
    stage: f64,
    /// The finer model at the beginning of a round.
    round: f64,
}

impl Pace {
    /// A step of `stage` took so long.
    pub(super) fn step_took(&mut self, stage: &Stage, seconds: f64) {
        self.step = seconds / work(stage);
    }

    /// A stage was prepared in so long.
    pub(super) fn stage_took(&mut self, seconds: f64) {
        self.stage = seconds;
    }

    /// The finer model was computed in so long.
    pub(super) fn round_took(&mut self, seconds: f64) {
        self.round = seconds;
    }

    /// A step of `stage`.
    pub(super) fn step(&self, stage: &Stage) -> f64 {
        self.step * work(stage)
    }

    /// The finer model and the step that it is for.
    pub(super) fn round(&self, stage: &Stage) -> f64 {
        self.round + self.step(stage)
    }

    /// All of `stage` until its first step is done.
    fn stage(&self, stage: &Stage) -> f64 {
        self.stage + self.round(stage)
    }

    /// The same until so many steps are done.
    pub(super) fn until(&self, stage: &Stage, steps: f64) -> f64 {
        self.stage(stage) + (steps - 1.0) * self.step(stage)
    }
}

impl Run<'_> {
    /// A stage of the schedule, no finer than the run's light and plan.
    pub(super) fn stage(&self, index: usize) -> Stage {
        let stage = LEGS[index].stage;
        Stage {
            rows: stage.rows.min(self.settings.grid_rows),
            patches: stage.patches.min(self.plan.patches),
            ..stage
        }
    }

    /// Why no further step may be taken that takes so many seconds.
    pub(super) fn due(&self, place: Place, step: f64) -> Option<Ended> {
        if self.control.stopped() {
            return Some(Ended::Interrupted);
        }
        if self
            .settings
            .iterations
            .is_some_and(|n| self.iteration() >= n)
        {
            return Some(Ended::Iterations);
        }
        // Without a single step there is nothing to show, nor to go on from.
        (self.iteration() > 0 && self.is_too_late_for(place, step)).then_some(Ended::TimeLimit)
    }

    /// Whether what takes so many seconds would end after the time that the stage has.
    pub(super) fn is_too_late_for(&self, place: Place, work: f64) -> bool {
        let Some(limit) = self.settings.time_limit else {
            return false;
        };
        let (mut end, all) = (place.end(limit, self.ready), end_of_steps(limit));
        // Time in which the next stage cannot take steps enough is this one's.
        if !place.is_last_stage()
            && end + self.pace.until(&self.stage(place.stage + 1), BEFORE_COARSE) > all
        {
            end = all;
        }
        self.seconds() + work > end
    }
}

/// What the time of a step grows with: passes over what every patch sees of every direction.
fn work(stage: &Stage) -> f64 {
    let passes = 2 * stage.products + 4;
    (stage.rows.pow(2) * stage.patches * passes) as f64
}

#[cfg(test)]
mod tests {
    use super::{super::LEGS, *};

    #[test]
    fn a_finer_stage_is_expected_to_take_longer() {
        let [coarse, fine] = [0, 1].map(|leg| LEGS[leg].stage);
        let mut pace = Pace::default();
        assert_eq!(pace.stage(&fine), 0.0);
        pace.stage_took(3.0);
        pace.round_took(2.0);
        pace.step_took(&coarse, 1.0);
        assert_eq!(pace.step(&coarse), 1.0);
        // Four times the directions of fifteen eighths of the patches.
        assert!((pace.step(&fine) - 7.5).abs() < 1e-12);
        assert!((pace.round(&fine) - 9.5).abs() < 1e-12);
        assert!((pace.stage(&fine) - 12.5).abs() < 1e-12);
        assert!((pace.until(&fine, 4.0) - 35.0).abs() < 1e-12);
    }
}
