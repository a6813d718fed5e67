//! The operator as an upright cutout: one silhouette shared by all frames, standing behind the camera.
//!
//! For frame t the cutout stands in the vertical plane that faces the object's axis at the camera's horizontal distance h
//! from it. A person keeps their size: its coordinates are lengths, in units of the cameras' mean distance from the origin,
//! u to the side, v up from the camera. A ray from the origin meets the plane at (U, V) = (h ω·l / ω·n, h ω_z / ω·n − camera's
//! height), where n, l are the plane's normal and its horizontal direction. A person walks about while photographing, so
//! every frame may shift, scale and widen the silhouette a little.

use glam::Vec3;
use render::{camera::Camera, lat_long::LatLong};

/// Rows and columns of the silhouette's texture.
pub const TEXTURE: LatLong = LatLong::new(72, 56);
/// The texture spans u of ±`REACH` and v from `TOP` down to `BOTTOM`, in units of the cameras' mean distance.
pub const REACH: f32 = 1.4;
/// Upper end of the texture.
pub const TOP: f32 = 0.6;
/// Lower end of the texture.
pub const BOTTOM: f32 = -3.0;
/// Parameters of a frame: shift to the side, shift up, log scale, log extra width; each in units of its standard deviation
/// below.
pub const FRAME_PARAMETERS: usize = 4;
/// Standard deviations of the frame's parameters: a step to the side, the camera's height on the body, a person's size
/// seen from here and there, and turning.
pub const FRAME_SD: [f32; FRAME_PARAMETERS] = [0.08, 0.08, 0.1, 0.1];
/// How far the cutout stands behind the camera: its horizontal distance from the axis over the camera's.
pub const BEHIND: f32 = 1.3;
/// Where a frame's cutout stands.
#[derive(Clone, Copy, Debug)]
pub struct Stand {
    normal: Vec3,
    lateral: Vec3,
    /// Horizontal distance of the cutout from the axis, in the capture's unit.
    pub distance: f32,
    /// The same, and the camera's height, in units of the texture.
    reach: f32,
    height: f32,
}

impl Stand {
    /// Behind each of these cameras.
    pub fn behind_all<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> Vec<Self> {
        let (sum, count) = cameras.clone().fold((0.0, 0), |(sum, n), camera| {
            (sum + camera.distance(), n + 1)
        });
        let unit = (sum / count.max(1) as f32).max(1e-9);
        cameras.map(|camera| Self::behind(camera, unit)).collect()
    }

    /// Behind this camera, lengths measured in `unit`.
    fn behind(camera: &Camera, unit: f32) -> Self {
        let centre = camera.centre();
        // Looking straight down there is no horizontal direction; the plane then stands at a tenth of the distance.
        let distance = BEHIND * centre.truncate().length().max(0.1 * centre.length());
        let normal = Vec3::new(centre.x, centre.y, 0.0)
            .try_normalize()
            .unwrap_or(Vec3::X);
        Self {
            normal,
            lateral: Vec3::new(-normal.y, normal.x, 0.0),
            distance,
            reach: distance / unit,
            height: centre.z / unit,
        }
    }

    /// Where a ray from the origin meets the plane; `None` when it leads elsewhere.
    fn meet(&self, direction: Vec3) -> Option<[f32; 2]> {
        let towards = direction.dot(self.normal);
        (towards > 0.15).then(|| {
            [
                self.reach * direction.dot(self.lateral) / towards,
                self.reach * direction.z / towards - self.height,
            ]
        })
    }
}

/// The start, before anything is known of the operator: logits of how probable it is that a place is behind them.
///
/// Upright people of all the sizes that a capture's unknown scale allows, holding the camera before their eyes.
pub fn someone() -> Vec<f32> {
    const SIZES: usize = 10;
    (0..TEXTURE.len())
        .map(|i| {
            let u =
                ((i % TEXTURE.columns) as f32 + 0.5) / TEXTURE.columns as f32 * 2.0 * REACH - REACH;
            let v =
                TOP - ((i / TEXTURE.columns) as f32 + 0.5) / TEXTURE.rows as f32 * (TOP - BOTTOM);
            let covered = |size: usize| {
                let share = (size as f32 + 0.5) / SIZES as f32;
                sigmoid(person(SMALLEST * (TALLEST / SMALLEST).powf(share), u, v))
            };
            let mean = (0..SIZES).map(covered).sum::<f32>() / SIZES as f32;
            (mean / (1.0 - mean)).ln().clamp(-8.0, 2.0)
        })
        .collect()
}

/// The least height of a person, and the greatest, in units of the cameras' mean distance.
const SMALLEST: f32 = 1.5;
const TALLEST: f32 = 3.3;
/// Half a person's width over their height, arms at their sides.
const HALF_WIDTH: f32 = 0.14;
/// How much of a person is above the camera.
const ABOVE: f32 = 0.06;

/// Logit of opacity at (u, v) of a person of this height.
fn person(height: f32, u: f32, v: f32) -> f32 {
    let middle = (ABOVE - 0.5) * height;
    let r = ((u / (HALF_WIDTH * height)).powi(2) + ((v - middle) / (0.5 * height)).powi(2)).sqrt();
    (6.0 * (1.0 - r)).clamp(-8.0, 8.0)
}

/// The texels of a grid, for each frame, that the cutout may cover as seen from the origin: what the tape needs.
#[derive(Clone, Debug, Default)]
pub struct Sky {
    /// Texel × frames + frame of each.
    pub entry: Vec<u32>,
    /// Frame of each.
    pub frame: Vec<u32>,
    /// (U, V): where the ray from the origin meets the plane.
    pub met: [Vec<f32>; 2],
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
    /// Texture coordinates of a place (U, V) of the plane.
    fn place(&self, frame: usize, met: [f32; 2]) -> Option<Place> {
        let p = &self.frames[frame];
        let scale = (p[2] * FRAME_SD[2]).exp();
        let width = scale * (p[3] * FRAME_SD[3]).exp();
        let u = (met[0] - p[0] * FRAME_SD[0]) / width;
        let v = (met[1] - p[1] * FRAME_SD[1]) / scale;
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

    /// The share of light from `direction` that the origin loses to the cutout.
    pub fn opacity(&self, frame: usize, direction: Vec3) -> f32 {
        let place = self.stands[frame]
            .meet(direction)
            .and_then(|met| self.place(frame, met));
        place.map_or(0.0, |place| sigmoid(place.logit))
    }

    /// The texels of `grid` that the cutout may cover, frame by frame.
    pub fn sky(&self, grid: LatLong) -> Sky {
        let frames = self.stands.len();
        let mut sky = Sky::default();
        for texel in 0..grid.len() {
            let direction = grid.texel_direction(texel / grid.columns, texel % grid.columns);
            for (frame, stand) in self.stands.iter().enumerate() {
                let Some(met) = stand.meet(direction) else {
                    continue;
                };
                let Some(place) = self.place(frame, met) else {
                    continue;
                };
                sky.entry.push((texel * frames + frame) as u32);
                sky.frame.push(frame as u32);
                for i in 0..2 {
                    sky.met[i].push(met[i]);
                    sky.cell[i].push(place.cell[i]);
                }
                for k in 0..4 {
                    sky.corners[k].push(place.corners[k]);
                }
            }
        }
        sky
    }
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
