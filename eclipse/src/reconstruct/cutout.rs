//! The operator as an upright cutout: one silhouette shared by all frames, standing behind the camera.
//!
//! For frame t the cutout stands in the vertical plane that faces the object's axis at a distance D_t from it, near the
//! camera's. Its coordinates are in units of that distance: u to the side, v up from the camera's height. A ray x + τω meets
//! the plane at u = U + (x·l − (x·n)U)/D, where U = ω·l / ω·n is where a ray from the origin would meet it and n, l are the
//! plane's normal and its horizontal direction: parallax is linear in the inverse distance. A person walks about while
//! photographing, so every frame may shift, scale and widen the silhouette a little.

use glam::Vec3;
use rayon::prelude::*;
use render::{camera::Camera, lat_long::LatLong};

/// Rows and columns of the silhouette's texture.
pub const TEXTURE: LatLong = LatLong::new(48, 40);
/// The texture spans u of ±`REACH` and v from `TOP` down to `BOTTOM`, in units of the cutout's distance.
pub const REACH: f32 = 1.6;
/// Upper end of the texture.
pub const TOP: f32 = 0.6;
/// Lower end of the texture.
pub const BOTTOM: f32 = -3.4;
/// Parameters of a frame: shift to the side, shift up, log scale, log extra width, log distance; each in units of its
/// standard deviation below.
pub const FRAME_PARAMETERS: usize = 5;
/// Standard deviations of the frame's parameters: a step to the side, the camera's height on the body, a person's size
/// seen from here and there, turning, and standing closer or further than the camera.
pub const FRAME_SD: [f32; FRAME_PARAMETERS] = [0.08, 0.08, 0.1, 0.1, 0.1];
/// Rays whose logit of opacity is below this are left out: they pass, and their gradient is small.
const CLEAR: f32 = -6.0;

/// Where a frame's cutout stands.
#[derive(Clone, Copy, Debug)]
pub struct Stand {
    normal: Vec3,
    lateral: Vec3,
    /// Horizontal distance of the camera from the axis.
    pub distance: f32,
    height: f32,
}

impl Stand {
    /// Behind this camera.
    pub fn behind(camera: &Camera) -> Self {
        let centre = camera.centre();
        // Looking straight down there is no horizontal direction; the plane then stands at a tenth of the distance.
        let distance = centre.truncate().length().max(0.1 * centre.length());
        let normal = Vec3::new(centre.x, centre.y, 0.0)
            .try_normalize()
            .unwrap_or(Vec3::X);
        Self {
            normal,
            lateral: Vec3::new(-normal.y, normal.x, 0.0),
            distance,
            height: centre.z / distance,
        }
    }

    /// Where a ray from the origin meets the plane; `None` when it leads elsewhere.
    fn meet(&self, direction: Vec3) -> Option<[f32; 2]> {
        let towards = direction.dot(self.normal);
        (towards > 0.15).then(|| {
            [
                direction.dot(self.lateral) / towards,
                direction.z / towards - self.height,
            ]
        })
    }
}

/// The start: an upright person, seen from the front, a bit taller than the camera is held.
///
/// Logits of opacity; the person is `height` tall and `half_width` wide at most, in units of the distance.
pub fn person(height: f32, half_width: f32) -> Vec<f32> {
    (0..TEXTURE.len())
        .map(|i| {
            let u =
                ((i % TEXTURE.columns) as f32 + 0.5) / TEXTURE.columns as f32 * 2.0 * REACH - REACH;
            let v =
                TOP - ((i / TEXTURE.columns) as f32 + 0.5) / TEXTURE.rows as f32 * (TOP - BOTTOM);
            let middle = 0.1 - 0.5 * height;
            let r = ((u / half_width).powi(2) + ((v - middle) / (0.5 * height)).powi(2)).sqrt();
            (6.0 * (1.0 - r)).clamp(-8.0, 2.0)
        })
        .collect()
}

/// Rays from patches towards the cutout, in the order of the views they belong to: what the tape needs for its part.
#[derive(Clone, Debug, Default)]
pub struct ShadowRays {
    /// Where the rays of each view start, and their number last.
    pub offsets: Vec<u32>,
    /// Texel of the environment.
    pub texel: Vec<u32>,
    /// Cosine-weighted visible solid angle over π.
    pub weight: Vec<f32>,
    /// (U, V): where a ray from the origin would meet the plane.
    pub from_origin: [Vec<f32>; 2],
    /// Its change with the inverse distance.
    pub parallax: [Vec<f32>; 2],
    /// Lower corner of the texture's cell that the ray meets.
    pub cell: [Vec<f32>; 2],
    /// The cell's four texels: upper left, upper right, lower left, lower right.
    pub corners: [Vec<u32>; 4],
}

/// The silhouette and its frames, as plain numbers.
#[derive(Clone, Debug)]
pub struct Cutout {
    /// Logits of opacity on `TEXTURE`.
    pub texture: Vec<f32>,
    /// Parameters of each frame, in units of their standard deviations.
    pub frames: Vec<[f32; FRAME_PARAMETERS]>,
    /// Where each frame's cutout stands.
    pub stands: Vec<Stand>,
}

/// A place on the texture.
struct Place {
    cell: [f32; 2],
    corners: [u32; 4],
    logit: f32,
}

impl Cutout {
    /// Texture coordinates of a ray with given (U, V) and parallax.
    fn place(&self, frame: usize, from_origin: [f32; 2], parallax: [f32; 2]) -> Option<Place> {
        let p = &self.frames[frame];
        let inverse_distance = (-p[4] * FRAME_SD[4]).exp() / self.stands[frame].distance;
        let scale = (p[2] * FRAME_SD[2]).exp();
        let width = scale * (p[3] * FRAME_SD[3]).exp();
        let u = (from_origin[0] + parallax[0] * inverse_distance - p[0] * FRAME_SD[0]) / width;
        let v = (from_origin[1] + parallax[1] * inverse_distance - p[1] * FRAME_SD[1]) / scale;
        let [x, y] = [texture_x(u), texture_y(v)];
        let inside = x >= 0.0
            && y >= 0.0
            && x < (TEXTURE.columns - 1) as f32
            && y < (TEXTURE.rows - 1) as f32;
        if !inside {
            return None;
        }
        let cell = [x.floor(), y.floor()];
        let first = cell[1] as u32 * TEXTURE.columns as u32 + cell[0] as u32;
        let corners = [
            first,
            first + 1,
            first + TEXTURE.columns as u32,
            first + TEXTURE.columns as u32 + 1,
        ];
        let (fx, fy) = (x - cell[0], y - cell[1]);
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        let logit = corners
            .iter()
            .zip(weights)
            .map(|(&c, w)| w * self.texture[c as usize])
            .sum();
        Some(Place {
            cell,
            corners,
            logit,
        })
    }

    /// The share of light that a ray from `point` loses to the cutout.
    pub fn opacity(&self, frame: usize, point: Vec3, direction: Vec3) -> f32 {
        let stand = &self.stands[frame];
        let Some(from_origin) = stand.meet(direction) else {
            return 0.0;
        };
        let place = self.place(frame, from_origin, parallax(stand, point, from_origin));
        place.map_or(0.0, |place| sigmoid(place.logit))
    }

    /// The rays of each view (patch position, frame) that the cutout may stop, out of the patch's row of the transport.
    ///
    /// `rows` is `[patch][texel]`.
    pub fn rays(
        &self,
        grid: LatLong,
        positions: &[Vec3],
        rows: &[f32],
        views: &[(u32, u32)],
    ) -> ShadowRays {
        let directions: Vec<Vec3> = (0..grid.len())
            .map(|d| grid.texel_direction(d / grid.columns, d % grid.columns))
            .collect();
        let reach =
            |uv: &[f32; 2]| uv[0].abs() < 1.5 * REACH && uv[1] < TOP + 0.4 && uv[1] > 1.3 * BOTTOM;
        let ahead: Vec<Vec<(u32, [f32; 2])>> = self
            .stands
            .par_iter()
            .map(|stand| {
                let met = directions
                    .iter()
                    .enumerate()
                    .filter_map(|(d, &w)| Some((d as u32, stand.meet(w)?)));
                met.filter(|(_, uv)| reach(uv)).collect()
            })
            .collect();
        let chunk = views.len().div_ceil(64).max(1);
        let parts: Vec<ShadowRays> = views
            .par_chunks(chunk)
            .map(|views| {
                let mut rays = ShadowRays::default();
                for &(patch, frame) in views {
                    let stand = &self.stands[frame as usize];
                    let row = &rows[patch as usize * grid.len()..][..grid.len()];
                    for &(texel, uv) in &ahead[frame as usize] {
                        let weight = row[texel as usize];
                        if weight == 0.0 {
                            continue;
                        }
                        let shift = parallax(stand, positions[patch as usize], uv);
                        if let Some(place) = self
                            .place(frame as usize, uv, shift)
                            .filter(|p| p.logit > CLEAR)
                        {
                            rays.push(texel, weight, uv, shift, &place);
                        }
                    }
                    rays.offsets.push(rays.texel.len() as u32);
                }
                rays
            })
            .collect();
        ShadowRays::join(parts)
    }
}

impl ShadowRays {
    fn push(&mut self, texel: u32, weight: f32, uv: [f32; 2], shift: [f32; 2], place: &Place) {
        self.texel.push(texel);
        self.weight.push(weight);
        for i in 0..2 {
            self.from_origin[i].push(uv[i]);
            self.parallax[i].push(shift[i]);
            self.cell[i].push(place.cell[i]);
        }
        for k in 0..4 {
            self.corners[k].push(place.corners[k]);
        }
    }

    fn join(parts: Vec<Self>) -> Self {
        let mut all = Self {
            offsets: vec![0],
            ..Self::default()
        };
        for part in parts {
            let start = all.texel.len() as u32;
            all.offsets.extend(part.offsets.iter().map(|o| o + start));
            all.texel.extend(part.texel);
            all.weight.extend(part.weight);
            for (all, part) in all.from_origin.iter_mut().zip(part.from_origin) {
                all.extend(part);
            }
            for (all, part) in all.parallax.iter_mut().zip(part.parallax) {
                all.extend(part);
            }
            for (all, part) in all.cell.iter_mut().zip(part.cell) {
                all.extend(part);
            }
            for (all, part) in all.corners.iter_mut().zip(part.corners) {
                all.extend(part);
            }
        }
        all
    }
}

fn parallax(stand: &Stand, point: Vec3, from_origin: [f32; 2]) -> [f32; 2] {
    let along = point.dot(stand.normal);
    let height = from_origin[1] + stand.height;
    [
        point.dot(stand.lateral) - along * from_origin[0],
        point.z - along * height,
    ]
}

/// The texture's column coordinate, texel centres at integers.
pub fn texture_x(u: f32) -> f32 {
    (u + REACH) * (TEXTURE.columns as f32 / (2.0 * REACH)) - 0.5
}

/// The texture's row coordinate, texel centres at integers.
pub fn texture_y(v: f32) -> f32 {
    (TOP - v) * (TEXTURE.rows as f32 / (TOP - BOTTOM)) - 0.5
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}
