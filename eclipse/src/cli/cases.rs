//! What commands that diagnose many captures have in common.

use std::{io::Write, path::Path};

use clap::Args;
use serde::Serialize;

use super::{Failure, diagnose::Job, print, shown::ProgressArguments, units};
use crate::settings::Settings;

#[derive(Args, Debug)]
pub(super) struct CaseArguments {
    /// Time for each capture.
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "8m")]
    pub time_limit: f64,
    /// Threads; results do not depend on it [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
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
            mesh: None,
            seed: 0,
            threads: self
                .threads
                .map_or(Settings::default().threads, usize::from),
            style: self.progress.style_of_part(),
        }
    }

    /// Prints what was found, as JSON where that was asked for, else as `text`.
    pub(super) fn print<T: Serialize>(
        &self,
        out: &mut dyn Write,
        found: &T,
        text: impl FnOnce(&T) -> String,
    ) -> Result<(), Failure> {
        let text = if self.json {
            serde_json::to_string_pretty(found).map_err(Failure::failed)? + "\n"
        } else {
            text(found)
        };
        print(out, &text)
    }
}
