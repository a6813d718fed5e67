//! Transport rows: how much each texel of the environment lights a surface point, by quadrature over the grid.
//!
//! For a diffuse surface the radiance towards any camera is ρ/π Σ_texel weight · L · M: the weights depend on the shape
//! alone and serve every frame and every iteration. Light between texels' centres is interpolated bilinearly, as everywhere: a
//! texel lights through the tent about its centre, two texels wide. Taken as constant over its own square instead, a sun of
//! few texels would be found blurred.

use glam::Vec3;
use rayon::prelude::*;

use crate::bvh::{Bvh, Sight, SurfacePoint, offset_origin};
use crate::camera::Camera;
use crate::lat_long::{Bilinear, LatLong};
use crate::occluder::mask_lookup;

/// The nonzero entries of a row of the transport operator.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransportRow {
    /// Texels, ascending.
    pub texel: Vec<u16>,
    /// ∫ visibility · (n·ω)₊ · tent dω of each texel, in steradians: a bare plane's row sums to π.
    pub weight: Vec<f32>,
}

/// Where each entry of a row looks a mask up for one shell radius, bilinearly.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaskLookups {
    /// Four texels an entry.
    pub index: Vec<[u16; 4]>,
    /// Their weights.
    pub weight: Vec<[f32; 4]>,
}

/// A grid prepared for quadrature: `side` × `side` rays a texel, each with its solid angle.
#[derive(Clone, Debug)]
pub struct Quadrature {
    grid: LatLong,
    side: usize,
    /// `[texel][ray]`.
    directions: Vec<Vec3>,
    /// Between which texels' centres each ray lies, `[texel][ray]`.
    tents: Vec<Bilinear>,
    /// `[texel]`.
    centres: Vec<Vec3>,
    /// `[row][ray]`, steradians.
    solid_angles: Vec<f32>,
}

impl Quadrature {
    /// Quadrature by `side` × `side` rays a texel, each at the middle of an equal part of it (2 is a good default).
    ///
    /// # Panics
    /// When the grid has more than 65,536 texels: rows name them by `u16`.
    pub fn new(grid: LatLong, side: usize) -> Self {
        assert!(
            grid.len() <= 1 << 16,
            "a transport grid has at most 65,536 texels"
        );
        let place = |k: usize| (k as f32 + 0.5) / side as f32;
        let mut directions = Vec::with_capacity(grid.len() * side * side);
        let mut tents = Vec::with_capacity(grid.len() * side * side);
        let mut solid_angles = Vec::with_capacity(grid.rows * side * side);
        for row in 0..grid.rows {
            for s in 0..side * side {
                let top = row as f32 + (s / side) as f32 / side as f32;
                let bottom = row as f32 + (s / side + 1) as f32 / side as f32;
                solid_angles.push(grid.band_solid_angle(top, bottom) / side as f32);
            }
            for column in 0..grid.columns {
                for s in 0..side * side {
                    let [across, down] = [place(s % side), place(s / side)];
                    directions.push(grid.direction_within(row, column, [across, down]));
                    tents.push(grid.bilinear_at(
                        (column as f32 + across) / grid.columns as f32,
                        (row as f32 + down) / grid.rows as f32,
                    ));
                }
            }
        }
        let centres = (0..grid.len())
            .map(|t| grid.texel_direction(t / grid.columns, t % grid.columns))
            .collect();
        Self {
            grid,
            side,
            directions,
            tents,
            centres,
            solid_angles,
        }
    }

    /// The grid.
    pub fn grid(&self) -> LatLong {
        self.grid
    }

    /// Rays a texel.
    pub fn rays(&self) -> usize {
        self.side * self.side
    }

    /// The direction of ray `ray` of a texel.
    pub fn direction(&self, texel: usize, ray: usize) -> Vec3 {
        self.directions[texel * self.rays() + ray]
    }

    /// Adds what comes along ray `ray` of a texel, `amount`, to the texels whose light it is: `dense` is `[texel]`.
    pub fn spread(&self, texel: usize, ray: usize, amount: f32, dense: &mut [f32]) {
        self.tents[texel * self.rays() + ray].scatter(amount, dense);
    }

    /// The solid angle (sr) that a ray of a texel stands for.
    pub fn solid_angle(&self, texel: usize, ray: usize) -> f32 {
        self.solid_angles[texel / self.grid.columns * self.rays() + ray]
    }

    /// The row of a surface point.
    pub fn row(&self, bvh: &Bvh, point: &SurfacePoint) -> TransportRow {
        let mut dense = vec![0.0; self.grid.len()];
        self.accumulate(bvh, point, 1.0, &mut dense);
        sparse(&dense)
    }

    /// The mean of the rows of some points, of which there must be at least one.
    pub fn mean_row(&self, bvh: &Bvh, points: &[SurfacePoint]) -> TransportRow {
        let mut dense = vec![0.0; self.grid.len()];
        for point in points {
            self.accumulate(bvh, point, 1.0 / points.len() as f32, &mut dense);
        }
        sparse(&dense)
    }

    /// The rows of many points, in their order, in parallel.
    pub fn rows(&self, bvh: &Bvh, points: &[SurfacePoint]) -> Vec<TransportRow> {
        points
            .par_iter()
            .map(|point| self.row(bvh, point))
            .collect()
    }

    /// Where the entries of a row look a mask up when its shell has radius `radius`, from the texels' centres.
    pub fn mask_lookups(&self, row: &TransportRow, point: Vec3, radius: f32) -> MaskLookups {
        let mut lookups = MaskLookups::default();
        for &texel in &row.texel {
            let texel = usize::from(texel);
            let direction = self
                .grid
                .texel_direction(texel / self.grid.columns, texel % self.grid.columns);
            let lookup = mask_lookup(self.grid, point, direction, radius);
            lookups.index.push(lookup.index.map(|i| i as u16));
            lookups.weight.push(lookup.weight);
        }
        lookups
    }

    /// Adds `scale` times the row of a point to a dense row.
    ///
    /// A ray through every texel's centre comes first. Where it and all eight neighbours agree the texel is as they are; the
    /// rays of the other texels, along the edges of shadows, are cast. That is less than half of the rays.
    fn accumulate(&self, bvh: &Bvh, point: &SurfacePoint, scale: f32, dense: &mut [f32]) {
        let origin = offset_origin(point);
        let above = |d: Vec3| point.normal.dot(d) > 0.0 && point.geometric_normal.dot(d) > 0.0;
        let rays = self.rays();
        let mut sight = Sight::default();
        let open = sight.look(bvh, point, self.centres.iter().copied());
        for (texel, directions) in self.directions.chunks_exact(rays).enumerate() {
            let solid_angles = &self.solid_angles[texel / self.grid.columns * rays..][..rays];
            let agreed = self.agreed(open, texel);
            if agreed == Some(false) {
                continue;
            }
            for (ray, (direction, solid_angle)) in directions.iter().zip(solid_angles).enumerate() {
                if above(*direction) && (agreed.is_some() || !bvh.blocked(origin, *direction)) {
                    let cosine = point.normal.dot(*direction);
                    self.spread(texel, ray, scale * cosine * solid_angle, dense);
                }
            }
        }
    }

    /// What a texel and its eight neighbours have in common, if anything.
    fn agreed(&self, open: &[bool], texel: usize) -> Option<bool> {
        let LatLong { rows, columns } = self.grid;
        let (row, column) = (texel / columns, texel % columns);
        // Next to a pole neighbours are on the far side too: always cast there.
        if row == 0 || row + 1 == rows {
            return None;
        }
        let (left, right) = ((column + columns - 1) % columns, (column + 1) % columns);
        let same = (row - 1..=row + 1).all(|r| {
            [left, column, right]
                .iter()
                .all(|c| open[r * columns + c] == open[texel])
        });
        same.then_some(open[texel])
    }
}

/// The surface points that `side` × `side` rays of a pixel meet, each with the direction towards the camera.
pub fn footprint<'a>(
    bvh: &'a Bvh,
    camera: &'a Camera,
    pixel: [usize; 2],
    side: usize,
) -> impl Iterator<Item = (SurfacePoint, Vec3)> + 'a {
    (0..side * side).filter_map(move |s| {
        let x = pixel[0] as f32 + ((s % side) as f32 + 0.5) / side as f32;
        let y = pixel[1] as f32 + ((s / side) as f32 + 0.5) / side as f32;
        bvh.seen(camera, x, y)
    })
}

fn sparse(dense: &[f32]) -> TransportRow {
    let mut row = TransportRow::default();
    for (texel, &weight) in dense.iter().enumerate() {
        if weight > 0.0 {
            row.texel.push(texel as u16);
            row.weight.push(weight);
        }
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    /// A square floor and, optionally, a wall along its middle (y = 0), as high as wide.
    fn scene(wall: bool) -> Bvh {
        let s = 1e3;
        let mut mesh = Mesh {
            positions: vec![
                Vec3::new(-s, -s, 0.0),
                Vec3::new(s, -s, 0.0),
                Vec3::new(s, s, 0.0),
                Vec3::new(-s, s, 0.0),
            ],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        if wall {
            let z = [-s, s].map(|x| [Vec3::new(x, 0.0, -1.0), Vec3::new(x, 0.0, s)]);
            mesh.positions.extend([z[0][0], z[1][0], z[1][1], z[0][1]]);
            mesh.faces.extend([[4, 5, 6], [4, 6, 7]]);
        }
        Bvh::new(&mesh).unwrap()
    }

    const POINT: SurfacePoint = SurfacePoint {
        position: Vec3::new(0.0, -0.5, 0.0),
        normal: Vec3::Z,
        geometric_normal: Vec3::Z,
    };

    #[test]
    fn an_open_plane_receives_pi_and_a_wall_halves_it() {
        let quadrature = Quadrature::new(LatLong::new(50, 100), 2);
        let open: f32 = quadrature.row(&scene(false), &POINT).weight.iter().sum();
        assert!((open / std::f32::consts::PI - 1.0).abs() < 1e-3, "{open}");
        let row = quadrature.row(&scene(true), &POINT);
        let walled: f32 = row.weight.iter().sum();
        assert!((walled / open - 0.5).abs() < 0.01, "{walled}");
        assert!(row.texel.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn a_row_gives_what_rays_through_interpolated_light_give() {
        let grid = LatLong::new(10, 20);
        let quadrature = Quadrature::new(grid, 2);
        let bvh = scene(true);
        let light: Vec<f32> = (0..grid.len()).map(|i| (i * i % 23) as f32).collect();
        let row = quadrature.row(&bvh, &POINT);
        let lit = row.texel.iter().zip(&row.weight);
        let found: f32 = lit.map(|(&t, w)| light[usize::from(t)] * w).sum();
        let mut expected = 0.0;
        for (texel, ray) in (0..grid.len()).flat_map(|t| (0..4).map(move |r| (t, r))) {
            let direction = quadrature.direction(texel, ray);
            let cosine = POINT.normal.dot(direction);
            if cosine > 0.0 && !bvh.blocked(offset_origin(&POINT), direction) {
                expected += cosine
                    * quadrature.solid_angle(texel, ray)
                    * grid.bilinear(direction).gather(&light);
            }
        }
        assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
    }

    #[test]
    fn far_shells_are_looked_up_at_the_texel_itself() {
        let quadrature = Quadrature::new(LatLong::new(20, 40), 2);
        let row = quadrature.row(&scene(false), &POINT);
        let lookups = quadrature.mask_lookups(&row, POINT.position, 1e5);
        for ((texel, index), weight) in row.texel.iter().zip(&lookups.index).zip(&lookups.weight) {
            let own: f32 = (0..4)
                .filter(|&k| index[k] == *texel)
                .map(|k| weight[k])
                .sum();
            assert!(own > 0.99);
        }
    }
}
