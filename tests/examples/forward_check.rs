//! Renders the truth of captures (environment, albedo, α, κ, occluders where there are any) and compares it with their
//! photographs: χ² per object pixel and channel, and where it is worst.
//!
//! `cargo run --release -p eclipse-tests --example forward_check -- CAPTURE... [--every N] [--frames N] [--side N]`
//!
//! Counted are pixels whose whole 3 × 3 neighbourhood shows the object with n·v ≥ 0.3 and an albedo that varies by less
//! than 0.2 and normals within 25° (n·n' > 0.9): at edges, creases and edges of texture a pixel's mean of albedo × light is
//! not the product of the means, and depends on how its footprint is sampled.

use std::path::{Path, PathBuf};

use eclipse::capture::{Capture, Frame, LoadOptions};
use eclipse::image_io::read_exr;
use glam::Vec3;
use rayon::prelude::*;
use render::bsdf::{Material, Model};
use render::bvh::Bvh;
use render::camera::Camera;
use render::environment::EnvironmentMap;
use render::image::Image;
use render::reference::{Mask, Reference};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// The captures' stated noise: sensor, about 1 % of Monte Carlo noise, and the floor granted to the model.
const SENSOR: (f64, f64) = (4e-6, 1.6e-5);
const MONTE_CARLO: f64 = 0.01;
const MODEL_FLOOR: f64 = 0.005;

/// A pixel rendered and photographed.
struct Compared {
    frame: String,
    pixel: [usize; 2],
    model: [f64; 3],
    photograph: [f64; 3],
    facing: f64,
    contrast: f32,
}

fn main() -> Result<(), Error> {
    let (mut captures, mut every, mut frames, mut side) = (Vec::new(), 40, usize::MAX, 4);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut number = || {
            arguments
                .next()
                .ok_or("a number is missing")?
                .parse::<usize>()
                .map_err(Error::from)
        };
        match argument.as_str() {
            "--every" => every = number()?,
            "--frames" => frames = number()?,
            "--side" => side = number()?,
            path => captures.push(PathBuf::from(path)),
        }
    }
    for path in captures {
        report(&path, &compare(&path, every.max(1), frames, side.max(1))?);
    }
    Ok(())
}

/// Renders every `every`-th pair of neighbouring pixels, as far as they count, of the first `frames` frames.
fn compare(path: &Path, every: usize, frames: usize, side: usize) -> Result<Vec<Compared>, Error> {
    let truth = path.join("truth");
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(truth.join("truth.json"))?)?;
    let number = |field: &str| {
        json[field]
            .as_f64()
            .ok_or(format!("truth.json has no number `{field}`"))
    };
    let (alpha, kappa) = (number("alpha")? as f32, number("kappa")? as f32);
    let model = if json["bsdf"] == "lambert" {
        Model::Lambertian
    } else {
        Model::Microfacet
    };
    let capture = Capture::load(path, &LoadOptions::default())?;
    let bvh = Bvh::new(&capture.mesh)?;
    let environment = EnvironmentMap::new(read_exr(&truth.join("environment.exr"))?)?;
    let occluders = truth.join("occluders.exr");
    let occluders = if occluders.exists() {
        Some(read_exr(&occluders)?)
    } else {
        None
    };
    let reference = Reference::new(&bvh, &environment, model, side);
    let mut compared = Vec::new();
    for (f, frame) in capture.frames.iter().enumerate().take(frames) {
        let albedo = read_exr(&truth.join(format!("albedo_{f:03}.exr")))?;
        let map = occluders
            .as_ref()
            .map(|all| stacked_map(all, f, environment.grid().rows));
        let mask = map.as_ref().map(|m| Mask {
            transmittance: m,
            radius: frame.camera.distance(),
        });
        let width = frame.camera.width;
        let pixels: Vec<usize> = (0..width * frame.camera.height)
            .filter(|p| (p / 2 + 7 * f).is_multiple_of(every))
            .filter(|p| interior(frame, p % width, p / width))
            .collect();
        compared.extend(
            pixels
                .par_iter()
                .filter_map(|p| {
                    let (i, j) = (p % width, p / width);
                    let (surface, outgoing) =
                        bvh.seen(&frame.camera, i as f32 + 0.5, j as f32 + 0.5)?;
                    let facing = f64::from(surface.normal.dot(outgoing));
                    let contrast = contrast(&albedo, i, j);
                    if facing < 0.3
                        || contrast >= 0.2
                        || creased(&bvh, &frame.camera, [i, j], surface.normal)
                    {
                        return None;
                    }
                    let rho = albedo.pixel(i, j);
                    let material = Material {
                        albedo: [rho[0], rho[1], rho[2]],
                        alpha,
                        kappa,
                    };
                    let rendered = reference.pixel(&frame.camera, [i, j], mask, |_| material);
                    let photograph = frame.image.pixel(i, j);
                    Some(Compared {
                        frame: frame.name.clone(),
                        pixel: [i, j],
                        model: [0, 1, 2].map(|c| f64::from(rendered[c])),
                        photograph: [0, 1, 2].map(|c| f64::from(photograph[c])),
                        facing,
                        contrast,
                    })
                })
                .collect::<Vec<_>>(),
        );
    }
    Ok(compared)
}

/// Whether the object fills the pixels around (i, j).
fn interior(frame: &Frame, i: usize, j: usize) -> bool {
    let (width, height) = (frame.camera.width, frame.camera.height);
    let inside = (1..width - 1).contains(&i) && (1..height - 1).contains(&j);
    inside && (0..9).all(|k| frame.mask.pixel(i + k % 3 - 1, j + k / 3 - 1)[0] > 0.999)
}

/// Whether the surface bends sharply, or ends, within the 3 × 3 pixels around (i, j).
fn creased(bvh: &Bvh, camera: &Camera, [i, j]: [usize; 2], normal: Vec3) -> bool {
    (0..9).any(|k| {
        let (x, y) = ((i + k % 3) as f32 - 0.5, (j + k / 3) as f32 - 0.5);
        bvh.seen(camera, x, y)
            .is_none_or(|(surface, _)| surface.normal.dot(normal) < 0.9)
    })
}

/// The largest range of a channel over the 3 × 3 pixels around (i, j).
fn contrast(image: &Image, i: usize, j: usize) -> f32 {
    let range = |c: usize| {
        let values = (0..9).map(|k| image.pixel(i + k % 3 - 1, j + k / 3 - 1)[c]);
        let (low, high) = values.fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    (0..3).map(range).fold(0.0, f32::max)
}

/// Map `f` of a stack of maps, one below the other.
fn stacked_map(stack: &Image, f: usize, rows: usize) -> Image {
    let mut map = Image::filled(stack.width, rows, 1, 0.0);
    for y in 0..rows {
        for x in 0..stack.width {
            map.pixel_mut(x, y)[0] = stack.pixel(x, f * rows + y)[0];
        }
    }
    map
}

fn report(path: &Path, compared: &[Compared]) {
    let variance = |i: f64, monte_carlo: f64| {
        SENSOR.0 + SENSOR.1 * i + (monte_carlo.powi(2) + MODEL_FLOOR.powi(2)) * i * i
    };
    let chi2_of = |p: &Compared, monte_carlo: f64| {
        (0..3)
            .map(|c| (p.photograph[c] - p.model[c]).powi(2) / variance(p.model[c], monte_carlo))
            .sum::<f64>()
            / 3.0
    };
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let chi2 = |monte_carlo: f64| mean(compared.iter().map(|p| chi2_of(p, monte_carlo)).collect());
    let relative: Vec<f64> = compared
        .iter()
        .flat_map(|p| (0..3).map(|c| (p.photograph[c] - p.model[c]) / p.model[c].max(1e-3)))
        .collect();
    let mut sizes: Vec<f64> = relative.iter().map(|r| r.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let robust = 1.4826 * median;
    println!("{}: {} pixels", path.display(), compared.len());
    println!(
        "  chi2 per pixel and channel, stated noise and a model floor of 0.5 %: {:.3}",
        chi2(MONTE_CARLO)
    );
    println!(
        "  ... with 1.5 % of Monte Carlo noise: {:.3}; with 0.3 %: {:.3}",
        chi2(0.015),
        chi2(0.003)
    );
    // Noise is the photograph's and the quadrature's own; what two neighbours have in common is an error of the model.
    let deviation = |p: &Compared, c: usize| {
        (p.photograph[c] - p.model[c]) / variance(p.model[c], MONTE_CARLO).sqrt()
    };
    let neighbours = compared
        .windows(2)
        .filter(|w| w[0].frame == w[1].frame && w[1].pixel == [w[0].pixel[0] + 1, w[0].pixel[1]]);
    let shared: Vec<f64> = neighbours
        .flat_map(|w| (0..3).map(|c| deviation(&w[0], c) * deviation(&w[1], c)))
        .collect();
    println!(
        "  of it shared by {} pairs of neighbours (model error): {:.3}",
        shared.len() / 3,
        mean(shared)
    );
    println!(
        "  relative difference: mean {:+.4}, RMS {:.4}, robust sigma {robust:.4}",
        mean(relative.clone()),
        mean(relative.iter().map(|r| r * r).collect()).sqrt()
    );
    let total: f64 = compared
        .iter()
        .map(|p| p.photograph.iter().map(|v| v * v).sum::<f64>())
        .sum();
    let error: f64 = compared
        .iter()
        .flat_map(|p| (0..3).map(|c| (p.photograph[c] - p.model[c]).powi(2)))
        .sum();
    println!(
        "  RMS difference over RMS radiance: {:.4}",
        (error / total).sqrt()
    );
    let mut worst: Vec<&Compared> = compared.iter().collect();
    worst.sort_by(|a, b| chi2_of(b, MONTE_CARLO).total_cmp(&chi2_of(a, MONTE_CARLO)));
    for p in worst.iter().take(4) {
        println!(
            "  worst: frame {} pixel {:?} chi2 {:.1} model {:.3?} photograph {:.3?} n.v {:.2} albedo contrast {:.2}",
            p.frame,
            p.pixel,
            chi2_of(p, MONTE_CARLO),
            p.model,
            p.photograph,
            p.facing,
            p.contrast
        );
    }
}
