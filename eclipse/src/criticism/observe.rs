//! The data of a diagnosis: sites of the surface, each looked up in every frame that sees it well, and the dark background.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    image::Image,
    lat_long::LatLong,
    sampler::SampleKey,
};

use super::{
    split::{self, Place},
    statistics::normal_cdf,
};
use crate::{capture::Capture, reconstruction::Noise};

/// Views more oblique than this (cosine) are left out: footprints and shading normals are least right there.
const GRAZING: f32 = 0.3;
/// A site seen in fewer frames says nothing that its own albedo does not explain.
const LEAST_VIEWS: usize = 3;
/// Places that see less of the sky than this are within seams of the mesh, and their light is a matter of its details.
const LEAST_OPEN: f32 = 0.05;
/// Share of a value left to the model's own error before anything is known about it.
const MODEL_ERROR: f32 = 0.006;
/// Share of the local second difference left to footprints.
const FOOTPRINT: f32 = 0.15;

/// A place on the surface.
#[derive(Clone, Copy, Debug)]
pub struct Site {
    /// Where, with its normals.
    pub point: SurfacePoint,
    /// The part of the surface it belongs to.
    pub place: Place,
}

/// What one frame shows at one site.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The site.
    pub site: u32,
    /// The frame.
    pub frame: u32,
    /// Place in the image, pixels.
    pub at: [f32; 2],
    /// Linear RGB, interpolated.
    pub value: [f32; 3],
    /// Variance of the value.
    pub variance: [f32; 3],
}

/// A part of the background of a frame, where the model says that there is no light at all.
#[derive(Clone, Copy, Debug)]
pub struct Dark {
    /// The frame.
    pub frame: u32,
    /// Its middle, pixels.
    pub at: [f32; 2],
    /// Mean, linear RGB, freed of the bias of values cut off at zero.
    pub value: [f32; 3],
    /// Variance of the mean.
    pub variance: [f32; 3],
    /// Which patch of the image, for the split.
    pub patch: u32,
}

/// Everything a diagnosis looks at.
pub struct Observations {
    /// Places on the surface.
    pub sites: Vec<Site>,
    /// Their views, ordered by site, then frame.
    pub views: Vec<View>,
    /// Where the views of each site start, and their number.
    pub offsets: Vec<usize>,
    /// Parts of the background; empty where it is not dark.
    pub dark: Vec<Dark>,
    /// Camera centres.
    pub eyes: Vec<Vec3>,
    /// How many frames.
    pub frames: usize,
    /// How many patches of surface.
    pub patches: usize,
    /// Distance between sites.
    pub spacing: f32,
}

impl Observations {
    /// About `count` sites of the capture's surface and what its frames show of them.
    pub fn gather(capture: &Capture, bvh: &Bvh, noise: &Noise, count: usize, seed: u64) -> Self {
        let (points, spacing) = scatter(bvh, count, seed);
        let points: Vec<SurfacePoint> = points
            .into_par_iter()
            .filter(|point| openness(bvh, point) > LEAST_OPEN)
            .collect();
        let views: Vec<Vec<View>> = points
            .par_iter()
            .map(|point| views_of(capture, bvh, noise, point))
            .collect();
        let (points, mut views): (Vec<SurfacePoint>, Vec<Vec<View>>) = points
            .into_iter()
            .zip(views)
            .filter(|(_, views)| views.len() >= LEAST_VIEWS)
            .unzip();
        for (site, views) in views.iter_mut().enumerate() {
            views.iter_mut().for_each(|view| view.site = site as u32);
        }
        let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
        let (places, patches) = split::places(&positions);
        let mut offsets = vec![0];
        for views in &views {
            offsets.push(offsets[offsets.len() - 1] + views.len());
        }
        Self {
            sites: points
                .into_iter()
                .zip(places)
                .map(|(point, place)| Site { point, place })
                .collect(),
            views: views.concat(),
            offsets,
            dark: background(capture),
            eyes: capture.frames.iter().map(|f| f.camera.centre()).collect(),
            frames: capture.frames.len(),
            patches,
            spacing,
        }
    }

    /// Views of the surface and parts of the background together.
    pub fn len(&self) -> usize {
        self.views.len() + self.dark.len()
    }

    /// Whether there is nothing to look at.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The frame of observation `i`, views first.
    pub fn frame(&self, i: usize) -> u32 {
        match self.views.get(i) {
            Some(view) => view.frame,
            None => self.dark[i - self.views.len()].frame,
        }
    }

    /// Its place in the image.
    pub fn at(&self, i: usize) -> [f32; 2] {
        match self.views.get(i) {
            Some(view) => view.at,
            None => self.dark[i - self.views.len()].at,
        }
    }

    /// Its value and variance.
    pub fn value(&self, i: usize) -> ([f32; 3], [f32; 3]) {
        match self.views.get(i) {
            Some(view) => (view.value, view.variance),
            None => {
                let dark = &self.dark[i - self.views.len()];
                (dark.value, dark.variance)
            }
        }
    }

    /// The distance of every view's site from its camera.
    pub fn distance(&self, view: &View) -> f32 {
        self.eyes[view.frame as usize].distance(self.sites[view.site as usize].point.position)
    }
}

/// About which share of the directions above a point is free of the object.
fn openness(bvh: &Bvh, point: &SurfacePoint) -> f32 {
    let grid = LatLong::new(10, 20);
    let (mut open, mut all) = (0.0, 0.0);
    for texel in 0..grid.len() {
        let (row, column) = (texel / grid.columns, texel % grid.columns);
        let direction = grid.texel_direction(row, column);
        let weight = grid.solid_angle(row) * point.normal.dot(direction).max(0.0);
        all += weight;
        if weight > 0.0 && !bvh.occluded(point, direction) {
            open += weight;
        }
    }
    open / all.max(1e-9)
}

/// Points of the surface that keep their distance, drawn by area.
fn scatter(bvh: &Bvh, count: usize, seed: u64) -> (Vec<SurfacePoint>, f32) {
    let mesh = bvh.mesh();
    let areas = mesh.areas();
    let total: f32 = areas.iter().sum();
    let mut cumulative = Vec::with_capacity(areas.len());
    let mut sum = 0.0f64;
    for area in &areas {
        sum += f64::from(*area);
        cumulative.push(sum);
    }
    let spacing = 0.75 * (total / count.max(1) as f32).sqrt();
    let mut stream = SampleKey {
        seed,
        dimension: 71,
        ..SampleKey::default()
    }
    .stream();
    let mut kept: Vec<SurfacePoint> = Vec::new();
    for _ in 0..8 * count {
        let target = f64::from(stream.uniform()) * sum;
        let face = cumulative
            .partition_point(|&c| c < target)
            .min(areas.len() - 1);
        let [u, v] = stream.uniform_2d();
        let root = u.sqrt();
        let weights = [1.0 - root, root * (1.0 - v), root * v];
        let corners = mesh.triangle(face);
        let position: Vec3 = (0..3).map(|k| weights[k] * corners[k]).sum();
        let geometric_normal = mesh.face_normal(face);
        let normal: Vec3 = (0..3)
            .map(|k| weights[k] * mesh.normals[mesh.faces[face][k] as usize])
            .sum();
        let normal = normal.try_normalize().unwrap_or(geometric_normal);
        let side = if geometric_normal.dot(normal) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let clear = kept.iter().all(|other| {
            other.position.distance_squared(position) > spacing * spacing
                || other.normal.dot(normal) < 0.3
        });
        if clear && geometric_normal != Vec3::ZERO {
            kept.push(SurfacePoint {
                position,
                normal,
                geometric_normal: side * geometric_normal,
            });
        }
        if kept.len() >= count {
            break;
        }
    }
    (kept, spacing)
}

fn views_of(capture: &Capture, bvh: &Bvh, noise: &Noise, point: &SurfacePoint) -> Vec<View> {
    capture
        .frames
        .iter()
        .enumerate()
        .filter_map(|(t, frame)| {
            let at = seen_at(&frame.camera, bvh, point)?;
            let (value, variance) = look_up(&frame.image, &frame.mask, at, noise)?;
            Some(View {
                site: 0,
                frame: t as u32,
                at,
                value,
                variance,
            })
        })
        .collect()
}

/// Where a camera sees a point well: not hidden, not obliquely, not next to the edge of something nearer.
pub fn seen_at(camera: &Camera, bvh: &Bvh, point: &SurfacePoint) -> Option<[f32; 2]> {
    let to_eye = camera.centre() - point.position;
    let distance = to_eye.length();
    let facing = point.normal.dot(to_eye) / distance;
    if facing < GRAZING || point.geometric_normal.dot(to_eye) < 0.1 * distance {
        return None;
    }
    let [x, y] = camera.project(point.position)?;
    let inside = |v: f32, size: usize| v >= 1.5 && v <= size as f32 - 1.5;
    if !inside(x, camera.width) || !inside(y, camera.height) {
        return None;
    }
    let pixel = distance / camera.focal[0];
    for (dx, dy, reach) in [
        (0.0, 0.0, 0.0),
        (-1.0, -1.0, 2.5),
        (1.0, -1.0, 2.5),
        (-1.0, 1.0, 2.5),
        (1.0, 1.0, 2.5),
    ] {
        let (there, _) = bvh.seen(camera, x + dx, y + dy)?;
        if there.position.distance(point.position) > (reach + 0.1) * pixel / facing {
            return None;
        }
        // Where parts of a mesh run into each other, a place just below the surface would pass for one on it.
        if reach == 0.0 && there.geometric_normal.dot(point.geometric_normal) < 0.8 {
            return None;
        }
    }
    Some([x, y])
}

/// Interpolated value and its variance, where 3 × 3 pixels lie wholly on the object.
fn look_up(
    image: &Image,
    mask: &Image,
    [x, y]: [f32; 2],
    noise: &Noise,
) -> Option<([f32; 3], [f32; 3])> {
    let (cx, cy) = (x as usize, y as usize);
    for j in cy.checked_sub(1)?..=cy + 1 {
        for i in cx.checked_sub(1)?..=cx + 1 {
            if i >= image.width || j >= image.height || mask.pixel(i, j)[0] < 0.999 {
                return None;
            }
        }
    }
    let (u, v) = (x - 0.5, y - 0.5);
    let (i, j) = (u.floor(), v.floor());
    let (fx, fy) = (u - i, v - j);
    let (i, j) = (i as usize, j as usize);
    let weights = [
        (1.0 - fx) * (1.0 - fy),
        fx * (1.0 - fy),
        (1.0 - fx) * fy,
        fx * fy,
    ];
    let squares: f32 = weights.iter().map(|w| w * w).sum();
    let mut value = [0.0; 3];
    let mut variance = [0.0; 3];
    for c in 0..3 {
        let pixel = |i: usize, j: usize| image.pixel(i, j)[c];
        value[c] = weights[0] * pixel(i, j)
            + weights[1] * pixel(i + 1, j)
            + weights[2] * pixel(i, j + 1)
            + weights[3] * pixel(i + 1, j + 1);
        let second = (pixel(cx - 1, cy) - 2.0 * pixel(cx, cy) + pixel(cx + 1, cy)).abs()
            + (pixel(cx, cy - 1) - 2.0 * pixel(cx, cy) + pixel(cx, cy + 1)).abs();
        let sensor = noise.sigma(f64::from(value[c])).powi(2) as f32;
        // The noise's own part of the second difference is not a matter of footprints.
        let footprint = (second * second - 12.0 * sensor).max(0.0);
        variance[c] = squares.max(0.35) * sensor
            + (MODEL_ERROR * value[c]).powi(2)
            + FOOTPRINT.powi(2) * footprint;
    }
    Some((value, variance))
}

/// Blocks of background, when it is dark in most frames: then every bit of light there is the sensor's doing.
fn background(capture: &Capture) -> Vec<Dark> {
    let mut blocks: Vec<(u32, [usize; 2], usize, [Vec<f64>; 3])> = Vec::new();
    let mut bright = 0;
    for (t, frame) in capture.frames.iter().enumerate() {
        let (image, mask) = (&frame.image, &frame.mask);
        let object: f64 = mean_of(image, |p| mask.data[p] > 0.999);
        let size = (image.width.max(image.height) / 24).clamp(3, 32);
        for by in 0..image.height / size {
            for bx in 0..image.width / size {
                let pixels: Vec<usize> = (0..size * size)
                    .map(|k| (by * size + k / size) * image.width + bx * size + k % size)
                    .collect();
                if pixels.iter().any(|&p| mask.data[p] > 0.0) {
                    continue;
                }
                // What lies far from the object says the same again and again.
                let near = near_object(mask, bx * size + size / 2, by * size + size / 2, 12);
                if !near && (bx + 2 * by + t) % 4 != 0 {
                    continue;
                }
                let values =
                    [0, 1, 2].map(|c| pixels.iter().map(|&p| f64::from(image.data[3 * p + c])).collect());
                if mean_of(image, |p| pixels.contains(&p)) > 0.2 * object {
                    bright += 1;
                }
                blocks.push((t as u32, [bx, by], size, values));
            }
        }
    }
    if 5 * bright > blocks.len() {
        return Vec::new();
    }
    let sigma = cut_noise(blocks.iter().flat_map(|block| &block.3));
    blocks
        .into_iter()
        .map(|(frame, [bx, by], size, values)| {
            let mut value = [0.0; 3];
            let mut variance = [0.0; 3];
            for (c, values) in values.iter().enumerate() {
                let n = values.len() as f64;
                let mean = values.iter().sum::<f64>() / n;
                let spread = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
                let (mean, noise) = match sigma {
                    Some(sigma) => (unrectified(mean, sigma), spread.max(sigma * sigma)),
                    None => (mean, spread.max(1e-12)),
                };
                value[c] = mean as f32;
                // A tenth of the noise stands for what the noise's own shape leaves open.
                variance[c] = (noise / n + 0.01 * noise) as f32;
            }
            let middle = |b: usize| (b * size) as f32 + 0.5 * size as f32;
            Dark {
                frame,
                at: [middle(bx), middle(by)],
                value,
                variance,
                patch: (by / 4 * 97 + bx / 4) as u32,
            }
        })
        .collect()
}

/// The noise of a background whose values below zero were cut off; `None` when they were not.
fn cut_noise<'a>(blocks: impl Iterator<Item = &'a Vec<f64>>) -> Option<f64> {
    let mut squares: Vec<f64> = blocks
        .filter_map(|values| {
            let above: Vec<f64> = values.iter().copied().filter(|v| *v > 0.0).collect();
            let cut = values.len() - above.len();
            // Of noise about zero half the values are positive, and their mean square is the variance.
            (5 * cut > values.len() && above.len() > 2)
                .then(|| above.iter().map(|v| v * v).sum::<f64>() / above.len() as f64)
        })
        .collect();
    (squares.len() > 8).then(|| super::statistics::median(&mut squares).sqrt())
}

/// The mean before values below zero were cut off, from the mean after it, for normal noise of deviation `sigma`.
///
/// The mean after it is μ Φ(μ/σ) + σ φ(μ/σ), which grows with μ.
fn unrectified(mean: f64, sigma: f64) -> f64 {
    let after = |mu: f64| {
        let z = mu / sigma;
        let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        mu * normal_cdf(z) + sigma * density
    };
    let (mut low, mut high) = (-2.0 * sigma, mean.max(0.0) + sigma);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if after(middle) < mean {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn mean_of(image: &Image, keep: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for p in (0..image.width * image.height).filter(|&p| keep(p)) {
        sum += (0..3).map(|c| f64::from(image.data[3 * p + c])).sum::<f64>() / 3.0;
        count += 1;
    }
    sum / count.max(1) as f64
}

/// Whether a pixel of the object lies within `reach` along the row or the column.
fn near_object(mask: &Image, x: usize, y: usize, reach: usize) -> bool {
    let hit = |i: usize, j: usize| {
        i < mask.width && j < mask.height && mask.pixel(i, j)[0] > 0.5
    };
    (1..=reach).any(|d| {
        hit(x.wrapping_sub(d), y) || hit(x + d, y) || hit(x, y.wrapping_sub(d)) || hit(x, y + d)
    })
}
