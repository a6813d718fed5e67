//! The object's own shadows: cast anew, or looked up in a cache on the environment's grid.
//!
//! Shape and cameras never change during a reconstruction, so which directions a surface point sees can be found once. The
//! cache keeps one bit for each of `side` × `side` parts of every texel: 625 bytes a point at 50 × 100 with side 1, 2,500
//! with side 2, whose mean over a texel is its fractional coverage. Each part is probed at a jittered place, which turns
//! the bias of a fixed place into noise across points.

use glam::Vec3;
use rayon::prelude::*;

use crate::bvh::{Bvh, Sight, SurfacePoint};
use crate::lat_long::LatLong;
use crate::sampler::SampleKey;

/// How shadow queries are answered.
#[derive(Clone, Copy)]
pub enum Visibility<'a> {
    /// A ray a query.
    Rays,
    /// A bit of memory a query.
    Cached(&'a VisibilityCache),
}

/// What many points see, a bit for each part of each texel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VisibilityCache {
    fine: LatLong,
    side: usize,
    words: usize,
    bits: Vec<u64>,
}

impl VisibilityCache {
    /// The bytes that a cache of `points` points on `grid` with `side` × `side` bits a texel occupies.
    pub fn bytes(points: usize, grid: LatLong, side: usize) -> usize {
        points * (grid.len() * side * side).div_ceil(64) * 8
    }

    /// The finest side, of at most `side`, that fits into `budget` bytes; `None` when only ray casts do.
    pub fn plan(points: usize, grid: LatLong, side: usize, budget: usize) -> Option<usize> {
        (1..=side)
            .rev()
            .find(|&s| Self::bytes(points, grid, s) <= budget)
    }

    /// Casts the rays of all points, in parallel.
    pub fn build(bvh: &Bvh, grid: LatLong, side: usize, points: &[SurfacePoint]) -> Self {
        let fine = LatLong::new(grid.rows * side, grid.columns * side);
        let words = fine.len().div_ceil(64);
        let mut bits = vec![0; words * points.len()];
        bits.par_chunks_exact_mut(words)
            .zip(points)
            .enumerate()
            .for_each(|(i, (bits, point))| {
                let mut stream = SampleKey {
                    pixel: i as u32,
                    ..SampleKey::default()
                }
                .stream();
                let mut sight = Sight::default();
                let directions = (0..fine.len()).map(|part| {
                    let place = stream.uniform_2d();
                    fine.direction_within(part / fine.columns, part % fine.columns, place)
                });
                let open = sight.look(bvh, point, directions);
                for (part, open) in open.iter().enumerate() {
                    bits[part / 64] |= u64::from(*open) << (part % 64);
                }
            });
        Self {
            fine,
            side,
            words,
            bits,
        }
    }

    /// The number of points.
    pub fn points(&self) -> usize {
        self.bits.len() / self.words
    }

    /// Whether point `point` sees out at the grid coordinates (u, v).
    #[inline]
    pub fn visible(&self, point: usize, [u, v]: [f32; 2]) -> bool {
        self.bit(point, self.fine.texel_at(u, v))
    }

    /// The grid of the bits.
    pub(crate) fn fine(&self) -> LatLong {
        self.fine
    }

    /// The share of a texel of the original grid that a point sees.
    pub fn coverage(&self, point: usize, texel: usize) -> f32 {
        let columns = self.fine.columns / self.side;
        let (row, column) = (texel / columns * self.side, texel % columns * self.side);
        let seen = (0..self.side * self.side).filter(|s| {
            self.bit(
                point,
                (row + s / self.side) * self.fine.columns + column + s % self.side,
            )
        });
        seen.count() as f32 / (self.side * self.side) as f32
    }

    /// Whether point `point` sees out through a texel of the grid of the bits.
    #[inline]
    pub(crate) fn bit(&self, point: usize, part: usize) -> bool {
        self.bits[point * self.words + part / 64] >> (part % 64) & 1 != 0
    }
}

impl Visibility<'_> {
    /// Whether a point sees out along a unit direction with the given grid coordinates.
    ///
    /// `cached` is the point's number in the cache.
    #[inline]
    pub fn visible(
        &self,
        bvh: &Bvh,
        point: &SurfacePoint,
        cached: usize,
        direction: Vec3,
        uv: [f32; 2],
    ) -> bool {
        match self {
            Self::Rays => !bvh.occluded(point, direction),
            Self::Cached(cache) => cache.visible(cached, uv),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plan_takes_the_finest_that_fits() {
        let grid = LatLong::new(50, 100);
        assert_eq!(VisibilityCache::bytes(1, grid, 1), 632);
        assert_eq!(VisibilityCache::bytes(10, grid, 2), 25_040);
        assert_eq!(VisibilityCache::plan(1000, grid, 2, 3_000_000), Some(2));
        assert_eq!(VisibilityCache::plan(1000, grid, 2, 1_000_000), Some(1));
        assert_eq!(VisibilityCache::plan(1000, grid, 2, 100_000), None);
    }
}
