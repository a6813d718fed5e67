//! The pixels of an iteration, and the surface their rays meet.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    path::ShadingPoint,
    sampler::SampleKey,
};

use crate::capture::Frame;

/// Share of a pixel that must show the object for the model, which has no background, to explain it.
pub const COVERED: f32 = 0.999;
/// Points seen flatter than this (cosine) are where the mesh's normals and its shape disagree most.
const FLATTEST: f32 = 0.02;
/// Dimensions of [`SampleKey`] beyond those of the paths.
const CHOICE: u32 = 100;
const PLACE: u32 = 101;

/// A pixel that can be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pixel {
    /// Frame index.
    pub frame: u32,
    /// Row-major index in it.
    pub index: u32,
    /// Cell of the surface that it shows.
    pub cell: u32,
}

/// All pixels of `frames` that show the object alone and are `used`.
pub fn pixels(
    bvh: &Bvh,
    frames: &[Frame],
    used: &(dyn Fn(usize, u32) -> bool + Sync),
) -> Vec<Pixel> {
    let of_frame = |(t, frame): (usize, &Frame)| -> Vec<Pixel> {
        (0..frame.mask.data.len() as u32)
            .into_par_iter()
            .filter(|&p| frame.mask.data[p as usize] > COVERED && used(t, p))
            .filter(|&p| seen(bvh, frame, p, [0.5, 0.5]).is_some())
            .map(|index| Pixel {
                frame: t as u32,
                index,
                cell: 0,
            })
            .collect()
    };
    frames.iter().enumerate().flat_map(of_frame).collect()
}

/// The surface at the centres of `pixels`.
pub fn centres<'a>(
    bvh: &Bvh,
    frames: &[Frame],
    pixels: impl Iterator<Item = &'a Pixel>,
) -> Vec<SurfacePoint> {
    let centre = |pixel: &&Pixel| {
        let frame = &frames[pixel.frame as usize];
        seen(bvh, frame, pixel.index, [0.5, 0.5]).map(|(surface, _)| surface)
    };
    let pixels: Vec<&Pixel> = pixels.collect();
    pixels.par_iter().filter_map(centre).collect()
}

/// The pixels of an iteration: `count` of `pixels`, drawn alike.
pub fn choose(pixels: &[Pixel], count: u64, seed: u64, iteration: u64) -> Vec<Pixel> {
    let mut stream = SampleKey {
        seed,
        sample: iteration as u32,
        dimension: CHOICE,
        ..SampleKey::default()
    }
    .stream();
    (0..count)
        .map(|_| {
            // One number has 24 bits, a capture may have more pixels.
            let [a, b] = stream.uniform_2d().map(f64::from);
            let place = (a + b / f64::from(1 << 24)) * pixels.len() as f64;
            pixels[(place as usize).min(pixels.len() - 1)]
        })
        .collect()
}

/// The photographs' values at `pixels`, `[channel][pixel]`.
pub fn photographs(frames: &[Frame], pixels: &[Pixel]) -> Vec<f32> {
    let value = |c: usize, p: &Pixel| frames[p.frame as usize].image.data[3 * p.index as usize + c];
    (0..3)
        .flat_map(|c| pixels.iter().map(move |p| value(c, p)))
        .collect()
}

/// What a random ray through each pixel's footprint meets, for one of the two renders.
pub fn points(
    bvh: &Bvh,
    frames: &[Frame],
    pixels: &[Pixel],
    seed: u64,
    iteration: u64,
    render: u32,
) -> Vec<ShadingPoint> {
    let point = |pixel: &Pixel| {
        let key = SampleKey {
            seed,
            frame: pixel.frame,
            pixel: pixel.index,
            sample: iteration as u32,
            dimension: PLACE + render,
        };
        let frame = &frames[pixel.frame as usize];
        let place = key.stream().uniform_2d();
        // A ray that slips past the object's rim, where masks and mesh disagree, is replaced by the central one.
        let (surface, outgoing) = seen(bvh, frame, pixel.index, place)
            .or_else(|| seen(bvh, frame, pixel.index, [0.5, 0.5]))?;
        Some(ShadingPoint {
            surface,
            outgoing,
            frame: pixel.frame,
            pixel: pixel.index,
            cached: pixel.cell,
            alpha: 0.5,
        })
    };
    pixels.par_iter().filter_map(point).collect()
}

fn seen(bvh: &Bvh, frame: &Frame, index: u32, [u, v]: [f32; 2]) -> Option<(SurfacePoint, Vec3)> {
    let width = frame.image.width;
    let (x, y) = (index as usize % width, index as usize / width);
    bvh.seen(&frame.camera, x as f32 + u, y as f32 + v)
        .filter(|(point, outgoing)| {
            point
                .normal
                .dot(*outgoing)
                .min(point.geometric_normal.dot(*outgoing))
                > FLATTEST
        })
}
