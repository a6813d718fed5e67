//! The reference renderer: whole frames in plain numbers, by quadrature over the environment's grid.
//!
//! Each of a pixel's `side`² rays meets the surface elsewhere, and there each texel sends one ray through another of its
//! `side`² parts: footprint and texel are both stratified, for the price of one ray a texel. The error is of second order in
//! the texel's size for smooth integrands; there is no noise.

use glam::Vec3;
use rayon::prelude::*;

use crate::bsdf::{Material, Model};
use crate::bvh::{Bvh, SurfacePoint, offset_origin};
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
        image
            .data
            .par_chunks_exact_mut(4)
            .enumerate()
            .for_each(|(p, out)| {
                let pixel = [p % camera.width, p / camera.width];
                out.copy_from_slice(&self.pixel(camera, pixel, mask, &material));
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
        let mut sum = [0.0; 4];
        let share = 1.0 / (self.side * self.side) as f32;
        for (s, (point, outgoing)) in footprint(self.bvh, camera, pixel, self.side).enumerate() {
            let radiance = self.radiance(&point, outgoing, s, mask, &material(&point));
            for c in 0..3 {
                sum[c] += share * radiance[c];
            }
            sum[3] += share;
        }
        sum
    }

    /// Radiance leaving a surface point towards `outgoing`, with the `part`-th ray of every texel.
    fn radiance(
        &self,
        point: &SurfacePoint,
        outgoing: Vec3,
        part: usize,
        mask: Option<Mask>,
        material: &Material,
    ) -> [f32; 3] {
        let rays = self.quadrature.rays();
        let origin = offset_origin(point);
        let mut sum = [0.0; 3];
        for texel in 0..self.quadrature.grid().len() {
            let ray = (part + usize::from(self.rotation[texel])) % rays;
            let direction = self.quadrature.direction(texel, ray);
            let cosine = point.normal.dot(direction);
            let above = cosine > 0.0 && point.geometric_normal.dot(direction) > 0.0;
            if !above || self.bvh.blocked(origin, direction) {
                continue;
            }
            let passed = mask.map_or(1.0, |m| {
                let grid = LatLong::new(m.transmittance.height, m.transmittance.width);
                mask_lookup(grid, point.position, direction, m.radius).gather(&m.transmittance.data)
            });
            let f = self
                .model
                .evaluate(material, point.normal, direction, outgoing);
            let light = self.light[texel * rays + ray];
            for c in 0..3 {
                // A texel sends one of its rays, which stands for them all.
                sum[c] += light[c] * rays as f32 * passed * f[c] * cosine;
            }
        }
        sum
    }
}
