//! `eclipse study`: a command over many captures, scored.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    io::Write,
    path::{Path, PathBuf},
};

use clap::{Args, Subcommand};

use super::{
    Failure, Outcome,
    cases::{CaseArguments, Ended},
    diagnose,
    labels::{EXPECTED, Label, MAX_LABELS, parse_labels},
    nulls::{self, NullsArguments},
    shown::ProgressArguments,
    stop_on_interrupt,
    studies::{self, PaperStudy},
    taken,
};
use crate::{
    criticism::{
        self,
        oracle::yardstick,
        study_scores::{Case, Scores},
    },
    files::read_limited,
    progress::{Event, Lines, Style},
};

#[derive(Args, Debug)]
pub(super) struct StudyArguments {
    #[command(subcommand)]
    pub command: StudyCommand,
}

#[derive(Subcommand, Debug)]
pub(super) enum StudyCommand {
    /// Diagnoses every capture of a folder and scores the verdicts against labels.
    Mismatch(MismatchArguments),
    /// Counts how often a diagnosis names physics where none is missing, beside finer texture, a coarser mesh, more noise, or where what
    /// is missing has no name here.
    Nulls(NullsArguments),
    #[command(flatten)]
    Paper(PaperStudy),
}

#[derive(Args, Debug)]
pub(super) struct MismatchArguments {
    /// Folder of captures.
    pub captures: PathBuf,
    /// JSON: what each capture's simulation lacks, by its folder's name, such as {"hall": {"effects": ["vignetting"]}, "yard":
    /// {"effects": []}}.
    #[arg(long, value_name = "FILE")]
    pub labels: PathBuf,
    /// Folder whose subfolders hold a reconstruction for each capture [default: made anew].
    #[arg(long, value_name = "DIR")]
    pub reconstructions: Option<PathBuf>,
    /// Folder for a page for each capture and scores.json.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Only captures whose name contains this.
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    #[command(flatten)]
    pub cases: CaseArguments,
}

impl StudyArguments {
    /// How the work is shown.
    pub(super) fn progress(&self) -> &ProgressArguments {
        match &self.command {
            StudyCommand::Mismatch(arguments) => &arguments.cases.progress,
            StudyCommand::Nulls(arguments) => &arguments.cases.progress,
            StudyCommand::Paper(study) => &study.arguments().progress,
        }
    }
}

/// Folders in that of the captures that no label is of, nor lies in; in order.
fn unlabelled(captures: &Path, labels: &BTreeMap<String, Label>) -> Vec<String> {
    let labelled = |name: &str| {
        let mut known = labels.keys();
        known.any(|label| Path::new(label).starts_with(name))
    };
    // A folder that cannot be listed has no captures either, which the labels will tell.
    let entries = std::fs::read_dir(captures).into_iter().flatten().flatten();
    let folders = entries.filter(|entry| entry.path().is_dir());
    let names = folders.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names
        .filter(|name| !name.starts_with('.') && !labelled(name))
        .collect();
    names.sort_unstable();
    names
}

/// Runs what was typed as `typed`.
pub(super) fn run(
    arguments: &StudyArguments,
    typed: &[OsString],
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let arguments = match &arguments.command {
        StudyCommand::Mismatch(arguments) => arguments,
        StudyCommand::Nulls(arguments) => return nulls::run(arguments, out, err),
        StudyCommand::Paper(study) => return studies::run(study, typed, out, err),
    };
    let bytes = read_limited(&arguments.labels, MAX_LABELS).map_err(|error| {
        Failure::bad_input(format!(
            "cannot read the labels {}: {error}; the file holds what each capture's simulation lacks, by its folder's name: {}",
            arguments.labels.display(),
            EXPECTED
        ))
    })?;
    let labels = parse_labels(&bytes, &arguments.labels).map_err(Failure::bad_input)?;
    let stop = stop_on_interrupt()?;
    let _lock = arguments.out.as_deref().map(taken).transpose()?;
    let style = arguments.cases.progress.style(false);
    let lines = Lines::default();
    let (mut cases, mut ended) = (Vec::new(), Ended::default());
    let wanted = |name: &str| {
        let part = arguments.only.as_ref();
        part.is_none_or(|part| name.contains(part))
    };
    for name in unlabelled(&arguments.captures, &labels) {
        let folder = Some(arguments.captures.join(&name));
        let ours = folder == arguments.out || folder == arguments.reconstructions;
        if wanted(&name) && !ours {
            ended.skip(&name, "the labels do not name it", style, err);
        }
    }
    for (index, (name, label)) in labels.iter().enumerate() {
        if style == Style::Lines {
            lines.tell(&Event {
                done: Some(index as u64),
                of: Some(labels.len() as u64),
                ..Event::stage(name)
            });
        }
        let folder = arguments.captures.join(name);
        if !wanted(name) {
            continue;
        }
        if !folder.is_dir() {
            ended.skip(name, "there is no such folder", style, err);
            continue;
        }
        let own = |base: &Option<PathBuf>| base.as_ref().map(|base| base.join(name));
        let (reconstruction, page) = (own(&arguments.reconstructions), own(&arguments.out));
        let job = arguments.cases.job(
            &folder,
            reconstruction.as_deref().filter(|r: &&Path| r.is_dir()),
            page.as_deref(),
        );
        let mut measure = None;
        let mut told = |outcome: &criticism::Outcome<'_>| {
            measure = yardstick(outcome, &label.effects)?;
            Ok(())
        };
        let diagnosis = match diagnose::diagnose(&job, stop, &mut told) {
            Ok(Some(diagnosis)) => diagnosis,
            Ok(None) => {
                ended.interrupted = true;
                break;
            }
            Err(failure) => {
                ended.fail(name, failure, style, err);
                continue;
            }
        };
        let case = Case::new(name, &label.effects, &diagnosis, measure);
        if style == Style::Bar {
            let _ = writeln!(err, "{}", case.line());
        }
        cases.push(case);
        ended.diagnosed += 1;
    }
    if ended.is_empty() {
        return Err(Failure::bad_input(format!(
            "no folder in {} has a name that the labels know",
            arguments.captures.display()
        )));
    }
    let (scores, folder) = (Scores::new(cases), arguments.out.as_deref());
    arguments
        .cases
        .end(out, folder, &scores, Scores::table, ended)
}
