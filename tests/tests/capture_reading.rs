//! How a capture is read: which way is up in it, and photographs that are reduced.

use std::{fs, path::Path};

use eclipse::{
    capture::{
        Capture, CaptureError, Lamp, Lamps, LoadOptions, UpAxis, formats::colmap::Encoding, write,
    },
    image_io::{write_exr, write_png8},
};
use eclipse_tests::{
    capture_turned::lying,
    colmap_model,
    small_capture::{SIZE, small_capture},
};
use glam::Vec3;
use render::{camera::Camera, image::Image};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Mesh and cameras in the capture's own frame, away from its origin.
const CENTRE: Vec3 = Vec3::new(0.5, -0.25, 2.0);

fn written(capture: &Capture) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("capture"), capture).unwrap();
    folder
}

fn load(folder: &TempDir, options: &LoadOptions) -> Result<Capture, CaptureError> {
    Capture::load(&folder.path().join("capture"), options)
}

/// Changes `transforms.json`.
fn edit(folder: &TempDir, change: impl FnOnce(&mut Value)) {
    let path = folder.path().join("capture/transforms.json");
    let mut json = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut json);
    fs::write(path, json.to_string()).unwrap();
}

fn up(up: UpAxis) -> LoadOptions {
    LoadOptions {
        up,
        ..LoadOptions::default()
    }
}

/// A direction along none of the axes.
fn oblique() -> UpAxis {
    UpAxis::along(Vec3::new(0.2, -1.8, 0.7)).unwrap()
}

fn at_most(side: usize) -> LoadOptions {
    LoadOptions {
        max_size: Some(side),
        // A few pixels are too few to compare silhouettes closely.
        min_overlap: 0.0,
        ..LoadOptions::default()
    }
}

/// That both are the same scene in the same axes, as far as files hold it.
fn assert_alike(found: &Capture, expected: &Capture) {
    assert!((found.centre - expected.centre).length() < 1e-5);
    assert_eq!(found.mesh.faces, expected.mesh.faces);
    let vectors = |c: &Capture| [c.mesh.positions.clone(), c.mesh.normals.clone()].concat();
    let (a, b) = (vectors(found), vectors(expected));
    assert_eq!(a.len(), b.len());
    assert!(a.iter().zip(&b).all(|(a, b)| (*a - *b).length() < 1e-5));
    for (a, b) in found.frames.iter().zip(&expected.frames) {
        let (pose, other) = (a.camera.world_from_camera, b.camera.world_from_camera);
        assert!(pose.abs_diff_eq(other, 1e-4), "{pose} {other}");
        assert_eq!(a.image, b.image);
    }
    let lamps = |c: &Capture| c.lamps.clone().map(|known| known.lamps);
    let pairs = lamps(found).into_iter().zip(lamps(expected));
    for (a, b) in pairs.flat_map(|(a, b)| a.into_iter().zip(b)) {
        assert!((a.direction - b.direction).length() < 1e-6);
        assert_eq!(a.strength, b.strength);
    }
}

#[test]
fn whichever_axis_points_up_it_is_z_in_what_is_read() {
    let mut made = small_capture(CENTRE);
    let direction = |t: usize| Vec3::new(t as f32 - 2.0, 1.0, 2.0).normalize();
    let lamp = |t| Lamp {
        direction: direction(t),
        strength: [1.0, 0.5, 0.25],
    };
    made.lamps = Some(Lamps {
        lamps: (0..made.frames.len()).map(lamp).collect(),
        ball: false,
    });
    for axis in UpAxis::ALL.into_iter().chain([oblique()]) {
        let folder = written(&lying(&made, axis));
        let found = load(&folder, &up(axis)).unwrap();
        assert!(found.lamps.is_some());
        assert_alike(&found, &made);
        if axis != UpAxis::Z {
            let other = load(&folder, &LoadOptions::default()).unwrap();
            let poses = [&other, &made].map(|c| c.frames[0].camera.world_from_camera);
            assert!(!poses[0].abs_diff_eq(poses[1], 0.1), "{axis:?}");
        }
    }
}

#[test]
fn a_model_of_colmap_is_turned_upright() {
    let made = small_capture(CENTRE);
    let read = |capture: &Capture, axis: UpAxis| {
        let folder = tempfile::tempdir().unwrap();
        colmap_model::write(folder.path(), capture, Encoding::Binary);
        Capture::load(folder.path(), &up(axis)).unwrap()
    };
    let upright = read(&made, UpAxis::Z);
    for axis in [UpAxis::NegY, oblique()] {
        assert_alike(&read(&lying(&made, axis), axis), &upright);
    }
}

#[test]
fn what_is_amiss_is_told_in_the_axes_of_the_files() {
    // A mesh that is mirrored in the x of its file, in a capture whose x points up.
    let mut made = lying(&small_capture(Vec3::ZERO), UpAxis::X);
    for vector in made.mesh.positions.iter_mut().chain(&mut made.mesh.normals) {
        vector.x = -vector.x;
    }
    let folder = written(&made);
    let message = load(&folder, &up(UpAxis::X)).unwrap_err().to_string();
    assert!(message.contains("mirrored in x"), "{message}");
}

#[test]
fn points_stay_where_they_are_in_photographs_that_are_reduced() {
    let folder = written(&small_capture(CENTRE));
    let whole = load(&folder, &LoadOptions::default()).unwrap();
    // By a whole number, and so that the sides are reduced a little differently.
    for (side, size) in [(16, [16, 12]), (50, [50, 38]), (63, [63, 47])] {
        let small = load(&folder, &at_most(side)).unwrap();
        for (frame, full) in small.frames.iter().zip(&whole.frames) {
            assert_eq!([frame.image.width, frame.image.height], size);
            assert_eq!([frame.mask.width, frame.mask.height], size);
            assert_eq!([frame.camera.width, frame.camera.height], size);
            assert_eq!(frame.camera.distortion, full.camera.distortion);
            let place = |camera: &Camera, point: &Vec3| camera.project(*point).unwrap();
            for point in &whole.mesh.positions {
                let (near, far) = (place(&frame.camera, point), place(&full.camera, point));
                for axis in 0..2 {
                    let expected = far[axis] * size[axis] as f32 / SIZE[axis] as f32;
                    assert!((near[axis] - expected).abs() < 1e-3, "{near:?} {far:?}");
                }
            }
            // As much of the object as there was.
            let mean = |mask: &Image| mask.data.iter().sum::<f32>() / mask.data.len() as f32;
            assert!((mean(&frame.mask) - mean(&full.mask)).abs() < 1e-5);
        }
    }
}

#[test]
fn photographs_that_are_small_enough_stay_as_they_are() {
    let folder = written(&small_capture(CENTRE));
    let text = |options: &LoadOptions| format!("{:?}", load(&folder, options).unwrap());
    let whole = text(&LoadOptions::default());
    assert_eq!(text(&at_most(64)), whole);
    assert_eq!(text(&at_most(4000)), whole);
    assert_ne!(text(&at_most(63)), whole);
}

#[test]
fn a_constant_photograph_stays_constant() {
    let mut made = small_capture(CENTRE);
    for frame in &mut made.frames {
        frame.image.data.fill(0.375);
    }
    let folder = written(&made);
    for side in [16, 37, 50] {
        let found = load(&folder, &at_most(side)).unwrap();
        let images = found.frames.iter().map(|frame| &frame.image);
        assert!(images.flat_map(|image| &image.data).all(|v| *v == 0.375));
    }
}

/// Eight-bit values as they are stored, the columns one after the other and again.
fn striped(path: &Path, columns: &[f32], channels: usize) {
    let [width, height] = SIZE;
    let mut image = Image::filled(width, height, channels, 1.0);
    for (k, pixel) in image.data.chunks_exact_mut(channels).enumerate() {
        let colours = channels.min(3);
        pixel[..colours].fill(columns[k % width % columns.len()]);
    }
    write_png8(path, &image).unwrap();
}

#[test]
fn light_is_averaged_and_not_its_codes_and_masks_are_coverage() {
    let folder = written(&small_capture(CENTRE));
    let path = folder.path().join("capture");
    striped(&path.join("stripes.png"), &[0.0, 1.0], 3);
    striped(&path.join("mask.png"), &[1.0, 1.0, 1.0, 0.0], 1);
    edit(&folder, |json| {
        json["frames"][2]["file_path"] = json!("stripes.png");
        json["frames"][2]["mask_path"] = json!("mask.png");
    });
    let options = at_most(16);
    let frame = &load(&folder, &options).unwrap().frames[2];
    assert_eq!([frame.image.width, frame.image.height], [16, 12]);
    assert!(frame.image.data.iter().all(|v| (*v - 0.5).abs() < 1e-6));
    assert!(frame.mask.data.iter().all(|v| *v == 0.75));
}

#[test]
fn files_of_unlike_sizes_are_refused_even_where_they_would_be_alike_in_the_end() {
    let folder = written(&small_capture(CENTRE));
    let half = Image::filled(SIZE[0] / 2, SIZE[1] / 2, 4, 1.0);
    let path = folder.path().join("capture/003.exr");
    write_exr(&path, &half, &["R", "G", "B", "A"]).unwrap();
    edit(&folder, |json| {
        let shared = json.as_object_mut().unwrap();
        shared.remove("w").unwrap();
        shared.remove("h").unwrap();
    });
    let message = load(&folder, &at_most(16)).unwrap_err().to_string();
    assert!(
        message.contains("\"003\"") && message.contains("32×24"),
        "{message}"
    );
    assert!(message.contains("the same intrinsics"), "{message}");
}
