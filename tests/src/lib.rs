//! Helpers shared by the test files.

pub mod browser;
pub mod capture_turned;
pub mod colmap_model;
pub mod lit_ball;
pub mod on_disk;
pub mod painted;
pub mod perfect;
pub mod planted;
pub mod program;
pub mod scenes;
pub mod small_capture;
pub mod statistics;
pub mod tetrahedron;

use std::io::Write;

use eclipse::settings::Settings;

/// Says that a test was left out, and why, where it is seen: what the macros print of a test that passes is never shown.
pub fn skipped(why: &str) {
    // Whoever closed it does not want to know.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {why}");
}

/// The solver as it is, on a light of fewer texels and a surface in a few hundred patches: the same steps in a fraction of the time.
pub fn coarse() -> Settings {
    Settings {
        time_limit: None,
        grid_rows: 18,
        memory: 256 << 20,
        ..Settings::default()
    }
}
