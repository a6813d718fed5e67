//! Paths without randomness: every direction of a quadrature.

use super::run::Run;
use super::{Lookup, PathScene, ShadingPoint};
use crate::bsdf::Model;
use crate::lat_long::{Bilinear, LatLong};
use crate::occluder::mask_lookup;
use crate::transport::Quadrature;

/// Takes every direction of a quadrature from each of the points.
pub(super) fn quadrature(
    scene: &PathScene,
    points: &[ShadingPoint],
    quadrature: &Quadrature,
) -> Run {
    let mut batch = Run::empty(Lookup::Bilinear);
    for point in points {
        for texel in 0..quadrature.grid().len() {
            for ray in 0..quadrature.rays() {
                add(&mut batch, scene, point, quadrature, texel, ray);
            }
        }
        let outgoing = point.surface.normal.dot(point.outgoing);
        batch.outgoing.push(outgoing);
        batch.offsets.push(batch.weight.len() as u32);
    }
    batch
}

fn add(
    batch: &mut Run,
    scene: &PathScene,
    point: &ShadingPoint,
    quadrature: &Quadrature,
    texel: usize,
    ray: usize,
) {
    let (normal, position) = (point.surface.normal, point.surface.position);
    let direction = quadrature.direction(texel, ray);
    let uv = LatLong::coordinates(direction);
    let lit = normal.dot(direction) > 0.0
        && (scene.model == Model::Lambertian || normal.dot(point.outgoing) > 0.0)
        && scene.visibility.visible(
            scene.bvh,
            &point.surface,
            point.cached as usize,
            direction,
            uv,
        );
    if !lit {
        return;
    }
    let half = (direction + point.outgoing).normalize_or_zero();
    batch.incident.push(normal.dot(direction));
    batch.half.push(normal.dot(half));
    batch.difference.push(half.dot(direction));
    batch.weight.push(quadrature.solid_angle(texel, ray));
    let radius = scene.radii[point.frame as usize];
    let light = scene.environment_grid.bilinear_at(uv[0], uv[1]);
    let mask = mask_lookup(scene.mask_grid, position, direction, radius);
    batch.light.push(&light);
    batch.mask.push(&of_frame(&mask, scene, point.frame));
}

/// The lookup of a frame's mask in the table of all.
pub(super) fn of_frame(mask: &Bilinear, scene: &PathScene, frame: u32) -> Bilinear {
    let frames = scene.radii.len() as u32;
    Bilinear {
        index: mask.index.map(|texel| texel * frames + frame),
        weight: mask.weight,
    }
}
