//! The equirectangular grid on which environments, masks and visibility live.
//!
//! Texel-centred, top row +z, centre column +x, the column grows as the azimuth falls (Blender): a direction has
//! u = ½ − atan2(y, x)/2π and v = acos(z)/π, texel (r, c) is at u = (c + ½)/columns, v = (r + ½)/rows. Lookups wrap in u
//! and clamp in v.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use crate::math::{fast_atan2, fast_sin_cos};

/// An equirectangular grid of `rows` × `columns` texels, row-major.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatLong {
    /// Texels from pole to pole.
    pub rows: usize,
    /// Texels around.
    pub columns: usize,
}

/// The four texels around a direction and their weights, which sum to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bilinear {
    /// Row-major texel indices: upper left, upper right, lower left, lower right.
    pub index: [u32; 4],
    /// Their weights.
    pub weight: [f32; 4],
}

impl Bilinear {
    /// The weighted sum of a table's entries.
    #[inline]
    pub fn gather(&self, table: &[f32]) -> f32 {
        (0..4)
            .map(|k| self.weight[k] * table[self.index[k] as usize])
            .sum()
    }

    /// Adds `amount` to the table's entries by their weights: the transpose of [`gather`](Self::gather).
    #[inline]
    pub fn scatter(&self, amount: f32, table: &mut [f32]) {
        for (index, weight) in self.index.iter().zip(self.weight) {
            table[*index as usize] += weight * amount;
        }
    }
}

impl LatLong {
    /// A grid of `rows` × `columns`.
    pub const fn new(rows: usize, columns: usize) -> Self {
        Self { rows, columns }
    }

    /// The number of texels.
    pub const fn len(&self) -> usize {
        self.rows * self.columns
    }

    /// Whether the grid has no texels.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The unit direction at (u, v) of [0, 1]².
    #[inline(always)]
    pub fn direction(u: f32, v: f32) -> Vec3 {
        let (sin_phi, cos_phi) = fast_sin_cos(0.5 - u);
        let (sin_theta, cos_theta) = fast_sin_cos(0.5 * v);
        Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta)
    }

    /// The coordinates (u, v) of a direction, of any length.
    #[inline(always)]
    pub fn coordinates(direction: Vec3) -> [f32; 2] {
        // acos(z) has no digits left next to the poles; atan2 of the two legs keeps them.
        let horizontal = (direction.x * direction.x + direction.y * direction.y).sqrt();
        let u = 0.5 - fast_atan2(direction.y, direction.x) * (1.0 / TAU);
        [u, fast_atan2(horizontal, direction.z) * (1.0 / PI)]
    }

    /// The direction of the centre of a texel.
    pub fn texel_direction(&self, row: usize, column: usize) -> Vec3 {
        self.direction_within(row, column, [0.5, 0.5])
    }

    /// The direction at `place` of [0, 1]² (across, down) within a texel.
    pub fn direction_within(&self, row: usize, column: usize, place: [f32; 2]) -> Vec3 {
        Self::direction(
            (column as f32 + place[0]) / self.columns as f32,
            (row as f32 + place[1]) / self.rows as f32,
        )
    }

    /// The solid angle (sr) of each texel of a row, exactly: they sum to 4π over the grid.
    pub fn solid_angle(&self, row: usize) -> f32 {
        self.band_solid_angle(row as f32, row as f32 + 1.0)
    }

    /// The solid angle (sr), one texel wide, between the fractional rows `top` and `bottom`.
    pub fn band_solid_angle(&self, top: f32, bottom: f32) -> f32 {
        let z = |row: f32| (f64::from(row) / self.rows as f64 * std::f64::consts::PI).cos();
        ((z(top) - z(bottom)) * std::f64::consts::TAU / self.columns as f64) as f32
    }

    /// The texel that a direction falls in.
    pub fn nearest(&self, direction: Vec3) -> usize {
        let [u, v] = Self::coordinates(direction);
        self.texel_at(u, v)
    }

    /// The texel that holds (u, v) of [0, 1]².
    #[inline(always)]
    pub fn texel_at(&self, u: f32, v: f32) -> usize {
        let (rows, columns) = (self.rows as i32, self.columns as i32);
        let column = (u * self.columns as f32) as i32;
        let column = if column >= columns {
            column - columns
        } else {
            column
        };
        let row = ((v * self.rows as f32) as i32).min(rows - 1);
        (row * columns + column) as usize
    }

    /// One of the four texels around (u, v) of [0, 1]², by their weights in [`bilinear_at`](Self::bilinear_at), at `choice` of
    /// (0, 1)² (Fajardo et al., "Stochastic Texture Filtering", 2023): moving the place by up to a texel does it.
    #[inline(always)]
    pub fn stochastic_at(&self, u: f32, v: f32, choice: [f32; 2]) -> u32 {
        let (rows, columns) = (self.rows as i32, self.columns as i32);
        // Half a texel to the left, where truncation would round up, is moved to the right first.
        let column = (u * self.columns as f32 + 0.5 + choice[0]) as i32 - 1;
        let column = if column < 0 { column + columns } else { column };
        let column = if column >= columns {
            column - columns
        } else {
            column
        };
        let row = (v * self.rows as f32 + 0.5 + choice[1]) as i32 - 1;
        (row.max(0).min(rows - 1) * columns + column) as u32
    }

    /// The four texels around a direction.
    pub fn bilinear(&self, direction: Vec3) -> Bilinear {
        let [u, v] = Self::coordinates(direction);
        self.bilinear_at(u, v)
    }

    /// The four texels around (u, v); u may be any number, v is clamped.
    pub fn bilinear_at(&self, u: f32, v: f32) -> Bilinear {
        let u = if (0.0..=1.0).contains(&u) {
            u
        } else {
            u - u.floor()
        };
        // Truncation rounds down only where nothing is negative: the half texel left of the seam is moved up first.
        let x = u * self.columns as f32 + 0.5;
        let y = (v * self.rows as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let (right, r0) = (x as usize, y as usize);
        let (fx, fy) = (x - right as f32, y - r0 as f32);
        let c1 = if right >= self.columns { 0 } else { right };
        let c0 = if right == 0 {
            self.columns - 1
        } else {
            right - 1
        };
        let r1 = (r0 + 1).min(self.rows - 1);
        let at = |r: usize, c: usize| (r * self.columns + c) as u32;
        Bilinear {
            index: [at(r0, c0), at(r0, c1), at(r1, c0), at(r1, c1)],
            weight: [
                (1.0 - fx) * (1.0 - fy),
                fx * (1.0 - fy),
                (1.0 - fx) * fy,
                fx * fy,
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_convention_is_blenders() {
        let near = |a: Vec3, b: Vec3| (a - b).length() < 1e-6;
        assert!(near(LatLong::direction(0.5, 0.5), Vec3::X));
        assert!(near(LatLong::direction(0.25, 0.5), Vec3::Y));
        assert!(near(LatLong::direction(0.5, 0.0), Vec3::Z));
        for (u, v) in [(0.1, 0.2), (0.9, 0.7), (0.5, 0.01)] {
            let [u2, v2] = LatLong::coordinates(LatLong::direction(u, v));
            assert!((u - u2).abs() < 1e-5 && (v - v2).abs() < 1e-6);
        }
    }

    #[test]
    fn solid_angles_cover_the_sphere() {
        let grid = LatLong::new(50, 100);
        let total: f32 = (0..50).map(|r| grid.solid_angle(r) * 100.0).sum();
        assert!((total - 4.0 * PI).abs() < 1e-4);
    }

    #[test]
    fn a_texel_is_chosen_as_often_as_it_weighs() {
        let grid = LatLong::new(5, 8);
        let n = 64;
        for (u, v) in [
            (0.0, 0.5),
            (0.01, 0.03),
            (0.37, 0.62),
            (0.99, 0.97),
            (1.0, 1.0),
        ] {
            let mut share = vec![0.0; grid.len()];
            for i in 0..n * n {
                let choice = [i % n, i / n].map(|k| (k as f32 + 0.5) / n as f32);
                share[grid.stochastic_at(u, v, choice) as usize] += 1.0 / (n * n) as f32;
            }
            let texels = grid.bilinear_at(u, v);
            for k in 0..4 {
                share[texels.index[k] as usize] -= texels.weight[k];
            }
            assert!(share.iter().all(|s| s.abs() < 0.03), "{u} {v}: {share:?}");
        }
    }

    #[test]
    fn bilinear_lookup_is_exact_at_centres_and_wraps() {
        let grid = LatLong::new(5, 8);
        let table: Vec<f32> = (0..grid.len()).map(|i| (i * i % 17) as f32).collect();
        for r in 0..5 {
            for c in 0..8 {
                let d = grid.texel_direction(r, c);
                assert!((grid.bilinear(d).gather(&table) - table[r * 8 + c]).abs() < 1e-3);
                assert_eq!(grid.nearest(d), r * 8 + c);
            }
        }
        let seam = grid.bilinear_at(0.0, 0.5).gather(&table);
        assert!((seam - 0.5 * (table[2 * 8] + table[2 * 8 + 7])).abs() < 1e-5);
        assert_eq!(
            grid.bilinear_at(0.3, -1.0).index[0],
            grid.bilinear_at(0.3, -1.0).index[2] - 8
        );
    }
}
