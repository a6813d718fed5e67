//! Cells of the surface: places so close to each other that they see the same and have the same roughness.
//!
//! Photographs show a place many times, from frame to frame and from iteration to iteration. What a place sees of the
//! surroundings is found once a cell; shading itself stays exact.

use rayon::prelude::*;
use render::bvh::SurfacePoint;

/// Normals are told apart in steps of this: 1/3 is about 20°.
const NORMAL_STEP: f32 = 1.0 / 3.0;
/// Attempts at a size that leaves few enough cells.
const ATTEMPTS: usize = 12;

/// A partition of surface points.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// The cell of each point.
    pub of_point: Vec<u32>,
    /// One of its points for each cell: the first.
    pub places: Vec<SurfacePoint>,
    /// Side of the cubes that cells are cut by.
    pub size: f32,
}

/// Cube and class of normals.
type Key = ([i32; 3], [i8; 3]);

impl Cells {
    /// Cells as small as they can be with at most `most` of them; of each point alone if that is few enough.
    ///
    /// Points lie within `radius` of the origin. The partition depends on the points and their order alone.
    pub fn new(points: &[SurfacePoint], radius: f32, most: usize) -> Self {
        let most = most.max(1);
        let mut size = 1e-3 * radius.max(f32::MIN_POSITIVE);
        let mut cells = Self::of_size(points, size);
        for _ in 0..ATTEMPTS {
            if cells.places.len() <= most {
                break;
            }
            // A surface is cut into pieces by the square; a little more makes up for those that are cut off.
            size *= 1.05 * (cells.places.len() as f32 / most as f32).sqrt();
            cells = Self::of_size(points, size);
        }
        if cells.places.len() > most {
            // Every normal of a piece of nothing: a surface this crumpled has one cell for all.
            cells = Self {
                of_point: vec![0; points.len()],
                places: points[..1].to_vec(),
                size: f32::INFINITY,
            };
        }
        cells
    }

    fn of_size(points: &[SurfacePoint], size: f32) -> Self {
        let mut order: Vec<(Key, u32)> = points
            .par_iter()
            .enumerate()
            .map(|(i, point)| (key(point, size), i as u32))
            .collect();
        order.par_sort_unstable();
        let mut of_point = vec![0; points.len()];
        let mut places = Vec::new();
        let mut last = None;
        for (key, i) in order {
            if last != Some(key) {
                places.push(points[i as usize]);
                last = Some(key);
            }
            of_point[i as usize] = places.len() as u32 - 1;
        }
        Self {
            of_point,
            places,
            size,
        }
    }
}

fn key(point: &SurfacePoint, size: f32) -> Key {
    let cube = (point.position / size).floor().to_array();
    let normal = (point.normal / NORMAL_STEP).round().to_array();
    (cube.map(|x| x as i32), normal.map(|x| x as i8))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn sphere(count: usize) -> Vec<SurfacePoint> {
        (0..count)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
                let (sin, cos) = (2.399_963 * i as f32).sin_cos();
                let normal = Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
                SurfacePoint {
                    position: normal,
                    normal,
                    geometric_normal: normal,
                }
            })
            .collect()
    }

    #[test]
    fn cells_are_few_small_and_hold_alike_points() {
        let points = sphere(20_000);
        let cells = Cells::new(&points, 1.0, 2000);
        assert!((500..=2000).contains(&cells.places.len()));
        for (point, &cell) in points.iter().zip(&cells.of_point) {
            let place = &cells.places[cell as usize];
            assert!((place.position - point.position).length() <= 1.8 * cells.size);
            assert!(place.normal.dot(point.normal) > 0.7);
        }
    }

    #[test]
    fn enough_room_leaves_each_point_alone() {
        let points = sphere(200);
        let cells = Cells::new(&points, 1.0, 200);
        assert_eq!(cells.places.len(), 200);
    }

    #[test]
    fn there_is_always_a_partition() {
        let points = sphere(100);
        let cells = Cells::new(&points, 1.0, 1);
        assert_eq!(cells.places.len(), 1);
        assert!(cells.of_point.iter().all(|&cell| cell == 0));
    }
}
