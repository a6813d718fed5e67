//! From a capture to light, materials and occluders.

pub mod cutout;
pub mod fast;
pub mod least_squares;
pub mod model;
pub mod noise;
pub mod patches;
pub mod pyramid;
pub mod shell;
pub mod sky;
pub mod transport;
