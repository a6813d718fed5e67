//! The bundled capture and what a perfect solver would make of it: its truth.

use std::{
    path::{Path, PathBuf},
    sync::LazyLock,
};

use eclipse::{
    capture::{Capture, LoadOptions},
    image_io::read_exr,
    layout::numbered,
    reconstruction::{
        CurvePoint, Ended, Metrics, Network, Noise, Photometric, Reconstruction, VertexMaterial,
    },
    settings::Settings,
};
use render::image::Image;

/// The folder of the bundled capture.
pub fn bundled() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("captures/potatoes")
}

/// The bundled capture, read once.
pub fn capture() -> Capture {
    static CAPTURE: LazyLock<Capture> = LazyLock::new(|| {
        Capture::load(&bundled(), &LoadOptions::default()).expect("the bundled capture loads")
    });
    CAPTURE.clone()
}

/// The truth of the bundled capture as a reconstruction: its renders are the photographs.
pub fn reconstruction(capture: &Capture) -> Reconstruction {
    let truth = bundled().join("truth");
    let read = |name: &str| read_exr(&truth.join(name)).expect("the bundled truth can be read");
    let frames = capture.frames.len();
    let stack = read("occluders.exr");
    let occluders = stack.data.chunks_exact(stack.data.len() / frames);
    let material = |index: usize| {
        let albedo = read(&format!("albedo_{}", numbered(index)));
        let mut materials = Image::filled(albedo.width, albedo.height, 5, 0.0);
        let pixels = materials
            .data
            .chunks_exact_mut(5)
            .zip(albedo.data.chunks_exact(3));
        for (material, albedo) in pixels.filter(|(_, albedo)| albedo[0] > 0.0) {
            material[..3].copy_from_slice(albedo);
            material[3..].copy_from_slice(&[0.6, 0.04]);
        }
        materials
    };
    let grey = VertexMaterial {
        albedo: [0.5; 3],
        alpha: 0.36,
        kappa: 0.04,
    };
    let point = |iteration: u64| CurvePoint {
        iteration,
        seconds: 0.5 * iteration as f64,
        loss: 100.0 / iteration as f64,
        samples_per_second: 2e7,
    };
    Reconstruction {
        uncertainty: None,
        environment: read("environment.exr"),
        occluders: occluders
            .map(|map| Image {
                width: stack.width,
                height: stack.height / frames,
                channels: 1,
                data: map.iter().step_by(stack.channels).copied().collect(),
            })
            .collect(),
        materials: (0..frames).map(material).collect(),
        vertex_materials: vec![grey; capture.mesh.positions.len()],
        network: Some(Network {
            extension: "bin".to_owned(),
            bytes: vec![1, 2, 3],
        }),
        renders: capture
            .frames
            .iter()
            .map(|frame| frame.image.clone())
            .collect(),
        curve: (1..=30).map(point).collect(),
        metrics: Metrics {
            photometric: Photometric {
                psnr: Some(41.25),
                psnr_held_out: None,
            },
            ..Default::default()
        },
        noise: Some(Noise {
            read: 2e-3,
            shot: 4e-3,
            relative: 0.01,
        }),
        settings: Settings {
            lambertian: true,
            threads: 2,
            ..Settings::default()
        },
        notes: vec!["frame 003: its mask <ended> empty".to_owned()],
        ended: Ended::TimeLimit,
    }
}
