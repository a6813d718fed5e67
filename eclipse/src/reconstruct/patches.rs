//! The data of the second-order solver: patches of surface, each seen in many frames.
//!
//! A patch gathers all pixels whose centre looks at it, so that its mean over a frame has little noise and its transport,
//! averaged over the very places the pixels look at, has no error from footprints. Pixels on the silhouette and at grazing
//! angles are left out: there the model error is largest.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    sampler::SampleKey,
};

use crate::{capture::Frame, reconstruction::Noise};

/// Pixels whose normal is further than this from the view direction (cosine) are not fitted.
pub const GRAZING: f32 = 0.3;

/// A pixel that takes part in the fit.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Row-major index in its frame.
    pub pixel: u32,
    /// The surface at a jittered place within the pixel.
    pub point: SurfacePoint,
    /// Linear RGB.
    pub value: [f32; 3],
}

/// A part of the surface about as large as a few pixels.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Mean position of its members.
    pub position: Vec3,
    /// Mean shading normal, of unit length.
    pub normal: Vec3,
    /// Places pixels look at, spread over frames.
    pub members: Vec<SurfacePoint>,
}

/// What one frame saw of one patch.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The patch.
    pub patch: u32,
    /// The frame.
    pub frame: u32,
    /// Mean of its pixels, linear RGB.
    pub value: [f32; 3],
    /// One over the variance of `value`.
    pub weight: [f32; 3],
    /// How many pixels.
    pub pixels: u32,
}

/// Patches and their views, ordered by patch, then frame.
#[derive(Clone, Debug)]
pub struct Observations {
    /// Parts of the surface.
    pub patches: Vec<Patch>,
    /// Their views.
    pub views: Vec<View>,
    /// For every frame and pixel the patch it looks at; `u32::MAX` for none.
    pub patch_of_pixel: Vec<Vec<u32>>,
    /// The distance that patches keep from each other.
    pub spacing: f32,
}

/// How the surface is divided.
#[derive(Clone, Copy, Debug)]
pub struct PatchOptions {
    /// About how many patches.
    pub count: usize,
    /// Members kept for each patch's transport.
    pub members: usize,
    /// Share of a value left to model error: added in quadrature to the noise of a view.
    pub model_error: f32,
}

/// Pixels of a frame that can be fitted: well inside the object and not at a grazing angle.
pub fn sights(bvh: &Bvh, frame: &Frame, seed: u64, index: usize) -> Vec<Sight> {
    let width = frame.image.width;
    (0..frame.image.height * width)
        .into_par_iter()
        .filter(|&p| frame.mask.data[p] > 0.999)
        .filter_map(|p| {
            let mut stream = SampleKey {
                seed,
                frame: index as u32,
                pixel: p as u32,
                ..SampleKey::default()
            }
            .stream();
            let [u, v] = stream.uniform_2d();
            let (x, y) = ((p % width) as f32 + u, (p / width) as f32 + v);
            let (point, to_camera) = bvh.seen(&frame.camera, x, y)?;
            let facing = point.normal.dot(to_camera) > GRAZING
                && point.geometric_normal.dot(to_camera) > 0.05;
            let value = frame.image.pixel(p % width, p / width);
            facing.then(|| Sight {
                pixel: p as u32,
                point,
                value: [value[0], value[1], value[2]],
            })
        })
        .collect()
}

impl Observations {
    /// Divides the surface that `frames` see into patches and averages the photographs over them.
    ///
    /// `used` tells for each frame and pixel whether it may be fitted.
    pub fn gather(
        bvh: &Bvh,
        frames: &[Frame],
        noise: &Noise,
        options: &PatchOptions,
        seed: u64,
        used: &(dyn Fn(usize, u32) -> bool + Sync),
    ) -> Self {
        let sights: Vec<Vec<Sight>> = frames
            .iter()
            .enumerate()
            .map(|(t, frame)| sights(bvh, frame, seed, t))
            .collect();
        let all: Vec<&SurfacePoint> = sights.iter().flatten().map(|s| &s.point).collect();
        let seeds = Seeds::scatter(&all, options.count, seed);
        let patch_of: Vec<Vec<u32>> = sights
            .iter()
            .map(|list| list.par_iter().map(|s| seeds.nearest(&s.point)).collect())
            .collect();
        let mut members: Vec<Vec<SurfacePoint>> = vec![Vec::new(); seeds.points.len()];
        for (list, patch) in sights.iter().zip(&patch_of) {
            for (sight, &patch) in list.iter().zip(patch) {
                members[patch as usize].push(sight.point);
            }
        }
        let patches = members
            .into_iter()
            .zip(&seeds.points)
            .map(|(members, seed)| Patch::new(members, seed, options.members))
            .collect::<Vec<_>>();
        let patch_of_pixel = sights
            .iter()
            .zip(&patch_of)
            .zip(frames)
            .map(|((list, patch), frame)| {
                let mut of = vec![u32::MAX; frame.image.width * frame.image.height];
                list.iter()
                    .zip(patch)
                    .for_each(|(sight, &patch)| of[sight.pixel as usize] = patch);
                of
            })
            .collect();
        let views = average(
            &sights,
            &patch_of,
            patches.len(),
            noise,
            options.model_error,
            used,
        );
        Self {
            patches,
            views,
            patch_of_pixel,
            spacing: seeds.spacing,
        }
    }

    /// Where the views of each patch start, and their number last.
    pub fn offsets(&self) -> Vec<u32> {
        let mut offsets = vec![0; self.patches.len() + 1];
        for view in &self.views {
            offsets[view.patch as usize + 1] += 1;
        }
        for p in 0..self.patches.len() {
            offsets[p + 1] += offsets[p];
        }
        offsets
    }
}

impl Patch {
    fn new(all: Vec<SurfacePoint>, seed: &SurfacePoint, keep: usize) -> Self {
        let count = all.len().min(keep);
        let members: Vec<SurfacePoint> = (0..count).map(|i| all[i * all.len() / count]).collect();
        let members = if members.is_empty() {
            vec![*seed]
        } else {
            members
        };
        let mean = |part: fn(&SurfacePoint) -> Vec3| {
            members.iter().map(part).sum::<Vec3>() / members.len() as f32
        };
        Self {
            position: mean(|p| p.position),
            normal: mean(|p| p.normal).try_normalize().unwrap_or(seed.normal),
            members,
        }
    }
}

#[derive(Clone, Copy, Default)]
struct Moments {
    pixels: u32,
    sum: [f64; 3],
    squares: [f64; 3],
}

fn average(
    sights: &[Vec<Sight>],
    patch_of: &[Vec<u32>],
    patches: usize,
    noise: &Noise,
    model_error: f32,
    used: &(dyn Fn(usize, u32) -> bool + Sync),
) -> Vec<View> {
    let mut cells: Vec<(u32, u32, Moments)> = sights
        .par_iter()
        .zip(patch_of)
        .enumerate()
        .flat_map_iter(|(t, (list, patch))| {
            let mut cells: HashMap<u32, Moments> = HashMap::new();
            for (sight, &patch) in list.iter().zip(patch) {
                if used(t, sight.pixel) {
                    let cell = cells.entry(patch).or_default();
                    cell.pixels += 1;
                    for c in 0..3 {
                        cell.sum[c] += f64::from(sight.value[c]);
                        cell.squares[c] += f64::from(sight.value[c]).powi(2);
                    }
                }
            }
            cells
                .into_iter()
                .map(move |(patch, cell)| (patch, t as u32, cell))
        })
        .collect();
    cells.sort_unstable_by_key(|&(patch, frame, _)| (patch, frame));
    let spread = relative_spread(&cells, patches);
    cells
        .iter()
        .map(|&(patch, frame, cell)| {
            let n = f64::from(cell.pixels);
            let value: [f64; 3] = std::array::from_fn(|c| cell.sum[c] / n);
            let weight = std::array::from_fn(|c| {
                let within = noise
                    .sigma(value[c])
                    .powi(2)
                    .max(spread[patch as usize] * value[c].powi(2));
                (1.0 / (within / n + (f64::from(model_error) * value[c]).powi(2) + 1e-12)) as f32
            });
            View {
                patch,
                frame,
                value: value.map(|v| v as f32),
                weight,
                pixels: cell.pixels,
            }
        })
        .collect()
}

/// The relative variance of the pixels within one view of a patch, pooled over the patch's views: what is left of shading
/// and texture inside it, together with the noise.
fn relative_spread(cells: &[(u32, u32, Moments)], patches: usize) -> Vec<f64> {
    let mut within = vec![0.0; patches];
    let mut mean = vec![1e-12; patches];
    for (patch, _, cell) in cells.iter().filter(|(.., cell)| cell.pixels > 1) {
        let n = f64::from(cell.pixels);
        for c in 0..3 {
            let average = cell.sum[c] / n;
            within[*patch as usize] += n * (cell.squares[c] / n - average * average).max(0.0);
            mean[*patch as usize] += (n - 1.0) * average * average;
        }
    }
    let mut spread: Vec<f64> = within
        .iter()
        .zip(&mean)
        .map(|(w, m)| if *m > 1e-9 { w / m } else { f64::NAN })
        .collect();
    let mut known: Vec<f64> = spread.iter().copied().filter(|s| s.is_finite()).collect();
    known.sort_unstable_by(f64::total_cmp);
    let typical = known.get(known.len() / 2).copied().unwrap_or(0.01);
    spread
        .iter_mut()
        .filter(|s| !s.is_finite())
        .for_each(|s| *s = 4.0 * typical);
    spread
}

/// Points of the surface that keep their distance, in position and normal together.
struct Seeds {
    points: Vec<SurfacePoint>,
    spacing: f32,
    cells: HashMap<IVec3, Vec<u32>>,
}

impl Seeds {
    /// Dart throwing over `points`; the spacing is searched until about `count` remain.
    fn scatter(points: &[&SurfacePoint], count: usize, seed: u64) -> Self {
        let mut order: Vec<usize> = (0..points.len()).collect();
        let mut stream = SampleKey {
            seed,
            frame: u32::MAX,
            ..SampleKey::default()
        }
        .stream();
        for i in (1..order.len()).rev() {
            let j = ((stream.uniform() * (i + 1) as f32) as usize).min(i);
            order.swap(i, j);
        }
        let low = points
            .iter()
            .map(|p| p.position)
            .reduce(Vec3::min)
            .unwrap_or_default();
        let high = points
            .iter()
            .map(|p| p.position)
            .reduce(Vec3::max)
            .unwrap_or_default();
        let mut spacing = ((high - low).length().max(1e-6)).powi(2) / (count.max(1) as f32);
        spacing = spacing.sqrt();
        let mut seeds = Self::throw(points, &order, spacing);
        for _ in 0..6 {
            let ratio = seeds.points.len() as f32 / count.max(1) as f32;
            if (0.93..1.07).contains(&ratio) {
                break;
            }
            spacing *= ratio.sqrt().clamp(0.5, 2.0);
            seeds = Self::throw(points, &order, spacing);
        }
        seeds
    }

    fn throw(points: &[&SurfacePoint], order: &[usize], spacing: f32) -> Self {
        let mut seeds = Self {
            points: Vec::new(),
            spacing,
            cells: HashMap::new(),
        };
        for &i in order {
            let free = seeds.around(points[i].position, 1).all(|s| {
                distance(&seeds.points[s as usize], points[i], spacing) >= spacing * spacing
            });
            if free {
                let cell = seeds.cell(points[i].position);
                seeds
                    .cells
                    .entry(cell)
                    .or_default()
                    .push(seeds.points.len() as u32);
                seeds.points.push(*points[i]);
            }
        }
        seeds
    }

    fn cell(&self, position: Vec3) -> IVec3 {
        (position / self.spacing).floor().as_ivec3()
    }

    fn around(&self, position: Vec3, reach: i32) -> impl Iterator<Item = u32> + '_ {
        let centre = self.cell(position);
        let side = -reach..=reach;
        side.clone()
            .flat_map(move |x| {
                side.clone().flat_map({
                    let side = side.clone();
                    move |y| side.clone().map(move |z| IVec3::new(x, y, z))
                })
            })
            .filter_map(move |offset| self.cells.get(&(centre + offset)))
            .flatten()
            .copied()
    }

    fn nearest(&self, point: &SurfacePoint) -> u32 {
        self.around(point.position, 2)
            .min_by(|&a, &b| {
                let d = |s: u32| distance(&self.points[s as usize], point, self.spacing);
                d(a).total_cmp(&d(b)).then(a.cmp(&b))
            })
            .unwrap_or(0)
    }
}

/// Squared distance in position and, on the scale of the spacing, in normal.
fn distance(a: &SurfacePoint, b: &SurfacePoint, spacing: f32) -> f32 {
    a.position.distance_squared(b.position)
        + spacing * spacing * a.normal.distance_squared(b.normal)
}
