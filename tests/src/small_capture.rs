//! A small capture of an object without any symmetry, made in memory, and one on disk that is reconstructed in a moment.

use std::{
    f32::consts::TAU,
    path::{Path, PathBuf},
    sync::LazyLock,
};

use eclipse::{
    capture::{Capture, Frame},
    synthesize::{self, Occluders, Pattern, Scene, Shooting},
};
use glam::Vec3;
use render::{bsdf::Model, bvh::Bvh, camera::Camera, image::Image, lat_long::LatLong, mesh::Mesh};
use tempfile::TempDir;

use crate::scenes;

/// Pixels across and down.
pub const SIZE: [usize; 2] = [64, 48];

/// A capture of six frames around [`boxes`], whose own frame is shifted by `centre`.
pub fn small_capture(centre: Vec3) -> Capture {
    let mesh = boxes();
    let bvh = Bvh::new(&mesh).expect("the boxes are a mesh");
    let frames = (0..6).map(|index| {
        let azimuth = index as f32 / 6.0 * TAU;
        let eye = 5.0 * Vec3::new(azimuth.cos(), azimuth.sin(), 0.2 + 0.1 * index as f32);
        let mut camera = Camera::look_at(SIZE[0], SIZE[1], 0.6, eye, Vec3::ZERO);
        camera.distortion = [-0.05, 0.01, 0.002, -0.001];
        camera.principal[0] += 1.5;
        let mask = Image {
            width: SIZE[0],
            height: SIZE[1],
            channels: 1,
            data: bvh.coverage(&camera, 4),
        };
        let value = |i: usize| (i % 97) as f32 / 64.0;
        let data = (0..SIZE[0] * SIZE[1] * 3).map(value).collect();
        let image = Image {
            width: SIZE[0],
            height: SIZE[1],
            channels: 3,
            data,
        };
        Frame {
            name: format!("{index:03}"),
            camera,
            image,
            mask,
        }
    });
    Capture {
        lamps: None,
        path: "small".into(),
        frames: frames.collect(),
        mesh,
        centre,
    }
}

/// The folder of a synthetic capture of [`boxes`]: eight frames of 24 × 24 with an operator, made once a process.
pub fn on_disk() -> &'static Path {
    static FOLDER: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
        let shooting = Shooting {
            frames: 8,
            resolution: 24,
            distance: 4.0,
            noise: 0.002,
            seed: 1,
        };
        written(&matte(), &shooting)
    });
    &FOLDER.1
}

/// The folder of another, whose boxes are glossy: enough photographs for a run to tell that somebody stood in the light, and light
/// of enough contrast for it to see a highlight.
pub fn glossy_on_disk() -> &'static Path {
    static FOLDER: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
        let mut scene = Scene {
            model: Model::Microfacet,
            alpha: 0.4,
            kappa: 0.2,
            ..matte()
        };
        scene.albedo.mean = [0.5, 0.45, 0.4];
        let shooting = Shooting {
            frames: 12,
            resolution: 32,
            distance: 5.0,
            noise: 0.002,
            seed: 0,
        };
        written(&scene, &shooting)
    });
    &FOLDER.1
}

/// Matte boxes in a room, past which somebody walks.
fn matte() -> Scene {
    Scene {
        mesh: boxes(),
        environment: scenes::interior(LatLong::new(50, 100)).image().clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.5; 3],
            variation: 0.2,
        },
        alpha: 0.5,
        kappa: 0.0,
        occluders: Occluders::Operator,
    }
}

fn written(scene: &Scene, shooting: &Shooting) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("capture");
    let made = synthesize::synthesize(scene, shooting, |_| true).expect("a valid scene");
    synthesize::write(&path, scene, &made).expect("an empty folder");
    (folder, path)
}

/// Three boxes along the axes, of different lengths, joined in a corner; the bounding box is centred at the origin.
pub fn boxes() -> Mesh {
    let mut mesh = Mesh::default();
    for (low, high) in [
        ([0.0, 0.0, 0.0], [1.6, 0.4, 0.4]),
        ([0.0, 0.0, 0.0], [0.4, 1.1, 0.3]),
        ([0.1, 0.1, 0.0], [0.3, 0.3, 0.8]),
    ] {
        let offset = Vec3::new(0.8, 0.55, 0.4);
        add_box(
            &mut mesh,
            Vec3::from(low) - offset,
            Vec3::from(high) - offset,
        );
    }
    mesh
}

fn add_box(mesh: &mut Mesh, low: Vec3, high: Vec3) {
    // Each side has its own four vertices, for its own normal.
    for axis in 0..3 {
        for top in [false, true] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let base = mesh.positions.len() as u32;
            for (at_u, at_v) in [(false, false), (true, false), (true, true), (false, true)] {
                let mut position = low;
                for (axis, high_side) in [(axis, top), (u, at_u), (v, at_v)] {
                    position[axis] = if high_side { high[axis] } else { low[axis] };
                }
                mesh.positions.push(position);
                let mut normal = Vec3::ZERO;
                normal[axis] = if top { 1.0 } else { -1.0 };
                mesh.normals.push(normal);
            }
            let faces = if top {
                [[0, 1, 2], [0, 2, 3]]
            } else {
                [[0, 2, 1], [0, 3, 2]]
            };
            mesh.faces
                .extend(faces.map(|face| face.map(|index| base + index)));
        }
    }
}
