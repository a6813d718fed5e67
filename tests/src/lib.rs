//! Helpers shared by the test files.

pub mod browser;
pub mod capture_turned;
pub mod colmap_model;
pub mod lit_ball;
pub mod painted;
pub mod perfect;
pub mod program;
pub mod scenes;
pub mod small_capture;
pub mod statistics;

use eclipse::settings::Settings;

/// The solver as it is, on a light of fewer texels and a surface in a few hundred patches: the same steps in a fraction of the time.
pub fn coarse() -> Settings {
    Settings {
        time_limit: None,
        grid_rows: 18,
        memory: 256 << 20,
        ..Settings::default()
    }
}
