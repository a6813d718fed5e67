//! The program as a child process: what it is told and what it says.

use std::{
    path::Path,
    process::{Command, Output},
};

/// Runs `program` to its end.
pub fn run(program: &str, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).output().unwrap()
}

/// Runs a study of `program` into a folder, without the real photographs that this machine may have.
pub fn run_study(program: &str, name: &str, out: &Path, arguments: &[&str]) -> Output {
    Command::new(program)
        .env_remove("ECLIPSE_REAL")
        .args(["study", name, "--json", "--threads", "1", "--out"])
        .arg(out)
        .args(arguments)
        .output()
        .unwrap()
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// What it printed.
pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// What it said beside.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}
