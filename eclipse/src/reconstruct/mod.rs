//! From a capture to light, materials and occluders.

pub mod cutout;
pub mod fast;
pub mod least_squares;
pub mod maps;
pub mod model;
pub mod patches;
pub mod transport;
