//! Transport rows of patches: how much light from every texel reaches them past the object itself.

use rayon::prelude::*;
use render::{
    bvh::{Bvh, Sight},
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
            let mut sight = Sight::default();
            for (m, member) in patch.members.iter().enumerate() {
                let ray = |texel: usize| (m + texel) % quadrature.rays();
                let directions =
                    (0..grid.len()).map(|texel| quadrature.direction(texel, ray(texel)));
                let open = sight.look(bvh, member, directions);
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
