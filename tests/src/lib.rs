//! Helpers shared by the test files.

pub mod small_capture;
