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
