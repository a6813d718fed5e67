//! Captures in which none of the table's effects is missing: what a diagnosis must not give a name to.
//!
//! Each is derived from a capture that is a null already: what it holds beyond its base is known. That is nothing, or structure
//! finer than the model, or physics that no effect describes.

mod banding;
mod coarse_mesh;
mod fine_texture;
mod flash;
mod ghost;
mod lens_distortion;
mod more_noise;
pub mod scenes;
mod stain;

use std::{fs, path::Path};

use render::{
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    transport::footprint,
};

use crate::{
    capture::{self, Capture, CaptureError},
    checkpoint::fingerprint,
    files::read_limited,
};

/// The file of a derived capture that holds the fingerprint of its base.
const BASE: &str = "base.fingerprint";

/// What a diagnosis should say of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing is missing.
    Plain,
    /// Nothing is missing, although the model is coarser than the recording.
    Structured,
    /// Something is missing, but no effect that is known: no name is right.
    Outside,
}

/// What a derived capture holds that its base does not.
pub trait Structure: Sync {
    /// Its name in reports.
    fn id(&self) -> &'static str;

    /// What it is.
    fn kind(&self) -> Kind;

    /// Changes a capture in place.
    fn derive(&self, capture: &mut Capture);
}

/// Nothing: the base as it is.
struct Plain;

impl Structure for Plain {
    fn id(&self) -> &'static str {
        "plain"
    }

    fn kind(&self) -> Kind {
        Kind::Plain
    }

    fn derive(&self, _: &mut Capture) {}
}

/// The mean of `of` over what of the surface a pixel sees, by `side` × `side` rays; `None` beside it.
fn mean_seen(
    bvh: &Bvh,
    camera: &Camera,
    pixel: [usize; 2],
    side: usize,
    of: impl Fn(&SurfacePoint) -> f32,
) -> Option<f32> {
    let seen = footprint(bvh, camera, pixel, side);
    let (sum, count) = seen.fold((0.0, 0), |(sum, count), (point, _)| {
        (sum + of(&point), count + 1)
    });
    (count > 0).then(|| sum / count as f32)
}

/// Writes to `folder` what `structure` makes of `base`, unless it is there already, derived from the same capture.
///
/// # Errors
/// [`CaptureError`]: a folder that cannot be written, or holds anything but a capture.
pub fn derive_into(
    folder: &Path,
    mut base: Capture,
    structure: &dyn Structure,
) -> Result<(), CaptureError> {
    let failed = |source| CaptureError::Write {
        path: folder.to_owned(),
        source,
    };
    let mark = format!("{:016x}\n", fingerprint(&base));
    let path = folder.join(BASE);
    if read_limited(&path, mark.len() as u64).is_ok_and(|found| found == mark.as_bytes()) {
        return Ok(());
    }
    structure.derive(&mut base);
    // Derived from another base, or from one that was edited since.
    if folder.join("transforms.json").is_file() {
        fs::remove_dir_all(folder).map_err(failed)?;
    }
    capture::write_with(folder, &base, |staging| {
        fs::write(staging.join(BASE), &mark).map_err(failed)
    })
}

/// All of them.
pub fn all() -> [&'static dyn Structure; 9] {
    [
        &Plain,
        &more_noise::MoreNoise,
        &fine_texture::FineTexture,
        &coarse_mesh::CoarseMesh,
        &banding::Banding,
        &flash::Flash,
        &ghost::Ghost,
        &lens_distortion::LensDistortion,
        &stain::Stain,
    ]
}
