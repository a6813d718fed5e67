//! The lobe of an object whose light and occluders are known: what the solver would find if it knew these.

use render::{bvh::Bvh, image::Image, lat_long::LatLong};

use super::super::{StudyError, trial::Trial};
use crate::{
    capture::Capture,
    reconstruct::{
        lobe, noise,
        shading::{Lobe, Masks, Scene},
        shell::Shells,
        surface::{Surface, eyes, sites_for},
    },
    synthesize::BEHIND,
};

/// The lobe that explains a small capture best under its true light and through its true masks, sought as the solver does.
///
/// # Errors
/// An object that cannot be seen.
pub(super) fn lobe(trial: &Trial, seed: u64) -> Result<Lobe, StudyError> {
    let (capture, light) = (&*trial.capture, &trial.light);
    let bvh = Bvh::new(&capture.mesh)?;
    let noise = noise::estimate(&capture.frames);
    let grid = LatLong::new(light.height, light.width);
    let sites = sites_for(&capture.frames);
    let all = |_: usize, _: u32| true;
    let surface = Surface::new(&bvh, &capture.frames, &noise, grid, sites, seed, &all);
    let masks = trial.truth.occluders.as_deref();
    let masks = masks.and_then(|images| stood(capture, images, light.height));
    let scene = Scene {
        grid,
        radiance: &light.data,
        occluders: masks.as_ref(),
        lobe: None,
        eyes: &eyes(&capture.frames),
    };
    Ok(lobe::fit(&scene, &surface))
}

/// Where they stood.
fn stood(capture: &Capture, images: &[Image], light_rows: usize) -> Option<Masks> {
    let first = images.first()?;
    let cameras = capture.frames.iter().map(|frame| &frame.camera);
    let radii: Vec<f32> = cameras.map(|camera| BEHIND * camera.distance()).collect();
    let texels = 0..first.data.len();
    let passed = texels.flat_map(|texel| images.iter().map(move |image| image.data[texel]));
    Some(Masks::new(
        LatLong::new(first.height, first.width),
        light_rows,
        Shells::around(&radii),
        passed.collect(),
    ))
}
