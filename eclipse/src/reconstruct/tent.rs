//! Masks as the light of a texel meets them: averaged over the tent through which that texel lights.
//!
//! Light is interpolated between texels' centres (see [`render::transport`]), so what a mask lets pass of a texel's light is
//! the mask's mean over a tent two texels wide, not its value at the centre: a shadow's edge is never sharper than the light.

use render::lat_long::LatLong;

/// Replaces masks on `grid`, `[texel][frame]`, by what they let pass of the light on a grid of `light_rows`.
///
/// The bilinear lookup itself averages over a tent of the masks' own grid, whose variance is 1/6 of a texel squared. What light's
/// tent has beyond that, (w, 1 − 2w, w) along rows and columns adds: w = (k² − 1)/12 where masks are k times as fine, a quarter
/// for twice. Where they are no finer than the light nothing is left to do. The operator is its own transpose.
pub fn soften(grid: LatLong, light_rows: usize, frames: usize, masks: &mut [f32]) {
    let finer = grid.rows as f32 / light_rows.max(1) as f32;
    let side = ((finer * finer - 1.0) / 12.0).clamp(0.0, 1.0 / 3.0);
    if side == 0.0 || frames == 0 {
        return;
    }
    let mixed =
        |before: f32, own: f32, after: f32| side * (before + after) + (1.0 - 2.0 * side) * own;
    let line = grid.columns * frames;
    let mut row = vec![0.0; line];
    for values in masks.chunks_exact_mut(line) {
        row.copy_from_slice(values);
        for c in 0..grid.columns {
            let left = (c + grid.columns - 1) % grid.columns * frames;
            let right = (c + 1) % grid.columns * frames;
            let own = c * frames;
            for t in 0..frames {
                values[own + t] = mixed(row[left + t], row[own + t], row[right + t]);
            }
        }
    }
    // The row above as it was, before it was overwritten; rows clamp at the poles.
    let mut above = masks[..line].to_vec();
    for r in 0..grid.rows {
        let (now, below) = masks[r * line..].split_at_mut(line);
        row.copy_from_slice(now);
        let below = below.get(..line).unwrap_or(&row);
        for i in 0..line {
            now[i] = mixed(above[i], row[i], below[i]);
        }
        above.copy_from_slice(&row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_keeps_what_it_lets_pass_and_the_operator_is_symmetric() {
        let grid = LatLong::new(6, 12);
        let value = |i: usize, k: usize| (((i * 37 + k * 11) % 19) as f32) / 19.0;
        let len = grid.len() * 2;
        let (mut a, mut b): (Vec<f32>, Vec<f32>) = (
            (0..len).map(|i| value(i, 0)).collect(),
            (0..len).map(|i| value(i * i, 5)).collect(),
        );
        let (a0, b0) = (a.clone(), b.clone());
        soften(grid, 3, 2, &mut a);
        soften(grid, 3, 2, &mut b);
        let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f32>();
        assert!((dot(&a, &b0) - dot(&a0, &b)).abs() < 1e-3);
        assert!((a.iter().sum::<f32>() - a0.iter().sum::<f32>()).abs() < 1e-3);
        let before = b.clone();
        soften(grid, 6, 2, &mut b);
        assert_eq!(before, b);
    }

    #[test]
    fn an_edge_becomes_a_slope() {
        let grid = LatLong::new(4, 8);
        let mut mask: Vec<f32> = (0..grid.len())
            .map(|i| f32::from(u8::from(i % 8 >= 4)))
            .collect();
        soften(grid, 2, 1, &mut mask);
        for row in mask.chunks_exact(8) {
            assert_eq!(row, [0.25, 0.0, 0.0, 0.25, 0.75, 1.0, 1.0, 0.75]);
        }
    }
}
