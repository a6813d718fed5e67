//! `eclipse relight` for Stanford-ORB: pictures by the names of the frames, each under its own map in the axes of its camera, in a
//! folder that `eclipse evaluate` reads.

use std::{
    f32::consts::{PI, TAU},
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use eclipse::{
    image_io::{read_exr, write_exr, write_png8},
    output,
    relight::pose_rows,
    report::ReportOptions,
};
use eclipse_tests::{
    perfect,
    program::{self, stderr, stdout, text},
    scenes,
};
use glam::Vec3;
use render::{camera::Camera, environment::EnvironmentMap, image::Image, lat_long::LatLong};
use serde_json::{Value, json};

/// Horizontal angle of view, in radians: the object fills a small part of the picture and is rendered in a moment.
const ANGLE: f32 = 0.8;
/// Distance of the cameras, in bounding radii.
const DISTANCE: f32 = 12.0;

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}

fn done(arguments: &[&str]) -> Output {
    let output = eclipse(arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
    output
}

/// A run's folder, and two cameras of its object that look from different sides.
fn run_folder(folder: &Path) -> (PathBuf, Vec<Camera>, Vec3) {
    let capture = perfect::capture();
    let run = folder.join("run");
    let solved = perfect::reconstruction(&capture);
    output::write(&run, &capture, &solved, &ReportOptions::default()).unwrap();
    let radius = capture.mesh.bounding_radius();
    let toward = [Vec3::new(1.0, 0.2, 0.3), Vec3::new(-0.5, 1.0, 0.6)];
    let cameras = toward.map(|toward| {
        let eye = DISTANCE * radius * toward.normalize();
        Camera::look_at(512, 512, ANGLE, eye, Vec3::ZERO)
    });
    (run, cameras.to_vec(), capture.centre)
}

/// A cameras file with these names of frames, and scenes.
fn transforms(path: &Path, frames: &[(&str, Option<&str>)], cameras: &[Camera], centre: Vec3) {
    let frames: Vec<Value> = frames
        .iter()
        .zip(cameras)
        .map(|((file, scene), camera)| {
            let mut frame = json!({
                "file_path": file,
                "camera_angle_x": ANGLE,
                "transform_matrix": pose_rows(camera, centre),
            });
            if let Some(scene) = scene {
                frame["scene_name"] = json!(scene);
            }
            frame
        })
        .collect();
    let text = json!({"w": 512, "h": 512, "frames": frames}).to_string();
    fs::write(path, text).unwrap();
}

/// The map in the axes of `camera`, by the benchmark's own formula: the middle is −z, +x to its right, the top row +y.
fn in_camera_axes(light: &EnvironmentMap, camera: &Camera) -> Image {
    let (rows, columns) = (128, 256);
    let mut map = Image::filled(columns, rows, 3, 0.0);
    for row in 0..rows {
        for column in 0..columns {
            let theta = PI * (row as f32 + 0.5) / rows as f32;
            let phi = TAU * ((column as f32 + 0.5) / columns as f32 - 0.5);
            let across = theta.sin();
            let d = Vec3::new(across * phi.sin(), theta.cos(), -across * phi.cos());
            let world = camera.world_from_camera.transform_vector3(d);
            let radiance = light.radiance(world);
            map.pixel_mut(column, row).copy_from_slice(&radiance);
        }
    }
    map
}

/// How far two pictures are apart on the object, relative to the first, root mean square over means of blocks: noise aside.
fn apart(a: &Path, b: &Path) -> f64 {
    const BLOCK: usize = 8;
    let (a, b) = (read_exr(a).unwrap(), read_exr(b).unwrap());
    let (mut difference, mut size) = (0.0, 0.0);
    for top in (0..512).step_by(BLOCK) {
        for left in (0..512).step_by(BLOCK) {
            for channel in 0..3 {
                let sum = |image: &Image| -> f64 {
                    let pixels = (0..BLOCK * BLOCK)
                        .map(|k| image.pixel(left + k % BLOCK, top + k / BLOCK)[channel]);
                    pixels.map(f64::from).sum()
                };
                let (of_a, of_b) = (sum(&a), sum(&b));
                difference += (of_a - of_b).powi(2);
                size += of_a.powi(2);
            }
        }
    }
    assert!(size > 0.0, "nothing is to be seen");
    (difference / size).sqrt()
}

#[test]
fn what_relight_writes_for_the_benchmark_is_what_evaluate_reads() {
    let folder = tempfile::tempdir().unwrap();
    let (run, cameras, centre) = run_folder(folder.path());
    let at = |name: &str| folder.path().join(name);
    let light = scenes::interior(LatLong::new(50, 100));
    let map = at("light.exr");
    write_exr(&map, light.image(), &["R", "G", "B"]).unwrap();

    // A scene with a view of its own, and one of another scene.
    let (own, other) = (at("orb/cup_scene001"), at("orb/cup_scene002"));
    fs::create_dir_all(&own).unwrap();
    let (test, novel) = (
        own.join("transforms_test.json"),
        own.join("transforms_novel.json"),
    );
    transforms(&test, &[("test/0001", None)], &cameras[..1], centre);
    let of_other = [("test/0003", Some("cup_scene002"))];
    transforms(&novel, &of_other, &cameras[1..], centre);

    // In the light of the world the pictures stand in for photographs.
    let common = [
        "relight",
        text(&run),
        "--names-from-cameras",
        "--size",
        "512x512",
    ];
    let world = ["--environment", text(&map), "--samples", "96"];
    for (file, out, scene) in [(&test, "photographs", &own), (&novel, "elsewhere", &other)] {
        let out = at(out);
        let of_file = ["--camera", text(file), "--out", text(&out), "--seed", "1"];
        done(&[&common[..], &world, &of_file].concat());
        let (folder, name) = match file == &test {
            true => ("test", "0001"),
            false => ("cup_scene002", "0003"),
        };
        for folder in ["test", "test_mask"] {
            fs::create_dir_all(scene.join(folder)).unwrap();
        }
        let picture = out.join(format!("{folder}/{name}.exr"));
        fs::copy(&picture, scene.join(format!("test/{name}.exr"))).unwrap();
        let picture = read_exr(&picture).unwrap();
        let mask = Image {
            channels: 1,
            data: picture.data.iter().skip(3).step_by(4).copied().collect(),
            ..picture
        };
        write_png8(&scene.join(format!("test_mask/{name}.png")), &mask).unwrap();
    }

    // New views in the same light.
    let views = at("views");
    let of_file = ["--camera", text(&test), "--out", text(&views)];
    done(&[&common[..], &world, &of_file].concat());
    let predicted = views.join("test");
    let orb = ["evaluate", text(&predicted), "--stanford-orb", text(&own)];
    assert!(stdout(&done(&orb)).contains("0001"));

    // Views elsewhere, each under its own map, where the benchmark keeps them.
    let truth = at("ground_truth");
    let maps = truth.join("cup_scene002/env_map");
    fs::create_dir_all(&maps).unwrap();
    let turned = in_camera_axes(&light, &cameras[1]);
    write_exr(&maps.join("0003.exr"), &turned, &["R", "G", "B"]).unwrap();
    let relit = |out: &Path, axes: &[&str]| {
        let of_each = ["--environments", text(&truth), "--samples", "96"];
        let of_file = ["--camera", text(&novel), "--out", text(out)];
        done(&[&common[..], &of_each, &of_file, axes].concat());
        apart(
            &other.join("test/0003.exr"),
            &out.join("cup_scene002/0003.exr"),
        )
    };
    let out = at("novel");
    let right = relit(&out, &["--axes", "camera"]);
    let wrong = relit(&at("wrong"), &["--convention", "skylibs"]);
    assert!(right < 0.05, "{right}");
    assert!(wrong > 3.0 * right, "{wrong} {right}");
    let orb = ["evaluate", text(&out), "--stanford-orb", text(&own)];
    let scored = done(&[&orb[..], &["--split", "novel", "--json"]].concat());
    let scored: Value = serde_json::from_slice(&scored.stdout).unwrap();
    assert_eq!(scored["views"][0][0], "cup_scene002/0003");
    let psnr = scored["mean"]["psnr_l"].as_f64().unwrap();
    assert!(psnr > 30.0, "{psnr}");

    // The record names what lies beside it.
    let record = fs::read_to_string(out.join("relight.json")).unwrap();
    let record: Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["pictures"], json!(["cup_scene002/0003"]));
    assert_eq!(record["axes"], "camera");
}

#[test]
fn names_and_maps_that_cannot_be_used_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (run, cameras, centre) = run_folder(folder.path());
    let at = |name: &str| folder.path().join(name);
    let map = at("light.exr");
    write_exr(&map, &Image::filled(8, 4, 3, 0.5), &["R", "G", "B"]).unwrap();
    let (file, out) = (at("cameras.json"), at("out"));
    let fails = |arguments: &[&str], code: i32, expected: &str| {
        let always = ["relight", text(&run), "--out", text(&out)];
        let output = eclipse(&[&always[..], arguments].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(!out.exists(), "{arguments:?}");
    };
    let light = ["--environment", text(&map)];
    let named = ["--camera", text(&file), "--names-from-cameras"];
    fails(
        &[&light[..], &["--names-from-cameras"]].concat(),
        2,
        "name it with --camera",
    );
    fails(
        &[&light[..], &["--environments", text(folder.path())]].concat(),
        2,
        "cannot be used with",
    );
    fails(
        &[&light[..], &["--axes", "earth"]].concat(),
        2,
        "use world or camera",
    );

    transforms(&file, &[("../../0001", None)], &cameras, centre);
    fails(
        &[&light[..], &named].concat(),
        3,
        "frame 0: `file_path` \"../../0001\"",
    );
    let twice = [("a/1.png", None), ("a/1.exr", None)];
    transforms(&file, &twice, &cameras, centre);
    fails(&[&light[..], &named].concat(), 3, "which frame 0 has");

    let two = [("a/1", None), ("a/2", None)];
    transforms(&file, &two, &cameras, centre);
    let maps = at("maps");
    fs::create_dir_all(maps.join("a")).unwrap();
    fs::copy(&map, maps.join("a/1.exr")).unwrap();
    let each = ["--environments", text(&maps)];
    fails(&[&each[..], &named].concat(), 3, "view \"a/2\" has no map");
    fs::write(maps.join("a/1.exr"), "no image").unwrap();
    fs::copy(&map, maps.join("a/2.exr")).unwrap();
    fails(&[&each[..], &named].concat(), 3, "1.exr");
}

#[test]
fn light_below_zero_and_without_end_is_clamped_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let (run, _, _) = run_folder(folder.path());
    let map = folder.path().join("sun.exr");
    let write = |negative: f32, sun: f32| {
        let mut light = Image::filled(16, 8, 3, 0.5);
        light.pixel_mut(3, 6).fill(negative);
        light.pixel_mut(4, 6)[1] = negative;
        light.pixel_mut(8, 1).fill(sun);
        write_exr(&map, &light, &["R", "G", "B"]).unwrap();
    };
    let relit = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let line = "--frames 1 --size 16x16 --samples 2 --progress none";
        let mut words = vec!["relight", text(&run), "--out", text(&out)];
        words.extend(["--environment", text(&map)]);
        words.extend(line.split_whitespace().chain(more.iter().copied()));
        let output = done(&words);
        (read_exr(&out.join("000.exr")).unwrap(), stderr(&output))
    };
    write(-0.01, f32::INFINITY);
    let (picture, said) = relit("raw", &[]);
    for part in [
        "note: ",
        "sun.exr has 2 texels with negative light, at lowest -0.01, taken as 0; 1 texel with infinite light, taken as 65504",
    ] {
        assert!(said.contains(part), "{said}");
    }
    // Once, also where each view reads its map.
    let (_, said) = relit("turned", &["--axes", "camera"]);
    assert_eq!(said.matches("note: ").count(), 1, "{said}");
    // The very light that was meant, of which there is nothing to say.
    write(0.0, 65504.0);
    let (meant, said) = relit("meant", &[]);
    assert_eq!(said, "");
    assert_eq!(picture, meant);
}
