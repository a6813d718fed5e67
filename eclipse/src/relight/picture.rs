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
/// Most pixels that are worked on at once.
const BAND: usize = 1 << 14;
/// Most samples of them, of some 160 bytes each while they are joined, unless those of a single pixel are more. Random numbers
/// are keyed by pixel and ray, so that it does not matter to the picture which pixels are sampled together.
const BAND_SAMPLES: usize = 1 << 20;
/// Nothing stands in the light but the object: a mask of one value everywhere.
const NO_MASK: LatLong = LatLong::new(1, 2);

/// How good pictures become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quality {
    /// Paths a pixel, about: a multiple of twice the rays is taken. Memory grows with it only where the paths of one ray, a
    /// sixteenth of these, are more than a million.
    pub samples: usize,
    /// Seed of every random number.
    pub seed: u64,
    /// Whether the environment is seen beside the object, which leaves no pixel transparent.
    pub backdrop: bool,
}

impl Quality {
    /// Samples of each of the two kinds, from the light and from the material, of a ray.
    fn samples_of_ray(&self) -> usize {
        self.samples
            .div_ceil(2 * ANTIALIASING * ANTIALIASING)
            .max(1)
    }

    /// Pixels that are worked on at once, so that their samples fit into bounded memory.
    fn pixels_at_once(&self) -> usize {
        (BAND_SAMPLES / self.samples_of_ray().saturating_mul(2)).clamp(1, BAND)
    }
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
    let at_once = quality.pixels_at_once();
    for (band, out) in image.data.chunks_mut(4 * at_once).enumerate() {
        for ray in 0..ANTIALIASING * ANTIALIASING {
            add_ray(stage, camera, frame, quality, band * at_once, ray, out);
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
    let each = quality.samples_of_ray();
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

#[cfg(test)]
mod tests {
    use render::{bsdf::Model, environment::EnvironmentMap, mesh::Mesh};

    use super::*;
    use crate::{mesh_io::MeshSurface, reconstruction::VertexMaterial, relight::Object};

    fn quality(samples: usize) -> Quality {
        Quality {
            samples,
            seed: 3,
            backdrop: false,
        }
    }

    #[test]
    fn samples_in_memory_are_bounded_whatever_is_asked() {
        for samples in [0, 1, 32, 256, 1024, 4096, 100_000, 1_000_000, 1 << 25] {
            let quality = quality(samples);
            let pixels = quality.pixels_at_once();
            assert!((1..=BAND).contains(&pixels));
            let in_memory = pixels * 2 * quality.samples_of_ray();
            assert!(
                in_memory <= BAND_SAMPLES || pixels == 1,
                "{samples}: {in_memory}"
            );
        }
        assert_eq!(quality(256).pixels_at_once(), BAND);
        assert_eq!(quality(usize::MAX).pixels_at_once(), 1);
    }

    #[test]
    fn pixels_look_the_same_whichever_are_sampled_together() {
        let grey = VertexMaterial {
            albedo: [0.6, 0.5, 0.4],
            alpha: 0.3,
            kappa: 0.04,
        };
        let mesh = Mesh::sphere(glam::Vec3::ZERO, 1.0, 12);
        let surface = MeshSurface::Vertices(vec![grey; mesh.positions.len()]);
        let object = Object::new(mesh, surface, Model::Microfacet);
        let ramp = Image {
            width: 16,
            height: 8,
            channels: 3,
            data: (0..16 * 8 * 3).map(|i| (i % 29) as f32 / 10.0).collect(),
        };
        let light = EnvironmentMap::new(ramp).unwrap();
        let stage = Stage::new(object, light, 0.0).unwrap();
        let camera = Camera::look_at(8, 8, 0.6, glam::Vec3::new(4.0, 1.0, 1.0), glam::Vec3::ZERO);
        let quality = quality(96);
        let whole = picture(&stage, &camera, 5, &quality, &|_| true).unwrap();
        let mut parts = Image::filled(8, 8, 4, 0.0);
        for (part, out) in parts.data.chunks_mut(4 * 5).enumerate() {
            for ray in 0..ANTIALIASING * ANTIALIASING {
                add_ray(&stage, &camera, 5, &quality, 5 * part, ray, out);
            }
        }
        assert_eq!(whole, parts);
    }
}
