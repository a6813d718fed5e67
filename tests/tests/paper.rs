//! The `paper` preset: its optimiser, that it learns, and that neither threads nor interruptions change a bit of it.

use std::{
    collections::BTreeMap,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

use eclipse::{
    capture::{Capture, Frame},
    checkpoint::{self, Checkpoint, decode, encode},
    control::{Control, Progress},
    reconstruct::{
        adam::Adam,
        paper::{PaperError, PaperSolution, plan::Plan, solve, solve_planned, start::Start},
    },
    reconstruction::Ended,
    report::ReportOptions,
    settings::{Preset, Settings},
};
use eclipse_tests::scenes;
use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    camera::Camera,
    image::Image,
    lat_long::LatLong,
    path::{PathBatch, PathScene, ShadingPoint},
    visibility::Visibility,
};

const GRID: LatLong = LatLong::new(8, 16);
const SIDE: usize = 20;

#[test]
fn adam_follows_a_hand_calculation() {
    let mut adam = Adam::new(2);
    let mut x = [1.0, 3.0];
    // The first step goes by the rate along the sign of the gradient; nothing moves what has none.
    adam.step(&mut x, &[0.5, 0.0], 0.1, 1);
    assert!((x[0] - 0.9).abs() < 1e-6);
    assert_eq!(x[1], 3.0);
    // m = 0.9·0.05 − 0.1 = −0.055, v = 0.999·0.00025 + 0.001 = 0.00124975; corrected by 0.19 and 0.001999.
    adam.step(&mut x, &[-1.0, 0.0], 0.1, 2);
    let expected = 0.9 + 0.1 * (0.055 / 0.19) / f64::sqrt(0.001_249_75 / 0.001_999);
    assert!((f64::from(x[0]) - expected).abs() < 1e-6, "{}", x[0]);
    assert_eq!(x[1], 3.0);
}

#[test]
fn the_loss_of_a_small_capture_falls() {
    let (capture, bvh) = capture();
    let solution = run(&capture, &bvh, &settings(60), &Control::detached()).unwrap();
    let (first, last) = (solution.curve[0], solution.curve[solution.curve.len() - 1]);
    assert_eq!((first.iteration, last.iteration), (1, 60));
    assert!(
        last.loss < 0.25 * first.loss,
        "{} after {}",
        last.loss,
        first.loss
    );
    assert_eq!(solution.ended, Ended::Iterations);
    assert_eq!(solution.masks.len(), capture.frames.len());
    let found = solution.materials(&[Vec3::X, Vec3::Y]).unwrap();
    let expected = solution.network.evaluate(Vec3::Y);
    assert!((found[1].albedo[2] - expected.albedo[2]).abs() < 1e-5);
    assert!((found[1].alpha - expected.alpha).abs() < 1e-5);
}

#[test]
fn threads_and_interruptions_do_not_change_a_bit() {
    let (capture, bvh) = capture();
    let settings = settings(7);
    let pool = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads can be started")
    };
    let whole = pool(1)
        .install(|| run(&capture, &bvh, &settings, &Control::detached()))
        .unwrap();

    let (stop, saved) = (AtomicBool::new(false), Mutex::new(Vec::new()));
    let stop_at_three = |progress: &Progress| {
        stop.fetch_or(progress.iteration == 3, Ordering::Relaxed);
    };
    let save = |checkpoint: &Checkpoint| {
        *saved.lock().unwrap() = encode(checkpoint);
        Ok(())
    };
    let interrupted = Control {
        stop: &stop,
        progress: &stop_at_three,
        checkpoint: &save,
        ..Control::detached()
    };
    let part = pool(2)
        .install(|| run(&capture, &bvh, &settings, &interrupted))
        .unwrap();
    assert_eq!((part.ended, part.iterations), (Ended::Interrupted, 3));
    let checkpoint = decode(&saved.lock().unwrap()).unwrap();
    assert_eq!(checkpoint.iteration, 3);
    let resumed = Control {
        resume: Some(&checkpoint),
        ..Control::detached()
    };
    let rest = pool(2)
        .install(|| run(&capture, &bvh, &settings, &resumed))
        .unwrap();

    assert_ne!(part.network, whole.network);
    assert_eq!(rest.iterations, 7);
    assert_eq!(rest.environment, whole.environment);
    assert_eq!(rest.masks, whole.masks);
    assert_eq!(rest.network, whole.network);
    assert!(
        rest.masks[0]
            .data
            .iter()
            .any(|&m| m != rest.masks[0].data[0])
    );
}

#[test]
fn a_run_leaves_everything_that_is_written() {
    let (capture, _) = capture();
    let settings = Settings {
        hold_out: Some(3),
        lambertian: true,
        ..settings(2)
    };
    let found = eclipse::reconstruct::run(&capture, &settings, &Control::detached()).unwrap();
    let frame = &capture.frames[1];
    let (materials, render) = (&found.materials[1], &found.renders[1]);
    for y in 0..SIDE {
        for x in 0..SIDE {
            if frame.mask.pixel(x, y)[0] > 0.999 {
                let m = materials.pixel(x, y);
                assert!(m[..3].iter().all(|v| (0.3..0.7).contains(v)), "{m:?}");
                assert_eq!(m[3..], [1.0, 0.0]);
                assert!(render.pixel(x, y).iter().all(|v| v.is_finite() && *v > 0.0));
            }
        }
    }
    assert_eq!(found.vertex_materials.len(), capture.mesh.positions.len());
    // The last of three frames is held out, but for its occluder, which half of its pixels teach.
    let range = |t: usize| {
        let data = &found.occluders[t].data;
        data.iter()
            .fold(0.0, |most: f32, m| most.max((m - data[0]).abs()))
    };
    assert!(
        range(2) > 1e-4 && range(0) > 1e-4,
        "{} {}",
        range(2),
        range(0)
    );
    let photometric = found.metrics.photometric;
    assert!(photometric.psnr.unwrap().is_finite() && photometric.psnr_held_out.is_some());
    assert_eq!(found.metrics.extra["iterations"], 2);
    assert_eq!(found.network.unwrap().extension, "safetensors");
}

#[test]
fn held_out_frames_teach_their_own_occluder_alone() {
    let (capture, bvh) = capture();
    let with = Settings {
        hold_out: Some(3),
        ..settings(1)
    };
    let fitted = |t: usize, _: u32| t != 2;
    let solved = |capture: &Capture| {
        solve(capture, &bvh, &with, &fitted, None, &Control::detached()).unwrap()
    };
    let mut darker = capture.clone();
    darker.frames[2]
        .image
        .data
        .iter_mut()
        .for_each(|v| *v *= 0.3);
    let (one, other) = (solved(&capture), solved(&darker));
    assert_eq!(one.environment, other.environment);
    assert_eq!(one.network, other.network);
    assert_eq!(one.masks[..2], other.masks[..2]);
    assert_ne!(one.masks[2], other.masks[2]);
}

#[test]
fn cached_visibility_continues_bit_for_bit_and_is_close_to_rays() {
    let (capture, bvh) = capture();
    let planned = |side, control: &Control<'_>| {
        let plan = Plan {
            pixels: 512,
            rays: 32,
            cells: 4000,
            side,
        };
        let all = |_: usize, _: u32| true;
        solve_planned(&capture, &bvh, &settings(4), plan, &all, None, control).unwrap()
    };
    let saved = Mutex::new(Vec::new());
    let save = |checkpoint: &Checkpoint| {
        saved.lock().unwrap().push(encode(checkpoint));
        Ok(())
    };
    let whole = planned(
        1,
        &Control {
            checkpoint: &save,
            ..Control::detached()
        },
    );
    // The first is saved after one iteration.
    let checkpoint = decode(&saved.lock().unwrap()[0]).unwrap();
    assert_eq!(checkpoint.iteration, 1);
    let rest = planned(
        1,
        &Control {
            resume: Some(&checkpoint),
            ..Control::detached()
        },
    );
    assert_eq!(rest.environment, whole.environment);
    assert_eq!(rest.network, whole.network);
    assert_eq!(rest.masks, whole.masks);

    // Before anything was learnt the losses differ by their shadows alone.
    let cast = planned(0, &Control::detached());
    let (cached, cast) = (whole.curve[0].loss, cast.curve[0].loss);
    assert!((cached / cast - 1.0).abs() < 0.03, "{cached} {cast}");
}

#[test]
fn a_run_from_a_result_begins_where_that_ended() {
    let (mut capture, bvh) = capture();
    let folder = tempfile::tempdir().unwrap();
    let first = eclipse::reconstruct::run(&capture, &settings(40), &Control::detached()).unwrap();
    capture.path = folder.path().to_owned();
    let report = ReportOptions::new("none".to_owned());
    eclipse::output::prepare(folder.path()).unwrap();
    eclipse::output::write(folder.path(), &capture, &first, &report).unwrap();

    let start = Start::read(folder.path(), &capture, &bvh).unwrap();
    let settings = Settings {
        from: Some(folder.path().to_owned()),
        ..settings(1)
    };
    let all = |_: usize, _: u32| true;
    let control = Control::detached();
    let solution = solve(&capture, &bvh, &settings, &all, Some(&start), &control).unwrap();
    // The rates begin at zero: the first iteration leaves things as they were read.
    let pairs = first
        .environment
        .data
        .iter()
        .zip(&solution.environment.data);
    for (a, b) in pairs {
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
    let found = solution.materials(&capture.mesh.positions[..40]).unwrap();
    for (a, b) in first.vertex_materials.iter().zip(&found) {
        assert!((a.albedo[0] - b.albedo[0]).abs() < 0.06, "{a:?} {b:?}");
    }

    // A result that explained the photographs better is not written over in silence.
    let again = || eclipse::reconstruct::run(&capture, &settings, &control).unwrap();
    let mut metrics = first.metrics.clone();
    let behind = |notes: &[String]| notes.iter().any(|note| note.contains("explained worse"));
    for (better, told) in [(-9.0, false), (9.0, true)] {
        metrics.photometric.psnr = first.metrics.photometric.psnr.map(|psnr| psnr + better);
        let text = serde_json::to_vec(&metrics).unwrap();
        std::fs::write(folder.path().join("metrics.json"), text).unwrap();
        let notes = again().notes;
        assert_eq!(behind(&notes), told, "{notes:?}");
    }

    let mut fewer = capture.clone();
    fewer.frames.pop();
    let error = Start::read(folder.path(), &fewer, &bvh).unwrap_err();
    assert!(error.to_string().contains("2 photographs"), "{error}");

    // What it was found from is known by the checkpoint that a run leaves.
    let mut left = Checkpoint {
        settings,
        capture: checkpoint::fingerprint(&capture),
        iteration: 1,
        seconds: 1.0,
        arrays: BTreeMap::new(),
    };
    checkpoint::save(folder.path(), &left).unwrap();
    Start::read(folder.path(), &capture, &bvh).unwrap();
    left.capture += 1;
    checkpoint::save(folder.path(), &left).unwrap();
    let error = Start::read(folder.path(), &capture, &bvh).unwrap_err();
    assert!(error.to_string().contains("another capture"), "{error}");
}

#[test]
fn a_capture_without_a_pixel_to_fit_is_refused() {
    let (capture, bvh) = capture();
    let nothing = |_: usize, _: u32| false;
    let solved = solve(
        &capture,
        &bvh,
        &settings(1),
        &nothing,
        None,
        &Control::detached(),
    );
    assert!(matches!(solved.err(), Some(PaperError::NoPixels)));
}

fn run(
    capture: &Capture,
    bvh: &Bvh,
    settings: &Settings,
    control: &Control<'_>,
) -> Result<PaperSolution, PaperError> {
    solve(capture, bvh, settings, &|_, _| true, None, control)
}

fn settings(iterations: u64) -> Settings {
    Settings {
        preset: Preset::Paper,
        time_limit: None,
        iterations: Some(iterations),
        grid_rows: GRID.rows,
        harmonic_degree: 3,
        // About as small a batch as there is: less memory is refused.
        memory: 19 << 20,
        ..Settings::default()
    }
}

/// Three photographs of two spheres in a room, without occluders.
fn capture() -> (Capture, Bvh) {
    let bvh = scenes::pair();
    let environment = scenes::interior(GRID);
    let material = Material {
        albedo: [0.7, 0.4, 0.2],
        alpha: 0.4,
        kappa: 0.05,
    };
    let open = vec![1.0; GRID.len()];
    let frames = (0..3).map(|t| {
        let azimuth = 2.1 * t as f32;
        let eye = 3.0 * Vec3::new(azimuth.cos(), azimuth.sin(), 0.5);
        let camera = Camera::look_at(SIDE, SIDE, 0.6, eye, Vec3::ZERO);
        let mask = Image {
            width: SIDE,
            height: SIDE,
            channels: 1,
            data: bvh.coverage(&camera, 3),
        };
        let mut image = Image::filled(SIDE, SIDE, 3, 0.0);
        let radii = [camera.distance()];
        let scene = PathScene {
            bvh: &bvh,
            visibility: Visibility::Rays,
            model: Model::Microfacet,
            lights: environment.distribution(),
            environment_grid: GRID,
            mask_grid: GRID,
            radii: &radii,
        };
        for p in 0..SIDE * SIDE {
            let (x, y) = ((p % SIDE) as f32 + 0.5, (p / SIDE) as f32 + 0.5);
            if let Some((surface, outgoing)) = bvh.seen(&camera, x, y) {
                let point = ShadingPoint {
                    surface,
                    outgoing,
                    frame: 0,
                    pixel: p as u32,
                    cached: 0,
                    alpha: material.alpha,
                };
                let batch = PathBatch::quadrature(&scene, &[point], 2);
                let data = &environment.image().data;
                let value = batch.radiance(0, Model::Microfacet, &material, data, &open);
                let value = value.map(|v| v as f32);
                image.pixel_mut(p % SIDE, p / SIDE).copy_from_slice(&value);
            }
        }
        Frame {
            name: format!("{t:03}"),
            camera,
            image,
            mask,
        }
    });
    let capture = Capture {
        lamps: None,
        path: "pair".into(),
        frames: frames.collect(),
        mesh: bvh.mesh().clone(),
        centre: Vec3::ZERO,
    };
    (capture, bvh)
}
