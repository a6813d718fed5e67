//! The command line: arguments in, exit code out.

mod arguments;
mod cases;
mod completions;
mod diagnose;
mod evaluate;
mod export;
mod inspect;
mod labels;
mod log;
mod man;
mod nulls;
mod reconstruct;
mod relight;
mod shown;
mod studies;
mod study;
mod synthesize;
mod units;

pub use labels::{Label, LabelsError, parse_labels};
pub use log::log;
use std::{
    ffi::OsString,
    io::{self, IsTerminal, Write},
    path::Path,
    process::ExitCode,
    sync::{
        Once,
        atomic::{AtomicBool, Ordering},
    },
};

use clap::Parser;

use crate::{
    files::{folder_of, lock::LockError, made::MadeFolder},
    output::{self, OutputError},
    progress,
};
use arguments::{Arguments, Command};
use man::ManArguments;

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Outcome {
    /// Done.
    Done = 0,
    /// Something failed along the way.
    Failed = 1,
    /// The command line was wrong.
    Usage = 2,
    /// The input was bad.
    BadInput = 3,
    /// Interrupted; what was found until then is saved.
    Interrupted = 130,
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        ExitCode::from(outcome as u8)
    }
}

/// A command that failed: how to exit and what to say.
#[derive(Debug)]
struct Failure {
    outcome: Outcome,
    message: String,
}

impl Failure {
    fn failed(error: impl std::fmt::Display) -> Self {
        Self {
            outcome: Outcome::Failed,
            message: error.to_string(),
        }
    }

    fn bad_input(error: impl std::fmt::Display) -> Self {
        Self {
            outcome: Outcome::BadInput,
            message: error.to_string(),
        }
    }

    /// Of the input where that is to blame, else of the work.
    fn of(error: impl std::fmt::Display, input_to_blame: bool) -> Self {
        match input_to_blame {
            true => Self::bad_input(error),
            false => Self::failed(error),
        }
    }
}

/// The right to write to a folder, which is made; one that nothing is written to goes again.
fn taken(folder: &Path) -> Result<MadeFolder, Failure> {
    let made = MadeFolder::make(folder).map_err(|error| match error {
        LockError::Io { path, source } if path == folder => {
            Failure::failed(OutputError::Prepare { path, source })
        }
        error => Failure::failed(error),
    })?;
    output::prepare(folder).map_err(Failure::failed)?;
    Ok(made)
}

/// What to say where `command` was given a folder to work on that it cannot read; where it is `missing` what a run leaves, what it takes.
fn not_of_a_run(
    command: &str,
    folder: &Path,
    error: impl std::fmt::Display,
    missing: bool,
) -> Failure {
    let takes = format!("eclipse {command} takes a folder that `eclipse reconstruct` wrote");
    Failure::bad_input(match missing {
        _ if folder.is_file() => format!(
            "{} is a file, but {takes}; give its own: {}",
            folder.display(),
            folder_of(folder).display()
        ),
        _ if !folder.exists() => format!("there is no folder {}; {takes}", folder.display()),
        true => format!("{error}; {takes}"),
        false => error.to_string(),
    })
}

/// Runs the program with `arguments` (the first is its own name), results to `out`, messages to `err`.
pub fn run(
    arguments: impl IntoIterator<Item = OsString>,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Outcome {
    let (out, err) = (&mut Plain(out), &mut Plain(err));
    let typed: Vec<OsString> = arguments.into_iter().collect();
    let arguments = match Arguments::try_parse_from(&typed) {
        Ok(arguments) => arguments,
        Err(error) => {
            let usage = error.use_stderr();
            let text = error.render();
            let written = if usage {
                write!(err, "{text}")
            } else {
                write!(out, "{text}")
            };
            // With nowhere left to write to, the exit code still tells.
            return if usage || written.is_err() {
                Outcome::Usage
            } else {
                Outcome::Done
            };
        }
    };
    let result = match &arguments.command {
        Command::Reconstruct(arguments) => reconstruct::run(arguments, &typed, out),
        Command::Inspect(arguments) => inspect::run(arguments, out),
        Command::Evaluate(arguments) => evaluate::run(arguments, out),
        Command::Diagnose(arguments) => diagnose::run(arguments, out),
        Command::Study(arguments) => study::run(arguments, &typed, out, err),
        Command::Synthesize(arguments) => synthesize::run(arguments, out),
        Command::Relight(arguments) => relight::run(arguments, out),
        Command::Export(arguments) => export::run(arguments, out),
        Command::Completions(arguments) => completions::run(arguments, out),
        Command::Man(ManArguments {}) => man::run(out),
    };
    let read_by_a_program = arguments.command.progress().is_some_and(|p| p.is_json());
    if read_by_a_program {
        shown::end(&result);
    }
    match result {
        Ok(outcome) => outcome,
        Err(failure) if read_by_a_program => failure.outcome,
        Err(failure) => {
            let _ = writeln!(err, "error: {}", failure.message);
            failure.outcome
        }
    }
}

/// Text without control characters but tabs and the ends of lines: names in files of strangers must not steer a terminal. Others are
/// written as JSON has them, which stays JSON.
struct Plain<'a>(&'a mut dyn Write);

impl Write for Plain<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // Whole words are written here, no parts of characters.
        let text = String::from_utf8_lossy(bytes);
        let mut plain = String::with_capacity(text.len());
        for character in text.chars() {
            match character {
                '\n' | '\t' => plain.push(character),
                _ if character.is_control() => plain += &format!("\\u{:04x}", character as u32),
                _ => plain.push(character),
            }
        }
        self.0.write_all(plain.as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// The flag that the first Ctrl-C sets; the second one ends the program at once.
fn stop_on_interrupt() -> Result<&'static AtomicBool, Failure> {
    static STOP: AtomicBool = AtomicBool::new(false);
    static HANDLED: Once = Once::new();
    let mut result = Ok(());
    HANDLED.call_once(|| {
        result = ctrlc::set_handler(|| {
            if STOP.swap(true, Ordering::Relaxed) {
                progress::restore();
                std::process::exit(Outcome::Interrupted as i32);
            }
            // A step may take a while: whoever waits should know that the key was heard.
            if io::stderr().is_terminal() {
                eprintln!("\rstopping at the end of this step; Ctrl-C again ends at once");
            }
        });
    });
    result.map_err(|error| Failure::failed(format!("cannot listen for Ctrl-C: {error}")))?;
    Ok(&STOP)
}

/// Writes results; a reader that closed the pipe early (`| head`) is no failure.
fn print(out: &mut dyn Write, text: &str) -> Result<(), Failure> {
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::failed(
            format!("cannot write the results: {error}"),
        )),
        _ => Ok(()),
    }
}
