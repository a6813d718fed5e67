//! From a capture to light, materials and occluders.

pub mod adam;
pub mod cutout;
pub mod detail;
pub mod fast;
pub mod finish;
pub mod hold_out;
pub mod laplace;
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
pub mod tent;
pub mod transport;
pub mod uncertainty;

pub use run::{ReconstructError, check_light, check_memory, memory, photometric, run};
