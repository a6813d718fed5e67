//! Places spread over a surface.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    lat_long::LatLong,
    sampler::SampleKey,
};

/// Places that see less of the sky than this are within seams of the mesh, and their light is a matter of its details.
const LEAST_OPEN: f32 = 0.05;
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
pub fn scatter(bvh: &Bvh, count: usize, seed: u64) -> (Vec<SurfacePoint>, f32) {
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
    let kept = kept
        .into_par_iter()
        .filter(|point| openness(bvh, point) > LEAST_OPEN)
        .collect();
    (kept, spacing)
}
