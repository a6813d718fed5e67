//! The data of a diagnosis: sites of the surface, each looked up in every frame that sees it well, and the dark background.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    image::Image,
};

use super::{
    dark::{Dark, background},
    quantum::Quantum,
    scatter::scatter,
    split::{self, Place},
    statistics::median,
};
use crate::{
    capture::{Capture, Frame},
    reconstruction::Noise,
};

/// Views more oblique than this (cosine) are left out: footprints and shading normals are least right there.
const GRAZING: f32 = 0.3;
/// A site seen in fewer frames says nothing that its own albedo does not explain.
const LEAST_VIEWS: usize = 3;
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
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// How many frames.
    pub frames: usize,
    /// How many patches of surface.
    pub patches: usize,
    /// Distance between sites.
    pub spacing: f32,
    /// Whether the photographs hold no more levels than eight bits have.
    pub eight_bits: bool,
}

impl Observations {
    /// About `count` sites of the capture's surface and what its frames show of them.
    pub fn gather(capture: &Capture, bvh: &Bvh, noise: &Noise, count: usize, seed: u64) -> Self {
        let (points, spacing) = scatter(bvh, count, seed);
        let quantum = Quantum::of(capture.frames.iter().map(|f| &f.image));
        let floor = match quantum {
            Some(_) => (MODEL_ERROR * middle(capture)).powi(2),
            None => 0.0,
        };
        let sensor = Sensor {
            noise,
            quantum: quantum.as_ref(),
            floor,
        };
        let views: Vec<Vec<View>> = points
            .par_iter()
            .map(|point| views_of(capture, bvh, &sensor, point))
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
            dark: background(capture, floor),
            eyes: capture.frames.iter().map(|f| f.camera.centre()).collect(),
            cameras: capture.frames.iter().map(|f| f.camera.clone()).collect(),
            frames: capture.frames.len(),
            patches,
            spacing,
            eight_bits: quantum.is_some(),
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

    /// The unit direction from a view's site to its camera.
    pub fn outgoing(&self, view: &View) -> Vec3 {
        let point = self.sites[view.site as usize].point.position;
        self.cameras[view.frame as usize].direction_from(point)
    }

    /// The distance of every view's site from its camera.
    pub fn distance(&self, view: &View) -> f32 {
        self.eyes[view.frame as usize].distance(self.sites[view.site as usize].point.position)
    }
}

/// What values scatter by.
struct Sensor<'a> {
    noise: &'a Noise,
    quantum: Option<&'a Quantum>,
    /// The least variance. Photographs of eight bits resolve shadows far better than the models of lens, sensor and file do that
    /// they went through: left to their rounding, the darkest values would outweigh all others.
    floor: f32,
}

impl Sensor<'_> {
    /// Variance of a value. Noise larger than a level holds the rounding's already.
    fn variance(&self, value: f32) -> f32 {
        let noise = self.noise.sigma(f64::from(value)).powi(2) as f32;
        let rounding = self.quantum.map_or(0.0, |quantum| quantum.variance(value));
        noise.max(rounding).max(self.floor)
    }
}

/// The middle value of the object.
fn middle(capture: &Capture) -> f32 {
    let inside = |frame: &Frame| -> Vec<f64> {
        let pixels = frame.image.data.chunks_exact(3).zip(&frame.mask.data);
        let inside = pixels.filter(|(_, mask)| **mask > 0.999);
        inside.map(|(p, _)| f64::from(p[1])).collect()
    };
    let mut all: Vec<f64> = capture.frames.iter().flat_map(inside).collect();
    if all.is_empty() {
        return 0.0;
    }
    median(&mut all).max(0.0) as f32
}

fn views_of(capture: &Capture, bvh: &Bvh, sensor: &Sensor, point: &SurfacePoint) -> Vec<View> {
    capture
        .frames
        .iter()
        .enumerate()
        .filter_map(|(t, frame)| {
            let at = seen_at(&frame.camera, bvh, point)?;
            let (value, variance) = look_up(&frame.image, &frame.mask, at, sensor)?;
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
    let to_eye = camera.direction_from(point.position);
    let facing = point.normal.dot(to_eye);
    if facing < GRAZING || point.geometric_normal.dot(to_eye) < 0.1 {
        return None;
    }
    let [x, y] = camera.project(point.position)?;
    let inside = |v: f32, size: usize| v >= 1.5 && v <= size as f32 - 1.5;
    if !inside(x, camera.width) || !inside(y, camera.height) {
        return None;
    }
    let pixel = camera.footprint(point.position);
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
    sensor: &Sensor,
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
        let sensor = sensor.variance(value[c]);
        // The noise's own part of the second difference is not a matter of footprints.
        let footprint = (second * second - 12.0 * sensor).max(0.0);
        variance[c] = squares.max(0.35) * sensor
            + (MODEL_ERROR * value[c]).powi(2)
            + FOOTPRINT.powi(2) * footprint;
    }
    Some((value, variance))
}
