//! One picture by sampled paths.

use std::cell::Cell;

use rayon::prelude::*;
use render::{
    bsdf::Material,
    camera::Camera,
    image::Image,
    lat_long::LatLong,
    path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint},
    visibility::Visibility,
};

use super::Stage;

/// Rays a pixel are the square of this.
pub const ANTIALIASING: usize = 4;
/// Pixels that are worked on at once: samples of these and no more are in memory.
const BAND: usize = 1 << 14;
/// Nothing stands in the light but the object: a mask of one value everywhere.
const NO_MASK: LatLong = LatLong::new(1, 2);

/// How good pictures become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quality {
    /// Paths a pixel, about: a multiple of twice the rays is taken.
    pub samples: usize,
    /// Seed of every random number.
    pub seed: u64,
    /// Whether the environment is seen beside the object, which leaves no pixel transparent.
    pub backdrop: bool,
}

/// Renders `camera`, of the frame whose origin is the object's centre: R, G, B and the share of each pixel that the object
/// covers, colours multiplied by it; `None` when `progress`, told of the share done, asks for the end.
///
/// `frame` keys the random numbers, so that noise does not stand still in a turntable.
pub fn picture(
    stage: &Stage,
    camera: &Camera,
    frame: u32,
    quality: &Quality,
    progress: &dyn Fn(f32) -> bool,
) -> Option<Image> {
    let mut image = Image::filled(camera.width, camera.height, 4, 0.0);
    let pixels = camera.width * camera.height;
    let done = Cell::new(0);
    for (band, out) in image.data.chunks_mut(4 * BAND).enumerate() {
        for ray in 0..ANTIALIASING * ANTIALIASING {
            add_ray(stage, camera, frame, quality, band * BAND, ray, out);
        }
        done.set(done.get() + out.len() / 4);
        if !progress(done.get() as f32 / pixels as f32) {
            return None;
        }
    }
    Some(image)
}

/// Adds the light of ray `ray` of each pixel from `first` on.
fn add_ray(
    stage: &Stage,
    camera: &Camera,
    frame: u32,
    quality: &Quality,
    first: usize,
    ray: usize,
    out: &mut [f32],
) {
    let rays = ANTIALIASING * ANTIALIASING;
    let share = 1.0 / rays as f32;
    let place = |k: usize| (k as f32 + 0.5) / ANTIALIASING as f32;
    let [across, down] = [place(ray % ANTIALIASING), place(ray / ANTIALIASING)];
    let seen = out
        .par_chunks_exact_mut(4)
        .enumerate()
        .filter_map(|(index, out)| {
            let pixel = first + index;
            let x = (pixel % camera.width) as f32 + across;
            let y = (pixel / camera.width) as f32 + down;
            let ray = camera.ray(x, y);
            let Some(hit) = stage.bvh.closest(ray) else {
                if quality.backdrop {
                    let light = stage.environment.radiance(ray.direction);
                    (0..3).for_each(|channel| out[channel] += share * light[channel]);
                    out[3] += share;
                }
                return None;
            };
            out[3] += share;
            let material = stage.object.material(&hit);
            let point = ShadingPoint {
                surface: stage.bvh.surface_point(&hit, ray.direction),
                outgoing: -ray.direction,
                frame: 0,
                pixel: pixel as u32,
                cached: 0,
                alpha: material.alpha,
            };
            Some((point, material))
        });
    let (points, materials): (Vec<ShadingPoint>, Vec<Material>) = seen.unzip();
    let scene = PathScene {
        bvh: &stage.bvh,
        visibility: Visibility::Rays,
        model: stage.object.model,
        lights: stage.environment.distribution(),
        environment_grid: stage.environment.grid(),
        mask_grid: NO_MASK,
        // Where nothing stands, how far away it would is all the same.
        radii: &[1e6 * stage.object.mesh.bounding_radius()],
    };
    let each = quality.samples.div_ceil(2 * rays).max(1);
    let settings = PathSettings {
        light_samples: each,
        material_samples: each,
        seed: quality.seed,
        iteration: ray as u32,
        lookup: Lookup::Bilinear,
        render: frame,
    };
    let batch = PathBatch::sample(&scene, &points, &settings);
    let environment = &stage.environment.image().data;
    let masks = vec![1.0; NO_MASK.len()];
    let light: Vec<[f64; 3]> = (0..points.len())
        .into_par_iter()
        .map(|p| batch.radiance(p, stage.object.model, &materials[p], environment, &masks))
        .collect();
    for (point, light) in points.iter().zip(light) {
        let out = &mut out[4 * (point.pixel as usize - first)..][..3];
        for (out, light) in out.iter_mut().zip(light) {
            *out += share * light as f32;
        }
    }
}
