//! Transport rows of patches: how much light from every texel reaches them past the object itself.

use rayon::prelude::*;
use render::{
    bvh::{Bvh, Rays, offset_origin},
    transport::Quadrature,
};

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
            let mut open = vec![false; grid.len()];
            let mut along = [0, 1, 2].map(|_| vec![0.0; grid.len()]);
            for (m, member) in patch.members.iter().enumerate() {
                let ray = |texel: usize| (m + texel) % quadrature.rays();
                for (texel, open) in open.iter_mut().enumerate() {
                    let direction = quadrature.direction(texel, ray(texel));
                    *open = member.normal.dot(direction) > 0.0
                        && member.geometric_normal.dot(direction) > 0.0;
                    (0..3).for_each(|axis| along[axis][texel] = direction[axis]);
                }
                let rays = Rays {
                    direction: [0, 1, 2].map(|axis| along[axis].as_slice()),
                    open: &mut open,
                };
                bvh.close_blocked(offset_origin(member), rays);
                for texel in (0..grid.len()).filter(|&texel| open[texel]) {
                    let ray = ray(texel);
                    let cosine = member.normal.dot(quadrature.direction(texel, ray));
                    let amount = share * cosine * quadrature.solid_angle(texel, ray);
                    quadrature.spread(texel, ray, amount, row);
                }
            }
        });
    rows
}
