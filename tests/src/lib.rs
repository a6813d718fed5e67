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

/// Memory in bytes with which the solver divides a surface into some hundred patches and not fifteen hundred: the same steps, in a
/// fraction of the time.
pub const LITTLE_MEMORY: u64 = 320 << 20;
