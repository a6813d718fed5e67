//! The command line.

use std::{
    io::{stderr, stdout},
    process::ExitCode,
};

fn main() -> ExitCode {
    eclipse::cli::log();
    eclipse::cli::run(std::env::args_os(), &mut stdout(), &mut stderr()).into()
}
