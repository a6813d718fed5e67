//! From a capture to light, materials and occluders.

pub mod adam;
pub mod cutout;
pub mod detail;
pub mod fast;
pub mod finish;
pub mod hold_out;
pub mod least_squares;
pub mod lobe;
pub mod model;
pub mod noise;
pub mod paper;
pub mod patches;
pub mod pyramid;
pub mod run;
pub mod shading;
pub mod shell;
pub mod sites;
pub mod sky;
pub mod surface;
pub mod transport;

pub use run::{ReconstructError, check_light, memory, photometric, run};
