//! The paper's idea in one picture: the light of a room, recovered from photographs of a matt object, when whoever took them is
//! modelled and when they are not.
//!
//! `cargo run --release -p eclipse --example unseen -- [PICTURE.png]`: about two minutes on two cores.
//!
//! Top to bottom: the true light, the light recovered with occluders, the light recovered without.

use std::{error::Error, path::Path};

use eclipse::{
    control::Control,
    evaluate::environment,
    image_io::{linear_to_srgb, write_png8},
    reconstruct,
    settings::Settings,
    synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
};
use glam::Vec3;
use render::{bsdf::Model, image::Image, lat_long::LatLong, mesh::Mesh};

/// Seconds for each of the two reconstructions.
const SECONDS: f64 = 50.0;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "target/unseen.png".to_owned());
    let light = room();
    let scene = Scene {
        mesh: pebble(),
        environment: light.clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.5, 0.45, 0.4],
            variation: 0.15,
        },
        alpha: 0.5,
        kappa: 0.0,
        occluders: Occluders::Operator,
    };
    let shooting = Shooting {
        frames: 32,
        resolution: 96,
        distance: 4.0,
        noise: 0.003,
        seed: 1,
    };
    println!("photographing …");
    let capture = synthesize(&scene, &shooting, |_| true)?.capture;
    let mut rows = vec![light.clone()];
    for occluders in [true, false] {
        println!(
            "reconstructing, occluders {} …",
            if occluders {
                "modelled"
            } else {
                "not modelled"
            }
        );
        let settings = Settings {
            lambertian: true,
            occluders,
            time_limit: Some(SECONDS),
            ..Settings::default()
        };
        let found = reconstruct::run(&capture, &settings, &Control::detached())?;
        // Light and albedo share a scale that photographs cannot tell: compared after the best one.
        let compared = environment::compare(&found.environment, &light);
        let error = compared
            .score
            .texels
            .relative_rmse_aligned
            .unwrap_or(f64::NAN);
        println!("  relative error of the light {error:.2}");
        rows.push(scaled(&found.environment, &light));
    }
    write_png8(Path::new(&path), &stacked(&rows))?;
    println!("wrote {path}");
    Ok(())
}

/// A dim room with a window and two lamps.
fn room() -> Image {
    let grid = LatLong::new(50, 100);
    let mut image = Image::filled(100, 50, 3, 0.0);
    let lamps = [
        (Vec3::new(0.7, 0.5, 0.5), 0.965, [9.0, 7.0, 4.0]),
        (Vec3::new(-0.8, 0.3, 0.3), 0.975, [4.0, 6.0, 9.0]),
    ];
    for row in 0..50 {
        for column in 0..100 {
            let d = grid.texel_direction(row, column);
            let mut value = [0.25 + 0.1 * d.z, 0.25 + 0.1 * d.z, 0.28 + 0.1 * d.z];
            let window =
                (column as i32 - 62).abs() < 7 && (row as i32 - 18).abs() < 7 && column != 62;
            if window {
                value = [3.0, 3.4, 4.0];
            }
            for (direction, cosine, colour) in lamps {
                if d.dot(direction.normalize()) > cosine {
                    value = colour;
                }
            }
            image.pixel_mut(column, row).copy_from_slice(&value);
        }
    }
    image
}

/// A smooth object that faces every way.
fn pebble() -> Mesh {
    let mut mesh = Mesh::sphere(Vec3::ZERO, 1.0, 64);
    for position in &mut mesh.positions {
        let d = *position;
        let bump = 1.0 + 0.12 * (3.0 * d.x + 1.0).sin() * (4.0 * d.y).cos();
        *position = bump * d * Vec3::new(1.0, 0.9, 0.8);
    }
    // The ball's normals are no longer right; they are made anew from the faces.
    mesh.normals.clear();
    mesh
}

/// The map times the factor a channel that brings it closest to `target`.
fn scaled(image: &Image, target: &Image) -> Image {
    let mut scaled = image.clone();
    for c in 0..3 {
        let pairs = || {
            let channel = |map: &'_ Image| {
                map.data
                    .iter()
                    .skip(c)
                    .step_by(3)
                    .copied()
                    .collect::<Vec<f32>>()
            };
            channel(image).into_iter().zip(channel(target))
        };
        let factor =
            pairs().map(|(a, b)| a * b).sum::<f32>() / pairs().map(|(a, _)| a * a).sum::<f32>();
        scaled
            .data
            .iter_mut()
            .skip(c)
            .step_by(3)
            .for_each(|value| *value *= factor);
    }
    scaled
}

/// Maps one below the other, four pixels a texel, for display.
fn stacked(maps: &[Image]) -> Image {
    const ZOOM: usize = 4;
    let (width, height) = (maps[0].width * ZOOM, maps[0].height * ZOOM);
    let mut all = Image::filled(width, height * maps.len(), 3, 0.0);
    for y in 0..all.height {
        for x in 0..width {
            let texel = maps[y / height].pixel(x / ZOOM, y % height / ZOOM).to_vec();
            let display = all.pixel_mut(x, y);
            (0..3).for_each(|c| display[c] = linear_to_srgb((0.8 * texel[c]).clamp(0.0, 1.0)));
        }
    }
    all
}
