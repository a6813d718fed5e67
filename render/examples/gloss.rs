//! Balls from matt to nearly a mirror in a room with a window and a lamp; below, the same with somebody unseen before the
//! window: the glossier a ball, the more of their outline it keeps.
//!
//! `cargo run --release -p render --example gloss -- [PICTURE.png]`

use std::error::Error;

use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    camera::Camera,
    environment::EnvironmentMap,
    image::Image,
    lat_long::LatLong,
    mesh::Mesh,
    reference::{Mask, Reference},
};

/// Pixels across each ball's picture.
const SIDE: usize = 180;
/// Width of the lobe of each ball, left to right; the first has none.
const ALPHAS: [f32; 5] = [1.0, 0.6, 0.35, 0.2, 0.1];
/// Where the window is, and whoever stands before it.
const WINDOW: Vec3 = Vec3::new(0.45, -0.8, 0.4);

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "target/gloss.png".to_owned());
    let bvh = Bvh::new(&Mesh::sphere(Vec3::ZERO, 1.0, 96))?;
    let grid = LatLong::new(50, 100);
    let environment = EnvironmentMap::new(map(grid, room))?;
    let somebody = map(grid, |d| [passes(d); 3]);
    let transmittance = Image {
        channels: 1,
        data: somebody.data.iter().step_by(3).copied().collect(),
        ..somebody
    };
    let camera = Camera::look_at(SIDE, SIDE, 0.52, Vec3::new(0.8, -4.0, 0.9), Vec3::ZERO);
    let mask = Mask {
        transmittance: &transmittance,
        radius: camera.distance(),
    };
    let mut picture = image::RgbImage::new((SIDE * ALPHAS.len()) as u32, (2 * SIDE) as u32);
    for (column, alpha) in ALPHAS.into_iter().enumerate() {
        let model = if column == 0 {
            Model::Lambertian
        } else {
            Model::Microfacet
        };
        let reference = Reference::new(&bvh, &environment, model, 4);
        let material = Material {
            albedo: [0.32, 0.20, 0.12],
            alpha,
            kappa: 0.25,
        };
        for (row, mask) in [None, Some(mask)].into_iter().enumerate() {
            let frame = reference.frame(&camera, mask, |_| material);
            for (index, pixel) in frame.data.chunks_exact(4).enumerate() {
                let place = [
                    (column * SIDE + index % SIDE) as u32,
                    (row * SIDE + index / SIDE) as u32,
                ];
                // On white, where the ball does not cover the pixel.
                let display = |c: usize| srgb(pixel[c] + (1.0 - pixel[3]));
                picture.put_pixel(place[0], place[1], image::Rgb([0, 1, 2].map(display)));
            }
        }
    }
    picture.save(&path)?;
    println!("wrote {path}");
    Ok(())
}

/// A dim room with a window in two panes and a warm lamp behind.
fn room(d: Vec3) -> [f32; 3] {
    let [across, up] = on_window(d);
    let pane = d.dot(WINDOW) > 0.0 && across.abs() < 0.5 && up.abs() < 0.4 && across.abs() > 0.04;
    let lamp = d.dot(Vec3::new(-0.8, -0.3, 0.5).normalize()) > 0.985;
    let sky = 0.10 + 0.06 * d.z;
    match (pane, lamp) {
        (true, _) => [2.2, 2.5, 3.0],
        (_, true) => [14.0, 10.0, 6.0],
        _ => [sky, sky, 1.1 * sky],
    }
}

/// The share of light from a direction that gets past a head and shoulders before the window.
fn passes(d: Vec3) -> f32 {
    let [across, up] = on_window(d);
    let head = (across / 0.11).hypot((up - 0.16) / 0.14) < 1.0;
    let shoulders = up < 0.02 && across.abs() < 0.26;
    if d.dot(WINDOW) > 0.0 && (head || shoulders) {
        0.0
    } else {
        1.0
    }
}

/// Where a direction meets the plane of the window, from its middle.
fn on_window(d: Vec3) -> [f32; 2] {
    let ahead = WINDOW.normalize();
    let right = ahead.cross(Vec3::Z).normalize();
    let point = d / d.dot(ahead).max(1e-6);
    [point.dot(right), point.dot(right.cross(ahead))]
}

fn map(grid: LatLong, value: impl Fn(Vec3) -> [f32; 3]) -> Image {
    // Several directions a texel: outlines do not follow the grid.
    const PARTS: usize = 4;
    let mut image = Image::filled(grid.columns, grid.rows, 3, 0.0);
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            for part in 0..PARTS * PARTS {
                let place = [part % PARTS, part / PARTS].map(|k| (k as f32 + 0.5) / PARTS as f32);
                let found = value(grid.direction_within(row, column, place));
                let texel = image.pixel_mut(column, row);
                (0..3).for_each(|c| texel[c] += found[c] / (PARTS * PARTS) as f32);
            }
        }
    }
    image
}

fn srgb(linear: f32) -> u8 {
    let v = linear.clamp(0.0, 1.0);
    let encoded = if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * encoded).round() as u8
}
