//! Transport rows of patches: how much light from every texel reaches them past the object itself.

use glam::Vec3;
use rayon::prelude::*;
use render::{bvh::Bvh, transport::Quadrature};

use super::patches::Patch;

/// Cosine-weighted visible solid angle over π of every texel, `[patch][texel]`; a bare plane's row sums to one.
///
/// A texel's share is through its tent, as in [`Quadrature`]. The mean over a patch's members; each member casts one ray a texel, and the members take the texel's rays in turn.
pub fn rows(bvh: &Bvh, quadrature: &Quadrature, patches: &[Patch]) -> Vec<f32> {
    let grid = quadrature.grid();
    let mut rows = vec![0.0f32; patches.len() * grid.len()];
    rows.par_chunks_mut(grid.len())
        .zip(patches)
        .for_each(|(row, patch)| {
            let share =
                quadrature.rays() as f32 / (patch.members.len() as f32 * std::f32::consts::PI);
            for (m, member) in patch.members.iter().enumerate() {
                let origin = render::bvh::offset_origin(member);
                for texel in 0..grid.len() {
                    let ray = (m + texel) % quadrature.rays();
                    let direction: Vec3 = quadrature.direction(texel, ray);
                    let cosine = member.normal.dot(direction);
                    let above = cosine > 0.0 && member.geometric_normal.dot(direction) > 0.0;
                    if above && !bvh.blocked(origin, direction) {
                        let amount = share * cosine * quadrature.solid_angle(texel, ray);
                        quadrature.spread(texel, ray, amount, row);
                    }
                }
            }
        });
    rows
}
