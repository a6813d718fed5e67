//! The command line.

use std::{
    io::{stderr, stdout},
    process::ExitCode,
};

use tracing_subscriber::EnvFilter;

/// What is logged, to standard error, as `debug` or `eclipse::criticism=debug`; nothing where it is not set.
const LOG: &str = "ECLIPSE_LOG";

fn main() -> ExitCode {
    if let Ok(filter) = EnvFilter::try_from_env(LOG) {
        tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(stderr)
            .init();
    }
    eclipse::cli::run(std::env::args_os(), &mut stdout(), &mut stderr()).into()
}
