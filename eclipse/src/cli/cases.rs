//! What commands that diagnose many captures have in common.

use std::{io::Write, path::Path};

use clap::Args;
use serde::Serialize;

use super::{Failure, Outcome, diagnose::Job, print, shown::ProgressArguments, units};
use crate::{
    capture::LoadOptions,
    files::atomic,
    progress::{Event, Lines, Style},
    settings::Settings,
};

/// The file that holds what was found.
const SCORES: &str = "scores.json";

#[derive(Args, Debug)]
pub(super) struct CaseArguments {
    /// Time for each capture; a bare number is seconds.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = units::duration, default_value = "8m")]
    pub time_limit: f64,
    /// Threads; results do not depend on it [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub progress: ProgressArguments,
}

impl CaseArguments {
    /// The diagnosis of one capture: all effects, the first seed.
    pub(super) fn job<'a>(
        &self,
        capture: &'a Path,
        reconstruction: Option<&'a Path>,
        out: Option<&'a Path>,
    ) -> Job<'a> {
        Job {
            capture,
            reconstruction,
            out,
            time_limit: self.time_limit,
            effects: &[],
            reading: LoadOptions::default(),
            seed: 0,
            threads: self
                .threads
                .map_or(Settings::default().threads, usize::from),
            style: self.progress.style_of_part(),
        }
    }

    /// Prints what was found, as JSON where that was asked for, else as `text`, and keeps it in `folder`; how it ended is how the
    /// command ends.
    pub(super) fn end<T: Serialize>(
        &self,
        out: &mut dyn Write,
        folder: Option<&Path>,
        found: &T,
        text: impl FnOnce(&T) -> String,
        ended: Ended,
    ) -> Result<Outcome, Failure> {
        let whole = Whole {
            found,
            failed: &ended.failed,
            skipped: &ended.skipped,
            interrupted: ended.interrupted,
        };
        let json = serde_json::to_string_pretty(&whole).map_err(Failure::failed)? + "\n";
        let kept = folder.map_or(Ok(()), |folder| {
            let path = folder.join(SCORES);
            atomic::write(&path, |file| file.write_all(json.as_bytes())).map_err(|error| {
                Failure::failed(format!("cannot write {}: {error}", path.display()))
            })
        });
        // Scores of nothing say nothing to people.
        if self.json {
            print(out, &json)?;
        } else if ended.diagnosed > 0 {
            print(out, &text(found))?;
        }
        kept?;
        ended.outcome()
    }
}

/// What is printed for programs, and kept.
#[derive(Serialize)]
struct Whole<'a, T> {
    #[serde(flatten)]
    found: &'a T,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    failed: &'a [Failed],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    skipped: &'a [Skipped],
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    interrupted: bool,
}

/// A capture that has no diagnosis.
#[derive(Serialize)]
struct Failed {
    capture: String,
    problem: String,
    #[serde(skip)]
    outcome: Outcome,
}

/// A capture that was left out, and why.
#[derive(Serialize)]
struct Skipped {
    capture: String,
    problem: &'static str,
}

/// How work on many captures ended: one that fails does not keep the others from it, but the command from success.
#[derive(Default)]
pub(super) struct Ended {
    /// Captures that have a diagnosis.
    pub diagnosed: usize,
    /// Whether somebody asked for the end before all were done.
    pub interrupted: bool,
    failed: Vec<Failed>,
    skipped: Vec<Skipped>,
}

impl Ended {
    /// Counts a capture that failed, and says so at once.
    pub(super) fn fail(
        &mut self,
        capture: &str,
        failure: Failure,
        style: Style,
        err: &mut dyn Write,
    ) {
        let failed = Failed {
            capture: capture.to_owned(),
            problem: failure.message,
            outcome: failure.outcome,
        };
        say(capture, &failed.problem, style, err);
        self.failed.push(failed);
    }

    /// Tells of a capture that is left out; that is no failure.
    pub(super) fn skip(
        &mut self,
        capture: &str,
        problem: &'static str,
        style: Style,
        err: &mut dyn Write,
    ) {
        say(capture, problem, style, err);
        self.skipped.push(Skipped {
            capture: capture.to_owned(),
            problem,
        });
    }

    /// Whether nothing was begun.
    pub(super) fn is_empty(&self) -> bool {
        self.diagnosed == 0 && self.failed.is_empty() && !self.interrupted
    }

    fn outcome(&self) -> Result<Outcome, Failure> {
        let Some(first) = self.failed.first() else {
            return Ok(match self.interrupted {
                true => Outcome::Interrupted,
                false => Outcome::Done,
            });
        };
        let mut message = format!(
            "{} of {} captures were not diagnosed",
            self.failed.len(),
            self.failed.len() + self.diagnosed
        );
        for Failed {
            capture, problem, ..
        } in &self.failed
        {
            message += &format!("\n  {capture}: {problem}");
        }
        let outcome = if self.interrupted {
            Outcome::Interrupted
        } else if self.failed.iter().all(|f| f.outcome == first.outcome) {
            first.outcome
        } else {
            Outcome::Failed
        };
        Err(Failure { outcome, message })
    }
}

/// Says at once why a capture has no diagnosis.
fn say(capture: &str, problem: &str, style: Style, err: &mut dyn Write) {
    let line = format!("{capture} was not diagnosed: {problem}");
    match style {
        // A closed standard error is no failure.
        Style::Bar => {
            let _ = writeln!(err, "{line}");
        }
        Style::Lines => Lines::default().tell(&Event::stage(&line)),
        Style::Hidden => {}
    }
}
