//! `--progress`: how work under way is shown.

use std::{io::Write, path::Path};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::{Failure, Outcome};
use crate::{
    capture::{Capture, LoadOptions},
    progress::{Event, Lines, Style, say},
};

#[derive(Args, Debug, Default)]
pub(super) struct ProgressArguments {
    /// Work under way, on standard error [default: bar, or none where results are printed as JSON].
    #[arg(long, value_enum, value_name = "STYLE")]
    progress: Option<ProgressName>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ProgressName {
    /// A bar, or messages, for people.
    Bar,
    /// A line of JSON an event, for programs; the last one is {"event":"end","exit_code":…}.
    Json,
    /// Nothing.
    None,
}

impl ProgressArguments {
    /// The style asked for; where none is, results as JSON (`quiet`) mean that nobody watches.
    pub(super) fn style(&self, quiet: bool) -> Style {
        match self.progress {
            Some(ProgressName::Bar) => Style::Bar,
            Some(ProgressName::Json) => Style::Lines,
            Some(ProgressName::None) => Style::Hidden,
            None if quiet => Style::Hidden,
            None => Style::Bar,
        }
    }

    /// The style of one of many pieces of work, which are told by their results: only programs hear of its stages.
    pub(super) fn style_of_part(&self) -> Style {
        match self.style(false) {
            Style::Lines => Style::Lines,
            Style::Bar | Style::Hidden => Style::Hidden,
        }
    }

    /// Whether standard error is read by a program.
    pub(super) fn is_json(&self) -> bool {
        self.progress == Some(ProgressName::Json)
    }
}

/// Tells what is done, stage by stage, where there are no numbers to show.
pub(super) fn tell(style: Style) -> impl Fn(&str) + Send + Sync {
    let lines = Lines::default();
    move |text: &str| match style {
        // A closed standard error is no failure.
        Style::Bar => {
            let _ = writeln!(std::io::stderr(), "{text} …");
        }
        Style::Lines => lines.tell(&Event::stage(text)),
        Style::Hidden => {}
    }
}

/// Says something that nobody should miss, even where progress is not shown.
pub(super) fn warn(style: Style, warning: &str) {
    match style {
        Style::Lines => say(&json!({ "event": "warning", "message": warning })),
        // A closed standard error is no failure.
        Style::Bar | Style::Hidden => {
            let _ = writeln!(std::io::stderr(), "{warning}");
        }
    }
}

/// Says what is chosen where a capture leaves a choice.
pub(super) fn notes_of(capture: &Path, options: &LoadOptions, style: Style) {
    // What cannot be read is told when it is loaded.
    let source = Capture::describe(capture, options).ok();
    for note in source.into_iter().flat_map(|source| source.notes) {
        warn(style, &format!("note: {note}"));
    }
}

/// The last line for programs: how it ended and, where it failed, why.
pub(super) fn end(result: &Result<Outcome, Failure>) {
    let record = match result {
        Ok(outcome) => json!({"event": "end", "exit_code": *outcome as i32}),
        Err(failure) => json!({
            "event": "end", "exit_code": failure.outcome as i32, "error": failure.message,
        }),
    };
    say(&record);
}
