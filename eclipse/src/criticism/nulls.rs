//! Captures in which nothing of the table is missing, only finer than the model: what a diagnosis must not call physics.
//!
//! Each is derived from a capture that is a null already: what it holds beyond its base is known, and is no effect.

mod coarse_mesh;
mod fine_texture;
mod more_noise;
pub mod scenes;

use crate::capture::Capture;

/// What a derived null holds that its base does not.
pub trait Structure: Sync {
    /// Its name in reports.
    fn id(&self) -> &'static str;

    /// Changes a capture in place.
    fn derive(&self, capture: &mut Capture);
}

/// Nothing: the base as it is.
struct Plain;

impl Structure for Plain {
    fn id(&self) -> &'static str {
        "plain"
    }

    fn derive(&self, _: &mut Capture) {}
}

/// All of them.
pub fn all() -> [&'static dyn Structure; 4] {
    [
        &Plain,
        &more_noise::MoreNoise,
        &fine_texture::FineTexture,
        &coarse_mesh::CoarseMesh,
    ]
}
