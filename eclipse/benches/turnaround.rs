//! What people wait for around a solve: reading a large capture, and writing its report.
//!
//! `cargo bench -p eclipse --bench turnaround [FRAMES]`: 256 photographs of 400 × 400 pixels and a mesh of 102,400 triangles,
//! as EXR and as PNG. The project's bars are 5 s for loading and 10 s for the report.

use std::{error::Error, fs, path::Path, time::Instant};

use eclipse::{
    capture::{self, Capture, Frame, LoadOptions},
    image_io::write_png8,
    layout::REPORT,
    output,
    reconstruction::{CurvePoint, Ended, Metrics, Noise, Reconstruction, VertexMaterial},
    report::{self, ReportOptions},
    settings::Settings,
};
use glam::Vec3;
use rayon::prelude::*;
use render::{bvh::Bvh, camera::Camera, image::Image, lat_long::LatLong, mesh::Mesh};

const FRAMES: usize = 256;
const SIDE: usize = 400;
/// Rows of the mesh's grid: four times their square triangles.
const ROWS: u32 = 160;

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo passes `--bench`.
    let number = std::env::args().skip(1).find_map(|word| word.parse().ok());
    let frames = number.unwrap_or(FRAMES);
    let folder = tempfile::tempdir()?;
    let made = photographed(frames);
    println!(
        "{frames} photographs of {SIDE} x {SIDE}, {} triangles, {} threads",
        made.mesh.faces.len(),
        rayon::current_num_threads()
    );

    let exr = folder.path().join("exr");
    capture::write(&exr, &made)?;
    let png = folder.path().join("png");
    as_png(&exr, &png, &made)?;
    for path in [&exr, &png] {
        let began = Instant::now();
        let loaded = Capture::load(path, &LoadOptions::default())?;
        assert_eq!(loaded.frames.len(), frames);
        told(
            &format!(
                "loading, {}",
                path.file_name().unwrap_or_default().display()
            ),
            began,
            Some(5.0),
        );
    }

    let solved = solved(&made);
    let began = Instant::now();
    let page = report::html(&made, &solved, &ReportOptions::new("eclipse"))?;
    fs::write(folder.path().join(REPORT), &page)?;
    told("report", began, Some(10.0));
    println!("{:>28} {:.1} MB", "its size", page.len() as f64 / 1e6);
    let began = Instant::now();
    let out = folder.path().join("out");
    output::write(&out, &made, &solved, &ReportOptions::new("eclipse"))?;
    told("all outputs, report included", began, None);
    Ok(())
}

fn told(what: &str, began: Instant, bar: Option<f64>) {
    let seconds = began.elapsed().as_secs_f64();
    let bar = bar.map_or(String::new(), |bar| format!("  (bar: {bar:.0} s)"));
    println!("{what:>28} {seconds:.2} s{bar}");
}

/// A capture of a bumpy ball on a spiral; what is on the photographs does not matter, but it does not compress better than
/// photographs do.
fn photographed(frames: usize) -> Capture {
    let mesh = bumpy();
    let bvh = Bvh::new(&mesh).expect("a valid mesh");
    let photograph = |index: usize| {
        let height = 0.9 - 1.2 * index as f32 / frames as f32;
        let around = 2.399_963 * index as f32;
        let across = (1.0 - height * height).sqrt();
        let eye = 5.0 * Vec3::new(across * around.cos(), across * around.sin(), height);
        let camera = Camera::look_at(SIDE, SIDE, 0.55, eye, Vec3::ZERO);
        let mask = Image {
            width: SIDE,
            height: SIDE,
            channels: 1,
            data: bvh.coverage(&camera, 2),
        };
        let mut image = Image::filled(SIDE, SIDE, 3, 0.0);
        for (pixel, texel) in image.data.chunks_exact_mut(3).enumerate() {
            let (x, y) = ((pixel % SIDE) as f32, (pixel / SIDE) as f32);
            let grain = (pixel.wrapping_mul(2_654_435_761) >> 11 & 15) as f32 / 1000.0;
            let shade = 0.4 + 0.3 * (0.02 * x).sin() * (0.03 * y).cos() + grain;
            texel.fill(shade * mask.data[pixel]);
        }
        Frame {
            name: format!("{index:03}"),
            camera,
            image,
            mask,
        }
    };
    Capture {
        path: "turnaround".into(),
        frames: (0..frames).into_par_iter().map(photograph).collect(),
        mesh,
        centre: Vec3::ZERO,
        lamps: None,
    }
}

fn bumpy() -> Mesh {
    let columns = 2 * ROWS;
    let mut mesh = Mesh::default();
    for row in 0..=ROWS {
        for column in 0..columns {
            let (u, v) = (column as f32 / columns as f32, row as f32 / ROWS as f32);
            let d = LatLong::direction(u, v);
            let bump = 1.0 + 0.05 * (9.0 * d.x).sin() * (7.0 * d.y).sin() * (8.0 * d.z).cos();
            mesh.positions.push(bump * d);
        }
    }
    let at = |row: u32, column: u32| row * columns + column % columns;
    for row in 0..ROWS {
        for column in 0..columns {
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
            mesh.faces.extend([[a, c, d], [a, d, b]]);
        }
    }
    mesh.ensure_normals();
    mesh
}

/// The same capture with PNG photographs, as most people have them.
fn as_png(exr: &Path, png: &Path, made: &Capture) -> Result<(), Box<dyn Error>> {
    fs::create_dir(png)?;
    fs::copy(exr.join("mesh.glb"), png.join("mesh.glb"))?;
    let text = fs::read_to_string(exr.join("transforms.json"))?;
    let mut transforms: serde_json::Value = serde_json::from_str(&text)?;
    let frames = transforms["frames"].as_array_mut().ok_or("no frames")?;
    for (record, frame) in frames.iter_mut().zip(&made.frames) {
        let name = format!("{}.png", frame.name);
        let pixels = frame.image.data.chunks_exact(3).zip(&frame.mask.data);
        let rgba = Image {
            width: SIDE,
            height: SIDE,
            channels: 4,
            data: pixels
                .flat_map(|(rgb, &alpha)| [rgb[0], rgb[1], rgb[2], alpha])
                .collect(),
        };
        write_png8(&png.join(&name), &rgba)?;
        record["file_path"] = name.into();
    }
    fs::write(png.join("transforms.json"), transforms.to_string())?;
    Ok(())
}

/// A result of the capture's size.
fn solved(capture: &Capture) -> Reconstruction {
    let photographs = || capture.frames.iter().map(|frame| &frame.image);
    let materials = |image: &Image| Image {
        channels: 5,
        data: image
            .data
            .chunks_exact(3)
            .flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 0.4, 0.04])
            .collect(),
        ..*image
    };
    let point = |iteration: u64| CurvePoint {
        iteration,
        seconds: iteration as f64,
        loss: 1e5 / (1.0 + iteration as f64),
        samples_per_second: 1e7,
    };
    let vertex = |position: &Vec3| VertexMaterial {
        albedo: [0.5 + 0.3 * position.x.sin(); 3],
        alpha: 0.4,
        kappa: 0.04,
    };
    let mut mask = Image::filled(100, 50, 1, 1.0);
    mask.data[2200..2240].fill(0.0);
    Reconstruction {
        environment: Image::filled(100, 50, 3, 0.7),
        occluders: vec![mask; capture.frames.len()],
        materials: photographs().map(materials).collect(),
        vertex_materials: capture.mesh.positions.iter().map(vertex).collect(),
        uncertainty: None,
        network: None,
        renders: photographs().cloned().collect(),
        curve: (0..200).map(point).collect(),
        metrics: Metrics::default(),
        noise: Some(Noise {
            read: 2e-3,
            shot: 4e-3,
            relative: 0.01,
        }),
        settings: Settings::default(),
        notes: Vec::new(),
        ended: Ended::Converged,
    }
}
