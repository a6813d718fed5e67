//! A ball under known lamps as a photometric-stereo set records it, drawn by its formula and not by the program's renderer.

use std::path::Path;

use eclipse::{
    capture::{Capture, Frame, Lamp, Lamps},
    image_io::{linear_to_srgb, srgb_to_linear, write_png8},
};
use glam::{Mat4, Vec3};
use render::{
    camera::{Camera, Projection},
    image::Image,
    mesh::Mesh,
    sampler::{SampleKey, Stream},
};
use serde_json::{Value, json};

/// Pixels across and down.
pub const SIZE: usize = 112;
/// Pixels a unit of length; the ball has the radius one.
pub const SCALE: f32 = 50.0;
/// Photographs.
pub const FRAMES: usize = 12;
/// Places of a pixel along each side that are averaged.
const SIDE: usize = 3;

/// The lamps that the capture names: a ring and a few nearer to the camera.
pub fn lamps() -> Vec<Vec3> {
    (0..FRAMES)
        .map(|t| {
            let azimuth = 2.4 * t as f32;
            let tilt = [0.75f32, 0.5, 0.25][t % 3];
            Vec3::new(
                tilt.sin() * azimuth.cos(),
                tilt.sin() * azimuth.sin(),
                tilt.cos(),
            )
        })
        .collect()
}

/// Photographs of the ball by lamps in `shone`, in a capture that says they were in `told`; `sensor` turns frame, place in
/// pixels, and light into values before noise.
pub fn capture(
    told: &[Vec3],
    shone: &[Vec3],
    sensor: impl Fn(usize, [f32; 2], [f32; 3]) -> [f32; 3],
) -> Capture {
    let mut stream = SampleKey {
        seed: 11,
        ..SampleKey::default()
    }
    .stream();
    let world_from_camera = Mat4::from_translation(4.0 * Vec3::Z);
    let middle = [0.5 * SIZE as f32 + 0.3, 0.5 * SIZE as f32 - 0.4];
    let frames = shone.iter().enumerate().map(|(t, lamp)| {
        let camera = Camera {
            projection: Projection::Orthographic,
            focal: [SCALE; 2],
            principal: middle,
            ..Camera::from_fov(SIZE, SIZE, 1.0, world_from_camera)
        };
        let mut image = Image::filled(SIZE, SIZE, 3, 0.0);
        let mut mask = Image::filled(SIZE, SIZE, 1, 0.0);
        for p in 0..SIZE * SIZE {
            let (i, j) = ((p % SIZE) as f32, (p / SIZE) as f32);
            let (mut light, mut inside) = ([0.0f32; 3], 0.0);
            for s in 0..SIDE * SIDE {
                let at = |k: usize| (k as f32 + 0.5) / SIDE as f32;
                let x = (i + at(s % SIDE) - middle[0]) / SCALE;
                let y = (middle[1] - j - at(s / SIDE)) / SCALE;
                let squared = x * x + y * y;
                if squared < 1.0 {
                    let normal = Vec3::new(x, y, (1.0 - squared).sqrt());
                    let shade = normal.dot(*lamp).max(0.0);
                    let share = 1.0 / (SIDE * SIDE) as f32;
                    inside += share;
                    for (c, light) in light.iter_mut().enumerate() {
                        *light += share * albedo(normal, c) * shade;
                    }
                }
            }
            mask.data[p] = inside;
            let value = sensor(t, [i + 0.5, j + 0.5], light);
            for c in 0..3 {
                let deviation = 0.0003 + 0.006 * value[c];
                image.data[3 * p + c] = value[c] + deviation * normal(&mut stream);
            }
        }
        Frame {
            name: format!("{t:02}"),
            camera,
            image,
            mask,
        }
    });
    Capture {
        path: "lit ball".into(),
        frames: frames.collect(),
        mesh: Mesh::sphere(Vec3::ZERO, 1.0, 128),
        centre: Vec3::ZERO,
        lamps: Some(Lamps {
            lamps: told
                .iter()
                .map(|&direction| Lamp {
                    direction,
                    strength: [1.0; 3],
                })
                .collect(),
            ball: true,
        }),
    }
}

/// Writes a capture as photometric-stereo sets are: eight bits, masks as files, a ball for a shape. What its `transforms.json` should
/// hold is left to whoever asks, who may spoil it.
pub fn written(folder: &Path, capture: &Capture) -> Value {
    let frames: Vec<Value> = capture
        .frames
        .iter()
        .zip(&capture.lamps.as_ref().expect("known lamps").lamps)
        .map(|(frame, lamp)| {
            let (file, mask) = (
                format!("{}.png", frame.name),
                format!("{}-mask.png", frame.name),
            );
            write_png8(&folder.join(&file), &frame.image).expect("a photograph");
            write_png8(&folder.join(&mask), &frame.mask).expect("a mask");
            json!({
                "file_path": file, "mask_path": mask,
                "lamp": { "direction": lamp.direction.to_array(), "strength": lamp.strength }
            })
        })
        .collect();
    let [cx, cy] = capture.frames[0].camera.principal;
    json!({
        "camera_model": "ORTHOGRAPHIC", "w": SIZE, "h": SIZE, "pixels_per_unit": SCALE, "cx": cx, "cy": cy,
        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        "shape": { "sphere": { "centre": [0, 0, 0], "radius": 1 } }, "frames": frames
    })
}

/// Rounds photographs to eight bits as PNG files hold them.
pub fn to_eight_bits(capture: &mut Capture) {
    let images = capture.frames.iter_mut().map(|frame| &mut frame.image);
    for value in images.flat_map(|image| &mut image.data) {
        let code = (255.0 * linear_to_srgb(value.clamp(0.0, 1.0))).round();
        *value = srgb_to_linear(code / 255.0);
    }
}

/// A matte paint with faint, broad clouds.
fn albedo(normal: Vec3, c: usize) -> f32 {
    let cloud = (3.0 * normal.x + c as f32).sin() * (2.5 * normal.y - 0.7).cos();
    [0.55, 0.52, 0.5][c] + 0.05 * cloud
}

fn normal(stream: &mut Stream) -> f32 {
    (0..12).map(|_| stream.uniform()).sum::<f32>() - 6.0
}
