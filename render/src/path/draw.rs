//! Draws the samples of a run of points.

use glam::Vec3;

use super::{Corners, Lookup, PathBatch, PathScene, PathSettings, ShadingPoint};
use crate::bsdf::{MaterialSampler, Model, power_heuristic};
use crate::lat_long::{Bilinear, LatLong};
use crate::occluder::mask_lookup;
use crate::sampler::{SampleKey, Stratified, Stream};
use crate::transport::Quadrature;

/// A batch in the making.
///
/// Finished samples wait in a small buffer before they are spread over the batch's arrays: written one by one to twenty
/// arrays that grow alike, they would evict each other from the first-level cache.
pub(super) struct Draw<'a> {
    scene: &'a PathScene<'a>,
    lookup: Lookup,
    batch: PathBatch,
    buffer: Vec<Sample>,
    samples: u32,
}

/// A sample that carries light.
#[derive(Clone, Copy)]
struct Sample {
    incident: f32,
    half: f32,
    difference: f32,
    weight: f32,
    light: Bilinear,
    mask: Bilinear,
}

/// Samples in the buffer: 5 KB.
const BUFFER: usize = 64;

impl<'a> Draw<'a> {
    pub(super) fn new(scene: &'a PathScene<'a>, lookup: Lookup) -> Self {
        let buffer = Vec::with_capacity(BUFFER);
        Self {
            scene,
            lookup,
            batch: PathBatch::empty(lookup),
            buffer,
            samples: 0,
        }
    }

    pub(super) fn finish(mut self) -> PathBatch {
        self.flush();
        self.batch
    }

    /// Draws the light and material samples of a point.
    pub(super) fn monte_carlo(&mut self, point: &ShadingPoint, settings: &PathSettings) {
        let normal = point.surface.normal;
        let sampler = MaterialSampler::new(self.scene.model, point.alpha, normal, point.outgoing);
        let (lights, materials) = (
            settings.light_samples as f32,
            settings.material_samples as f32,
        );
        let mut numbers = stream(point, settings, 0);
        Stratified::new(settings.light_samples).for_each(|set, cell| {
            let light = self
                .scene
                .lights
                .sample_texel(set.point_in(cell, numbers.uniform_2d()));
            let (direction, uv) = (light.direction, light.coordinates);
            if self.lit(point, direction, uv) {
                let texels = self.read(&mut numbers, uv, Some(light.texel));
                let density = self.light_density(&texels, direction);
                let other = if materials > 0.0 {
                    sampler.density(direction)
                } else {
                    0.0
                };
                let weight =
                    power_heuristic(lights, density, materials, other) / (lights * density);
                self.push(point, direction, weight, texels, &mut numbers);
            }
        });
        let mut numbers = stream(point, settings, 1);
        Stratified::new(settings.material_samples).for_each(|set, cell| {
            let place = set.point_in(cell, numbers.uniform_2d());
            let direction = sampler.sample(place, &mut numbers);
            let uv = LatLong::coordinates(direction);
            if self.lit(point, direction, uv) {
                let texels = self.read(&mut numbers, uv, None);
                let density = sampler.density(direction);
                let other = if lights > 0.0 {
                    self.light_density(&texels, direction)
                } else {
                    0.0
                };
                let weight =
                    power_heuristic(materials, density, lights, other) / (materials * density);
                // A density of zero leaves 0/0: such a direction is drawn by rounding alone.
                let weight = if density > 0.0 { weight } else { 0.0 };
                self.push(point, direction, weight, texels, &mut numbers);
            }
        });
        self.end_point(point);
    }

    /// Takes every direction of a quadrature.
    pub(super) fn quadrature(&mut self, point: &ShadingPoint, quadrature: &Quadrature) {
        for texel in 0..quadrature.grid().len() {
            for ray in 0..quadrature.rays() {
                let direction = quadrature.direction(texel, ray);
                let uv = LatLong::coordinates(direction);
                if self.lit(point, direction, uv) {
                    let texels = self.scene.environment_grid.bilinear_at(uv[0], uv[1]);
                    let mut unused = SampleKey::default().stream();
                    self.push(
                        point,
                        direction,
                        quadrature.solid_angle(texel, ray),
                        texels,
                        &mut unused,
                    );
                }
            }
        }
        self.end_point(point);
    }

    /// Whether light from a direction reaches the point and leaves it towards the camera.
    #[inline]
    fn lit(&self, point: &ShadingPoint, direction: Vec3, uv: [f32; 2]) -> bool {
        let PathScene {
            bvh,
            model,
            visibility,
            ..
        } = self.scene;
        let normal = point.surface.normal;
        normal.dot(direction) > 0.0
            && (*model == Model::Lambertian || normal.dot(point.outgoing) > 0.0)
            && visibility.visible(bvh, &point.surface, point.cached as usize, direction, uv)
    }

    /// The texels of light that a sample reads; a light sample reads the one it was drawn from.
    #[inline]
    fn read(&self, numbers: &mut Stream, uv: [f32; 2], drawn: Option<u32>) -> Bilinear {
        match (self.lookup, drawn) {
            (Lookup::Stochastic, Some(texel)) => one(texel),
            _ => self.choose(
                self.scene.environment_grid.bilinear_at(uv[0], uv[1]),
                numbers,
            ),
        }
    }

    /// All four texels, or one of them by their weights.
    #[inline]
    fn choose(&self, texels: Bilinear, numbers: &mut Stream) -> Bilinear {
        if self.lookup == Lookup::Bilinear {
            return texels;
        }
        let u = numbers.uniform();
        let [a, b, c, _] = texels.weight;
        let corner = usize::from(u >= a) + usize::from(u >= a + b) + usize::from(u >= a + b + c);
        one(texels.index[corner])
    }

    /// The density of light samples, for what a sample reads.
    #[inline]
    fn light_density(&self, texels: &Bilinear, direction: Vec3) -> f32 {
        match self.lookup {
            Lookup::Bilinear => self.scene.lights.density(direction),
            Lookup::Stochastic => self.scene.lights.texel_density(texels.index[0], direction),
        }
    }

    #[inline]
    fn push(
        &mut self,
        point: &ShadingPoint,
        direction: Vec3,
        weight: f32,
        light: Bilinear,
        numbers: &mut Stream,
    ) {
        let (scene, normal) = (self.scene, point.surface.normal);
        let half = (direction + point.outgoing).normalize_or_zero();
        let radius = scene.radii[point.frame as usize];
        let lookup = mask_lookup(scene.mask_grid, point.surface.position, direction, radius);
        let mut mask = self.choose(lookup, numbers);
        mask.index = mask
            .index
            .map(|texel| texel * scene.radii.len() as u32 + point.frame);
        if self.buffer.len() == BUFFER {
            self.flush();
        }
        self.samples += 1;
        self.buffer.push(Sample {
            incident: normal.dot(direction),
            half: normal.dot(half),
            difference: half.dot(direction),
            weight,
            light,
            mask,
        });
    }

    fn end_point(&mut self, point: &ShadingPoint) {
        self.batch
            .outgoing
            .push(point.surface.normal.dot(point.outgoing));
        self.batch.offsets.push(self.samples);
    }

    fn flush(&mut self) {
        let (batch, samples) = (&mut self.batch, &self.buffer);
        batch.incident.extend(samples.iter().map(|s| s.incident));
        batch.half.extend(samples.iter().map(|s| s.half));
        batch
            .difference
            .extend(samples.iter().map(|s| s.difference));
        batch.weight.extend(samples.iter().map(|s| s.weight));
        spread(&mut batch.light, samples, |s| &s.light);
        spread(&mut batch.mask, samples, |s| &s.mask);
        self.buffer.clear();
    }
}

fn spread(corners: &mut Corners, samples: &[Sample], lookup: impl Fn(&Sample) -> &Bilinear) {
    for (k, index) in corners.index.iter_mut().enumerate() {
        index.extend(samples.iter().map(|s| lookup(s).index[k]));
    }
    for (k, weight) in corners.weight.iter_mut().enumerate() {
        weight.extend(samples.iter().map(|s| lookup(s).weight[k]));
    }
}

/// A lookup of one texel.
#[inline]
fn one(texel: u32) -> Bilinear {
    Bilinear {
        index: [texel; 4],
        weight: [1.0, 0.0, 0.0, 0.0],
    }
}

/// The random numbers of one strategy at a point.
fn stream(point: &ShadingPoint, settings: &PathSettings, strategy: u32) -> Stream {
    SampleKey {
        seed: settings.seed,
        frame: point.frame,
        pixel: point.pixel,
        sample: settings.iteration,
        dimension: 2 * settings.render + strategy,
    }
    .stream()
}
