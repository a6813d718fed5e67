//! What is logged, for whoever looks for the cause of something.

use std::io::stderr;

use tracing_subscriber::EnvFilter;

/// The variable that says what: `debug`, or `eclipse::criticism=debug`; nothing where it is not set.
const LOG: &str = "ECLIPSE_LOG";

/// Logs to standard error what `ECLIPSE_LOG` asks for; a second call changes nothing.
pub fn log() {
    if let Ok(filter) = EnvFilter::try_from_env(LOG) {
        let lines = tracing_subscriber::fmt().with_env_filter(filter);
        // Whoever calls the library may log in a way of their own.
        let _ = lines.with_writer(stderr).try_init();
    }
}
