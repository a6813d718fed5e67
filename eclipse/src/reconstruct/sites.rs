//! Sites: points of the surface about a pixel apart, and where every pixel and vertex lies among them.

use std::collections::HashMap;

use foldhash::fast::FixedState;
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    transport::footprint,
};

use crate::capture::Frame;

/// How many sites a place is interpolated from.
pub const NEAREST: usize = 4;

/// Sites around a place with their weights, which sum to one.
pub type Blend = [(u32, f32); NEAREST];

/// Points of the surface in a grid of cells.
pub struct Sites {
    points: Vec<(Vec3, Vec3)>,
    spacing: f32,
    /// Every pixel of every frame asks for 27 cells and more: a hash against attackers was a good part of that.
    cells: HashMap<IVec3, Vec<u32>, FixedState>,
}

impl Sites {
    /// Of positions with normals, about `spacing` apart.
    ///
    /// # Panics
    /// Without points there is nothing to interpolate from: callers check.
    pub fn new(points: Vec<(Vec3, Vec3)>, spacing: f32) -> Self {
        assert!(!points.is_empty(), "at least one site");
        let mut sites = Self {
            points,
            spacing: spacing.max(1e-9),
            cells: HashMap::default(),
        };
        for i in 0..sites.points.len() {
            let cell = sites.cell(sites.points[i].0);
            sites.cells.entry(cell).or_default().push(i as u32);
        }
        sites
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Never: see [`Sites::new`].
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The nearest sites, in position and normal together, weighted by nearness.
    pub fn blend(&self, position: Vec3, normal: Vec3) -> Blend {
        let squared = |i: u32| {
            let (p, n) = self.points[i as usize];
            p.distance_squared(position) + self.spacing.powi(2) * n.distance_squared(normal)
        };
        let mut found: Vec<(f32, u32)> = Vec::new();
        for reach in [1, 2, 4] {
            found = self
                .around(position, reach)
                .map(|i| (squared(i), i))
                .collect();
            if found.len() >= NEAREST {
                break;
            }
        }
        if found.is_empty() {
            found = (0..self.points.len() as u32)
                .map(|i| (squared(i), i))
                .collect();
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(NEAREST);
        let softening = (0.4 * self.spacing).powi(2);
        let weight = |d: f32| 1.0 / (d + softening).powi(2);
        let sum: f32 = found.iter().map(|&(d, _)| weight(d)).sum();
        std::array::from_fn(|k| {
            found
                .get(k)
                .map_or((found[0].1, 0.0), |&(d, i)| (i, weight(d) / sum))
        })
    }

    /// For every pixel that the object covers by more than half, the sites around what it looks at.
    pub fn pixels(&self, bvh: &Bvh, frame: &Frame) -> Vec<Option<Blend>> {
        let width = frame.image.width;
        (0..frame.mask.data.len())
            .into_par_iter()
            .map(|p| {
                if frame.mask.data[p] <= 0.5 {
                    return None;
                }
                let point = looked_at(bvh, &frame.camera, [p % width, p / width])?;
                Some(self.blend(point.position, point.normal))
            })
            .collect()
    }

    fn cell(&self, position: Vec3) -> IVec3 {
        (position / self.spacing).floor().as_ivec3()
    }

    fn around(&self, position: Vec3, reach: i32) -> impl Iterator<Item = u32> + '_ {
        let centre = self.cell(position);
        let side = 2 * reach + 1;
        (0..side * side * side)
            .map(move |i| IVec3::new(i % side, i / side % side, i / (side * side)) - reach)
            .filter_map(move |offset| self.cells.get(&(centre + offset)))
            .flatten()
            .copied()
    }
}

/// What the middle of a pixel looks at or, on the silhouette, any place of it.
fn looked_at(bvh: &Bvh, camera: &Camera, [x, y]: [usize; 2]) -> Option<SurfacePoint> {
    let middle = bvh.seen(camera, x as f32 + 0.5, y as f32 + 0.5);
    let first = || footprint(bvh, camera, [x, y], 4).next();
    middle.or_else(first).map(|(point, _)| point)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_site_is_its_own_nearest_and_far_places_still_have_one() {
        let points: Vec<(Vec3, Vec3)> = (0..100)
            .map(|i| (Vec3::new((i % 10) as f32, (i / 10) as f32, 0.0), Vec3::Z))
            .collect();
        let sites = Sites::new(points.clone(), 1.0);
        for (i, (p, n)) in points.iter().enumerate() {
            let blend = sites.blend(*p, *n);
            assert_eq!(blend[0].0, i as u32);
            assert!(blend[0].1 > 0.8, "{blend:?}");
            assert!((blend.iter().map(|b| b.1).sum::<f32>() - 1.0).abs() < 1e-5);
        }
        assert!(sites.blend(Vec3::splat(1e4), Vec3::Z)[0].1 > 0.0);
        assert_eq!(
            Sites::new(points[..1].to_vec(), 1.0).blend(Vec3::Z, Vec3::Z)[1].1,
            0.0
        );
    }
}
