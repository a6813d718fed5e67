//! A running solve on the terminal: stage, iteration, loss, samples per second, time left.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::{control::Progress, settings::Settings};

/// Steps of the bar: finer than a terminal is wide.
const STEPS: u64 = 1000;

/// A progress bar on standard error, which shows nothing when that is not a terminal.
pub struct ProgressDisplay {
    bar: ProgressBar,
    time_limit: Option<f64>,
}

impl ProgressDisplay {
    /// A bar for a run with `settings`; `hidden` keeps it off the terminal too.
    pub fn new(settings: &Settings, hidden: bool) -> Self {
        let target = if hidden {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr()
        };
        let bar = ProgressBar::with_draw_target(Some(STEPS), target);
        // The template is constant and known to parse; a plain bar would do as well.
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg}") {
            bar.set_style(style.progress_chars("━╸─"));
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self {
            bar,
            time_limit: settings.time_limit,
        }
    }

    /// Shows where the solve stands.
    pub fn update(&self, progress: &Progress) {
        let share = share(progress, self.time_limit);
        self.bar
            .set_position(share.map_or(0, |share| (share * STEPS as f64) as u64));
        self.bar.set_message(line(progress, self.time_limit));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// A bar on standard error that counts pictures, with the time left; it shows nothing when that is not a terminal.
pub struct PictureDisplay {
    bar: ProgressBar,
    pictures: usize,
}

impl PictureDisplay {
    /// A bar for so many pictures.
    pub fn new(pictures: usize) -> Self {
        let bar = ProgressBar::with_draw_target(
            Some(STEPS * pictures as u64),
            ProgressDrawTarget::stderr(),
        );
        // The template is constant and known to parse; a plain bar would do as well.
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg} · {eta} left") {
            bar.set_style(style.progress_chars("━╸─"));
        }
        Self { bar, pictures }
    }

    /// Shows that picture `index`, from 0, is done by `share`.
    pub fn update(&self, index: usize, share: f32) {
        let step = (share.clamp(0.0, 1.0) * STEPS as f32) as u64;
        self.bar
            .set_message(format!("picture {}/{}", index + 1, self.pictures));
        self.bar.set_position(STEPS * index as u64 + step);
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// The part of the work done: by iterations or by time, whichever ends the run first.
fn share(progress: &Progress, time_limit: Option<f64>) -> Option<f64> {
    let by_iteration = progress
        .iterations
        .map(|all| progress.iteration as f64 / all.max(1) as f64);
    let by_time = time_limit.map(|limit| progress.seconds / limit);
    let share = [by_iteration, by_time]
        .into_iter()
        .flatten()
        .reduce(f64::max)?;
    Some(share.clamp(0.0, 1.0))
}

/// The words beside the bar.
fn line(progress: &Progress, time_limit: Option<f64>) -> String {
    let mut words = vec![progress.stage.to_owned()];
    match progress.iterations {
        Some(all) => words.push(format!("iteration {}/{all}", progress.iteration)),
        None if progress.iteration > 0 => words.push(format!("iteration {}", progress.iteration)),
        None => {}
    }
    if progress.loss.is_finite() {
        words.push(format!("loss {:.5e}", progress.loss));
    }
    if progress.samples_per_second > 0.0 {
        words.push(format!(
            "{:.1} M samples/s",
            progress.samples_per_second / 1e6
        ));
    }
    let share = share(progress, time_limit).filter(|&share| share > 0.0);
    if let Some(share) = share {
        let left = (progress.seconds * (1.0 / share - 1.0)).round() as u64;
        words.push(match left {
            0..60 => format!("{left} s left"),
            _ => format!("{} min {:02} s left", left / 60, left % 60),
        });
    }
    words.join(" · ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress() -> Progress {
        Progress {
            stage: "environment and masks",
            iteration: 10,
            iterations: Some(40),
            loss: 1234.5,
            samples_per_second: 2.34e7,
            seconds: 20.0,
        }
    }

    #[test]
    fn the_line_tells_iteration_loss_rate_and_time_left() {
        let expected =
            "environment and masks · iteration 10/40 · loss 1.23450e3 · 23.4 M samples/s";
        assert_eq!(
            line(&progress(), None),
            format!("{expected} · 1 min 00 s left")
        );
        // The time limit ends the run before the iterations do.
        assert_eq!(
            line(&progress(), Some(40.0)),
            format!("{expected} · 20 s left")
        );
    }

    #[test]
    fn what_is_unknown_is_left_out() {
        let start = Progress {
            stage: "visibility",
            loss: f64::NAN,
            ..Progress::default()
        };
        assert_eq!(line(&start, None), "visibility");
        assert_eq!(share(&start, None), None);
    }

    #[test]
    fn the_share_stays_within_bounds() {
        assert_eq!(
            share(
                &Progress {
                    seconds: 90.0,
                    ..progress()
                },
                Some(60.0)
            ),
            Some(1.0)
        );
        assert_eq!(
            share(
                &Progress {
                    iterations: Some(0),
                    ..progress()
                },
                None
            ),
            Some(1.0)
        );
    }
}
