//! The reference renderer: whole frames in plain numbers, by quadrature over the environment's grid.
//!
//! Each of a pixel's `side`² rays meets the surface elsewhere, and there each texel sends one ray through another of its
//! `side`² parts: footprint and texel are both stratified, for the price of one ray a texel. The error is of second order in
//! the texel's size for smooth integrands; there is no noise.

use glam::Vec3;
use rayon::prelude::*;

use crate::bsdf::{Material, Model};
use crate::bvh::{Bvh, Sight, SurfacePoint};
use crate::camera::Camera;
use crate::environment::EnvironmentMap;
use crate::image::Image;
use crate::lat_long::LatLong;
use crate::occluder::mask_lookup;
use crate::transport::{Quadrature, footprint};

/// A renderer of one object under one environment.
pub struct Reference<'a> {
    bvh: &'a Bvh,
    model: Model,
    quadrature: Quadrature,
    side: usize,
    /// `[texel][ray]`: radiance × solid angle.
    light: Vec<[f32; 3]>,
    /// Which ray each texel starts with, so that a texel's part and a pixel's part are not correlated.
    rotation: Vec<u8>,
}

/// An occluder map of one frame: transmittance (1 = light passes) seen from the origin, and its shell's radius.
#[derive(Clone, Copy, Debug)]
pub struct Mask<'a> {
    /// One channel in the convention of [`LatLong`].
    pub transmittance: &'a Image,
    /// Radius of the shell; the camera's distance by default.
    pub radius: f32,
}

impl<'a> Reference<'a> {
    /// A renderer with `side`² rays a pixel (4 gives 16-fold antialiasing).
    pub fn new(bvh: &'a Bvh, environment: &EnvironmentMap, model: Model, side: usize) -> Self {
        Self::with_radiance(
            bvh,
            environment.grid(),
            |d| environment.radiance(d),
            model,
            side,
        )
    }

    /// A renderer under any distant light: `radiance` of unit directions, integrated on `grid`.
    pub fn with_radiance(
        bvh: &'a Bvh,
        grid: LatLong,
        radiance: impl Fn(Vec3) -> [f32; 3],
        model: Model,
        side: usize,
    ) -> Self {
        let quadrature = Quadrature::new(grid, side);
        let rays = quadrature.rays();
        let light = (0..grid.len() * rays)
            .map(|i| {
                let solid_angle = quadrature.solid_angle(i / rays, i % rays);
                radiance(quadrature.direction(i / rays, i % rays)).map(|l| l * solid_angle)
            })
            .collect();
        let rotation = (0..grid.len())
            .map(|t| (t.wrapping_mul(2_654_435_761) >> 7 & 0xff) as u8)
            .collect();
        Self {
            bvh,
            model,
            quadrature,
            side,
            light,
            rotation,
        }
    }

    /// A frame: RGB and the share of the pixel that the object covers. Rays that miss the object count as black.
    pub fn frame(
        &self,
        camera: &Camera,
        mask: Option<Mask>,
        material: impl Fn(&SurfacePoint) -> Material + Sync,
    ) -> Image {
        let mut image = Image::filled(camera.width, camera.height, 4, 0.0);
        let pixels = image.data.par_chunks_exact_mut(4).enumerate();
        pixels.for_each_init(Sight::default, |sight, (p, out)| {
            let pixel = [p % camera.width, p / camera.width];
            out.copy_from_slice(&self.pixel_with(sight, camera, pixel, mask, &material));
        });
        image
    }

    /// One pixel of [`frame`](Self::frame).
    pub fn pixel(
        &self,
        camera: &Camera,
        pixel: [usize; 2],
        mask: Option<Mask>,
        material: impl Fn(&SurfacePoint) -> Material,
    ) -> [f32; 4] {
        self.pixel_with(&mut Sight::default(), camera, pixel, mask, &material)
    }

    fn pixel_with(
        &self,
        sight: &mut Sight,
        camera: &Camera,
        pixel: [usize; 2],
        mask: Option<Mask>,
        material: &impl Fn(&SurfacePoint) -> Material,
    ) -> [f32; 4] {
        let mut sum = [0.0; 4];
        for (part, (point, outgoing)) in footprint(self.bvh, camera, pixel, self.side).enumerate() {
            let open = sight.look(self.bvh, &point, self.directions(part));
            let radiance =
                self.radiance(&point, outgoing, part, |t| open[t], mask, &material(&point));
            self.add(&mut sum, radiance);
        }
        sum
    }

    /// What the rays of every pixel meet, and what is seen from there: most of the work of a [`frame`](Self::frame), and the same
    /// under any light, mask and material.
    pub fn look(&self, camera: &Camera) -> Looks {
        let pixels = (0..camera.width * camera.height).into_par_iter();
        let pixels = pixels.map_init(Sight::default, |sight, p| {
            let pixel = [p % camera.width, p / camera.width];
            let points = footprint(self.bvh, camera, pixel, self.side).enumerate();
            points
                .map(|(part, (point, outgoing))| {
                    let open = sight.look(self.bvh, &point, self.directions(part));
                    let words = open.chunks(64).map(|bits| {
                        let bits = bits.iter().enumerate();
                        bits.fold(0, |word, (k, open)| word | u64::from(*open) << k)
                    });
                    Look {
                        point,
                        outgoing,
                        open: words.collect(),
                    }
                })
                .collect()
        });
        Looks {
            size: [camera.width, camera.height],
            pixels: pixels.collect(),
        }
    }

    /// The same frame as [`frame`](Self::frame) from what a renderer of the same object, grid and rays a pixel has looked at.
    pub fn frame_of(
        &self,
        looks: &Looks,
        mask: Option<Mask>,
        material: impl Fn(&SurfacePoint) -> Material + Sync,
    ) -> Image {
        let [width, height] = looks.size;
        let mut image = Image::filled(width, height, 4, 0.0);
        let pixels = image.data.par_chunks_exact_mut(4).zip(&looks.pixels);
        pixels.for_each(|(out, looks)| {
            let mut sum = [0.0; 4];
            for (part, look) in looks.iter().enumerate() {
                let open = |t: usize| look.open[t / 64] >> (t % 64) & 1 == 1;
                let material = material(&look.point);
                let radiance =
                    self.radiance(&look.point, look.outgoing, part, open, mask, &material);
                self.add(&mut sum, radiance);
            }
            out.copy_from_slice(&sum);
        });
        image
    }

    /// A ray's share of its pixel.
    fn add(&self, pixel: &mut [f32; 4], radiance: [f32; 3]) {
        let share = 1.0 / (self.side * self.side) as f32;
        for c in 0..3 {
            pixel[c] += share * radiance[c];
        }
        pixel[3] += share;
    }

    /// The ray that a texel sends from the `part`-th place of a pixel.
    fn ray(&self, texel: usize, part: usize) -> usize {
        (part + usize::from(self.rotation[texel])) % self.quadrature.rays()
    }

    /// Where those rays go, texel after texel.
    fn directions(&self, part: usize) -> impl Iterator<Item = Vec3> {
        let texels = 0..self.quadrature.grid().len();
        texels.map(move |texel| self.quadrature.direction(texel, self.ray(texel, part)))
    }

    /// Radiance leaving a surface point towards `outgoing`, with the `part`-th ray of every texel that is `open`.
    fn radiance(
        &self,
        point: &SurfacePoint,
        outgoing: Vec3,
        part: usize,
        open: impl Fn(usize) -> bool,
        mask: Option<Mask>,
        material: &Material,
    ) -> [f32; 3] {
        let rays = self.quadrature.rays();
        let mut sum = [0.0; 3];
        for texel in (0..self.quadrature.grid().len()).filter(|&texel| open(texel)) {
            let ray = self.ray(texel, part);
            let direction = self.quadrature.direction(texel, ray);
            let passed = mask.map_or(1.0, |m| {
                let grid = LatLong::new(m.transmittance.height, m.transmittance.width);
                mask_lookup(grid, point.position, direction, m.radius).gather(&m.transmittance.data)
            });
            let f = self
                .model
                .evaluate(material, point.normal, direction, outgoing);
            let light = self.light[texel * rays + ray];
            let cosine = point.normal.dot(direction);
            for c in 0..3 {
                // A texel sends one of its rays, which stands for them all.
                sum[c] += light[c] * rays as f32 * passed * f[c] * cosine;
            }
        }
        sum
    }
}

/// What the rays of a frame's pixels meet and see, see [`Reference::look`]. It takes a bit a texel and ray.
#[derive(Clone, Debug)]
pub struct Looks {
    /// Pixels across and down.
    size: [usize; 2],
    /// `[pixel][place]`, places on the object only.
    pixels: Vec<Vec<Look>>,
}

/// A place that a pixel sees.
#[derive(Clone, Debug)]
struct Look {
    point: SurfacePoint,
    /// Towards the camera.
    outgoing: Vec3,
    /// Which texels are seen from there by the ray that is theirs, a bit each.
    open: Box<[u64]>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    #[test]
    fn looks_give_the_frame_of_any_light_and_mask_bit_for_bit() {
        let mut mesh = Mesh::sphere(Vec3::ZERO, 1.0, 12);
        mesh.append(&Mesh::sphere(1.2 * Vec3::X, 0.6, 12));
        let bvh = Bvh::new(&mesh).unwrap();
        let grid = LatLong::new(9, 18);
        let of = |radiance: fn(Vec3) -> [f32; 3], model| {
            Reference::with_radiance(&bvh, grid, radiance, model, 2)
        };
        let camera = Camera::look_at(12, 9, 0.9, Vec3::new(3.0, 2.0, 1.0), Vec3::ZERO);
        let looks = of(|_| [1.0; 3], Model::Lambertian).look(&camera);
        let mut transmittance = Image::filled(8, 4, 1, 1.0);
        transmittance.data[..12].fill(0.2);
        let mask = Mask {
            transmittance: &transmittance,
            radius: 4.0,
        };
        let material = |point: &SurfacePoint| Material {
            albedo: [0.5 + 0.3 * point.position.z; 3],
            alpha: 0.4,
            kappa: 0.04,
        };
        for model in [Model::Lambertian, Model::Microfacet] {
            let reference = of(|d| [d.x.abs(), 1.0 + d.y, 0.3], model);
            for mask in [None, Some(mask)] {
                let looked = reference.frame_of(&looks, mask, material);
                let frame = reference.frame(&camera, mask, material);
                assert_eq!(looked.data, frame.data);
                assert!(frame.data.iter().any(|value| *value > 0.1));
            }
        }
    }
}
