//! From the optimiser's outcome to everything a run leaves: materials, renders, scores, the network's file.

use std::collections::BTreeMap;

use autodiff::RunError;
use glam::Vec3;
use rayon::prelude::*;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    environment::LightDistribution,
    image::Image,
    lat_long::LatLong,
    path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint},
    visibility::Visibility,
};

use super::{PaperError, PaperSolution, brightness, export, plan, start};
use crate::{
    capture::{Capture, Frame},
    reconstruct::photometric,
    reconstruction::{Metrics, Noise, Reconstruction, VertexMaterial},
    settings::Settings,
};

/// Key of their random numbers: no iteration has it.
const FINAL: u32 = u32::MAX;

/// Everything that is written.
///
/// # Errors
/// When memory does not suffice to evaluate the network.
pub fn finish(
    solution: PaperSolution,
    capture: &Capture,
    bvh: &Bvh,
    settings: &Settings,
    noise: Noise,
) -> Result<Reconstruction, PaperError> {
    let view = View::new(&solution, bvh, plan::final_rays(settings, &capture.frames));
    let frames = capture.frames.iter().enumerate();
    let seen = frames.map(|(t, frame)| view.through(t, frame));
    let seen: Vec<(Image, Image)> = seen.collect::<Result<_, RunError>>()?;
    let (materials, renders): (Vec<Image>, Vec<Image>) = seen.into_iter().unzip();
    let vertices = view.materials(&bvh.mesh().positions)?;
    let vertex_materials = vertices.iter().map(|m| VertexMaterial {
        albedo: m.albedo,
        alpha: m.alpha,
        kappa: m.kappa,
    });
    let vertex_materials = vertex_materials.collect();
    let photometric = photometric(capture, settings, &renders);
    let extra = BTreeMap::from([
        ("iterations".to_owned(), solution.iterations.into()),
        ("seconds".to_owned(), solution.seconds.into()),
    ]);
    let from = settings.from.as_deref();
    let behind = from.and_then(|from| start::fell_behind(from, photometric.psnr));
    Ok(Reconstruction {
        uncertainty: None,
        materials,
        vertex_materials,
        network: Some(export::safetensors(&solution.network)),
        renders,
        metrics: Metrics { photometric, extra },
        noise: Some(noise),
        settings: settings.clone(),
        notes: behind.into_iter().collect(),
        ended: solution.ended,
        environment: solution.environment,
        occluders: solution.masks,
        curve: solution.curve,
    })
}

/// The solution, seen through cameras.
struct View<'a> {
    solution: &'a PaperSolution,
    bvh: &'a Bvh,
    grid: LatLong,
    lights: LightDistribution,
    /// `[texel][frame]`.
    masks: Vec<f32>,
    /// Rays from the light, and as many from the material, of each pixel.
    rays: usize,
}

impl<'a> View<'a> {
    fn new(solution: &'a PaperSolution, bvh: &'a Bvh, rays: usize) -> Self {
        let environment = &solution.environment;
        let grid = LatLong::new(environment.height, environment.width);
        let frames = solution.radii.len();
        let mut masks = vec![1.0; grid.len() * frames];
        for (t, mask) in solution.masks.iter().enumerate() {
            let column = masks.iter_mut().skip(t).step_by(frames);
            column.zip(&mask.data).for_each(|(out, &m)| *out = m);
        }
        Self {
            solution,
            bvh,
            grid,
            lights: LightDistribution::new(grid, &brightness(environment)),
            masks,
            rays,
        }
    }

    /// Materials; where reflectance is Lambertian those it does not use are those of a matte surface.
    fn materials(&self, positions: &[Vec3]) -> Result<Vec<Material>, RunError> {
        let mut materials = self.solution.materials(positions)?;
        if self.solution.model == Model::Lambertian {
            for material in &mut materials {
                (material.alpha, material.kappa) = (1.0, 0.0);
            }
        }
        Ok(materials)
    }

    /// Materials and radiance of every pixel whose centre shows the object.
    fn through(&self, t: usize, frame: &Frame) -> Result<(Image, Image), RunError> {
        let (width, height) = (frame.image.width, frame.image.height);
        let point = |p: usize| {
            let (x, y) = ((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
            let (surface, outgoing) = self.bvh.seen(&frame.camera, x, y)?;
            Some(ShadingPoint {
                surface,
                outgoing,
                frame: t as u32,
                pixel: p as u32,
                cached: 0,
                alpha: 0.5,
            })
        };
        let pixels = 0..width * height;
        let mut points: Vec<ShadingPoint> = pixels.into_par_iter().filter_map(point).collect();
        let positions: Vec<Vec3> = points.iter().map(|p| p.surface.position).collect();
        let materials = self.materials(&positions)?;
        for (point, material) in points.iter_mut().zip(&materials) {
            point.alpha = material.alpha;
        }
        let batch = self.sample(&points);
        let light = &self.solution.environment.data;
        let model = self.solution.model;
        let radiance = materials.par_iter().enumerate().map(|(p, material)| {
            batch
                .radiance(p, model, material, light, &self.masks)
                .map(|v| v as f32)
        });
        let radiance: Vec<[f32; 3]> = radiance.collect();

        let mut images = (
            Image::filled(width, height, 5, 0.0),
            Image::filled(width, height, 3, 0.0),
        );
        for ((point, m), radiance) in points.iter().zip(&materials).zip(&radiance) {
            let (x, y) = (point.pixel as usize % width, point.pixel as usize / width);
            let [r, g, b] = m.albedo;
            let values = [r, g, b, m.alpha, m.kappa];
            images.0.pixel_mut(x, y).copy_from_slice(&values);
            images.1.pixel_mut(x, y).copy_from_slice(radiance);
        }
        Ok(images)
    }

    fn sample(&self, points: &[ShadingPoint]) -> PathBatch {
        let scene = PathScene {
            bvh: self.bvh,
            visibility: Visibility::Rays,
            model: self.solution.model,
            lights: &self.lights,
            environment_grid: self.grid,
            mask_grid: self.grid,
            radii: &self.solution.radii,
        };
        let settings = PathSettings {
            light_samples: self.rays,
            material_samples: self.rays,
            seed: 0,
            iteration: FINAL,
            lookup: Lookup::Bilinear,
            render: 0,
        };
        PathBatch::sample(&scene, points, &settings)
    }
}
