//! Running work on the terminal: stage, iteration, loss, samples per second, time left; or the same as JSON for programs.

mod dashboard;
mod lines;
mod thumbnail;

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

pub use dashboard::{Dashboard, restore};
pub use lines::{Event, Lines, say};

use crate::{control::Progress, settings::Settings};

/// Steps of the bar: finer than a terminal is wide.
const STEPS: u64 = 1000;

/// How work under way is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A bar on standard error, where that is a terminal.
    Bar,
    /// JSON on standard error, a line an event.
    Lines,
    /// Not at all.
    Hidden,
}

impl Style {
    /// A bar of `steps` that shows itself where this style has one.
    fn bar(self, steps: u64, template: &str) -> ProgressBar {
        let target = match self {
            Self::Bar => ProgressDrawTarget::stderr(),
            Self::Lines | Self::Hidden => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(Some(steps), target);
        // The templates are constant and known to parse; a plain bar would do as well.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("━╸─"));
        }
        bar
    }

    fn lines(self) -> Option<Lines> {
        (self == Self::Lines).then(Lines::default)
    }
}

/// A running solve on standard error.
pub struct ProgressDisplay {
    bar: ProgressBar,
    lines: Option<Lines>,
    time_limit: Option<f64>,
}

impl ProgressDisplay {
    /// Of a run with `settings`.
    pub fn new(settings: &Settings, style: Style) -> Self {
        let bar = style.bar(STEPS, "{bar:24} {msg}");
        if style == Style::Bar {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Self {
            bar,
            lines: style.lines(),
            time_limit: settings.time_limit,
        }
    }

    /// Shows where the solve stands.
    pub fn update(&self, progress: &Progress) {
        let share = share(progress, self.time_limit);
        self.bar
            .set_position(share.map_or(0, |share| (share * STEPS as f64) as u64));
        self.bar.set_message(line(progress, self.time_limit));
        if let Some(lines) = &self.lines {
            lines.tell(&Event {
                done: Some(progress.iteration),
                of: progress.iterations,
                share,
                loss: Some(progress.loss).filter(|loss| loss.is_finite()),
                samples_per_second: Some(progress.samples_per_second).filter(|rate| *rate > 0.0),
                seconds: Some(progress.seconds),
                seconds_left: seconds_left(progress, self.time_limit),
                ..Event::stage(progress.stage)
            });
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Pictures counted on standard error, with the time left.
pub struct PictureDisplay {
    bar: ProgressBar,
    lines: Option<Lines>,
    pictures: usize,
}

impl PictureDisplay {
    /// Of so many pictures.
    pub fn new(pictures: usize, style: Style) -> Self {
        Self {
            bar: style.bar(STEPS * pictures as u64, "{bar:24} {msg} · {eta} left"),
            lines: style.lines(),
            pictures,
        }
    }

    /// Shows that picture `index`, from 0, is done by `share`.
    pub fn update(&self, index: usize, share: f32) {
        let step = (share.clamp(0.0, 1.0) * STEPS as f32) as u64;
        self.bar
            .set_message(format!("picture {}/{}", index + 1, self.pictures));
        self.bar.set_position(STEPS * index as u64 + step);
        if let Some(lines) = &self.lines {
            let all = self.pictures.max(1) as f64;
            lines.tell(&Event {
                done: Some(index as u64),
                of: Some(self.pictures as u64),
                share: Some((index as f64 + f64::from(share.clamp(0.0, 1.0))) / all),
                ..Event::stage("pictures")
            });
        }
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

/// Seconds to the end at the pace so far.
fn seconds_left(progress: &Progress, time_limit: Option<f64>) -> Option<f64> {
    let share = share(progress, time_limit).filter(|&share| share > 0.0)?;
    Some(progress.seconds * (1.0 / share - 1.0))
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
    if let Some(left) = seconds_left(progress, time_limit) {
        let left = left.round() as u64;
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
