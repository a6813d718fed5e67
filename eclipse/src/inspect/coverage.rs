//! How much of the object's surface the photographs show.

use rayon::prelude::*;
use render::bvh::{Bvh, SurfacePoint, offset_origin};
use serde::Serialize;

use crate::capture::{Capture, Frame};

/// Points of the surface that are looked at: shares are then good to about a percent.
const POINTS: usize = 4000;
/// Surface seen at a flatter angle than this (cosine) is hardly measured.
const GRAZING: f32 = 0.1;

/// Shares of the surface, by area.
#[derive(Clone, Debug, Serialize)]
pub struct CoverageInspection {
    /// Seen by one photograph at least.
    pub seen: f32,
    /// Seen by three at least.
    pub seen_by_three: f32,
    /// Photographs that see a place of the surface that is seen, on average.
    pub mean_views: f32,
}

pub(super) fn inspect(capture: &Capture) -> CoverageInspection {
    let Ok(bvh) = Bvh::new(&capture.mesh) else {
        // Readers hand on valid meshes only; one that is not has nothing to see.
        return CoverageInspection {
            seen: 0.0,
            seen_by_three: 0.0,
            mean_views: 0.0,
        };
    };
    let views: Vec<usize> = spread(capture)
        .into_par_iter()
        .map(|point| {
            let seen = capture.frames.iter().filter(|f| sees(f, &bvh, point));
            seen.count()
        })
        .collect();
    let share = |least| {
        let enough = views.iter().filter(|&&count| count >= least).count();
        enough as f32 / views.len().max(1) as f32
    };
    let seen = views.iter().filter(|&&count| count > 0).count();
    CoverageInspection {
        seen: share(1),
        seen_by_three: share(3),
        mean_views: views.iter().sum::<usize>() as f32 / seen.max(1) as f32,
    }
}

/// Points spread evenly by area: equal steps along the areas laid end to end, and an additive recurrence within the triangles
/// (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
fn spread(capture: &Capture) -> Vec<SurfacePoint> {
    let mesh = &capture.mesh;
    let mut reached = 0.0f64;
    let ends: Vec<f64> = mesh
        .areas()
        .iter()
        .map(|&area| {
            reached += f64::from(area);
            reached
        })
        .collect();
    (0..POINTS)
        .map(|index| {
            let at = (index as f64 + 0.5) / POINTS as f64 * reached;
            let face = ends.partition_point(|&end| end < at).min(ends.len() - 1);
            let [mut u, mut v] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2]
                .map(|step: f64| (0.5 + step * index as f64).fract() as f32);
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = mesh.triangle(face);
            let normal = mesh.face_normal(face);
            SurfacePoint {
                position: a + u * (b - a) + v * (c - a),
                normal,
                geometric_normal: normal,
            }
        })
        .collect()
}

/// Whether a frame's photograph shows the point.
fn sees(frame: &Frame, bvh: &Bvh, mut point: SurfacePoint) -> bool {
    let camera = &frame.camera;
    let Some([x, y]) = camera.project(point.position) else {
        return false;
    };
    let inside =
        (0.0..camera.width as f32).contains(&x) && (0.0..camera.height as f32).contains(&y);
    let direction = camera.direction_from(point.position);
    let cosine = point.geometric_normal.dot(direction);
    if !inside || cosine.abs() < GRAZING {
        return false;
    }
    // Triangles wound the wrong way are seen as well: what lies behind them hides their inner side.
    if cosine < 0.0 {
        point.normal = -point.normal;
        point.geometric_normal = -point.geometric_normal;
    }
    !bvh.blocked(offset_origin(&point), direction)
}
