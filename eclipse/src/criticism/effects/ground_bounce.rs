//! A support that reflects light up to the object.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use rayon::prelude::*;
use render::lat_long::LatLong;

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// A level plane below the object: its albedo, for three heights. Its light falls off where the object shades it.
pub struct GroundBounce;

/// Cells of the plane across, within `REACH` radii of the object.
const CELLS: usize = 25;
const REACH: f32 = 3.0;

impl Effect for GroundBounce {
    fn id(&self) -> &'static str {
        "ground_bounce"
    }
    fn describe(&self) -> &'static str {
        "the ground the object stands on reflects light to its underside"
    }
    fn stage(&self) -> Stage {
        Stage::Transport
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["near_field_light", "interreflection", "finer_environment"]
    }
    fn shown_by(&self) -> &'static str {
        "take the same views with black cloth under the object: light from the ground goes, all other light stays"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let Some(grid) = scene.horizon.grid() else {
            return Vec::new();
        };
        let lowest = scene.bvh.mesh().bounds()[0].z;
        let mut terms = Vec::new();
        for (name, gap) in [
            ("touching it", 0.01),
            ("0.1 radii below", 0.1),
            ("0.3 radii below", 0.3),
        ] {
            let plane = Plane::new(scene, grid, lowest - gap * scene.radius);
            let whole = plane.change(scene);
            for c in 0..3 {
                let mut field = whole.clone();
                field
                    .iter_mut()
                    .enumerate()
                    .filter(|(i, _)| i % 3 != c)
                    .for_each(|(_, f)| *f = 0.0);
                let colour = ["red", "green", "blue"][c];
                let name = format!("{colour} albedo of ground {name}");
                terms.push(Term::new(name, 0.4, field).positive());
            }
        }
        terms
    }
}

/// Light on the ground.
struct Plane {
    height: f32,
    cell: f32,
    /// Radiance that a white ground would send up from each cell, and from far away.
    sent: Vec<[f32; 3]>,
    far: [f32; 3],
}

impl Plane {
    fn new(scene: &Scene<'_>, grid: LatLong, height: f32) -> Self {
        let cell = 2.0 * REACH * scene.radius / CELLS as f32;
        // Every second texel across and down is enough for a plane's irradiance.
        let sky: Vec<(Vec3, [f32; 3])> = (0..grid.len())
            .filter(|t| {
                (t / grid.columns).is_multiple_of(2) && (t % grid.columns).is_multiple_of(2)
            })
            .filter_map(|t| {
                let direction = scene.horizon.directions[t];
                let weight = 4.0 * direction.z * grid.solid_angle(t / grid.columns) * FRAC_1_PI;
                (direction.z > 0.0).then(|| {
                    let light = [0, 1, 2].map(|c| weight * scene.radiance[3 * t + c]);
                    (direction, light)
                })
            })
            .collect();
        let add = |sum: &mut [f32; 3], light: &[f32; 3]| {
            (0..3).for_each(|c| sum[c] += light[c]);
        };
        let mut far = [0.0; 3];
        sky.iter().for_each(|(_, light)| add(&mut far, light));
        let sent = (0..CELLS * CELLS)
            .into_par_iter()
            .map(|i| {
                let at = |k: usize| (k as f32 + 0.5) * cell - REACH * scene.radius;
                let origin = Vec3::new(at(i % CELLS), at(i / CELLS), height);
                let mut sum = [0.0; 3];
                for (direction, light) in &sky {
                    if !scene.bvh.blocked(origin, *direction) {
                        add(&mut sum, light);
                    }
                }
                sum
            })
            .collect();
        Self {
            height,
            cell,
            sent,
            far,
        }
    }

    /// What a white ground sends from where a ray from `point` meets it.
    fn radiance(&self, scene: &Scene<'_>, point: Vec3, direction: Vec3) -> [f32; 3] {
        let t = (self.height - point.z) / direction.z.min(-1e-3);
        let there = point + t.max(0.0) * direction;
        let index = |v: f32| (v + REACH * scene.radius) / self.cell;
        let (x, y) = (index(there.x), index(there.y));
        let inside = |v: f32| v >= 0.0 && v < CELLS as f32;
        if inside(x) && inside(y) {
            self.sent[y as usize * CELLS + x as usize]
        } else {
            self.far
        }
    }

    /// The light of a white ground, for every view.
    fn change(&self, scene: &Scene<'_>) -> Vec<f32> {
        scene.on_views(|v| {
            let site = scene.seen.views[v].site as usize;
            let point = scene.seen.sites[site].point.position;
            let albedo = scene.albedo_of(v);
            let mut sum = [0.0; 3];
            for (texel, [d, s]) in scene.transport.row(v) {
                let direction = scene.horizon.directions[texel];
                if direction.z < 0.0 {
                    let light = self.radiance(scene, point, direction);
                    (0..3).for_each(|c| sum[c] += (albedo[c] * d + s) * light[c]);
                }
            }
            sum
        })
    }
}
