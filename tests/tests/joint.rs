//! A reconstruction with effects of the camera finds them, and the light behind them.

use std::sync::{
    Mutex,
    atomic::{AtomicBool, Ordering},
};

use eclipse::{
    capture::Capture,
    checkpoint::{self, Checkpoint},
    control::Control,
    criticism::effects,
    evaluate::environment,
    joint::{self, JointError},
    reconstruction::{Ended, Reconstruction},
    settings::Settings,
    synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
};
use eclipse_tests::{
    coarse,
    scenes::{add_sphere, interior},
};
use glam::Vec3;
use render::{bsdf::Model, image::Image, lat_long::LatLong, mesh::Mesh};

/// Light lost per squared radius.
const VIGNETTE: f64 = -0.4;

/// A capture of two balls of `resolution` pixels a side without an operator, and its light.
fn made(resolution: usize) -> (Capture, Image) {
    let mut mesh = Mesh::default();
    add_sphere(&mut mesh, Vec3::new(-0.35, 0.0, -0.1), 0.5, 24);
    add_sphere(&mut mesh, Vec3::new(0.4, 0.1, 0.1), 0.4, 24);
    let light = interior(LatLong::new(50, 100)).image().clone();
    let scene = Scene {
        mesh,
        environment: light.clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.6, 0.5, 0.4],
            variation: 0.1,
        },
        alpha: 0.5,
        kappa: 0.0,
        occluders: Occluders::None,
    };
    let shooting = Shooting {
        frames: 12,
        resolution,
        distance: 4.0,
        noise: 0.003,
        seed: 4,
    };
    let made = synthesize(&scene, &shooting, |_| true).unwrap();
    (made.capture, light)
}

fn vignetted(capture: &Capture) -> Capture {
    let effect = effects::by_id("vignetting").unwrap();
    let map = effect.camera_map(capture, &[VIGNETTE, 0.0]).unwrap();
    let mut taken = capture.clone();
    for (t, frame) in taken.frames.iter_mut().enumerate() {
        (map.apply)(t, &mut frame.image);
    }
    taken
}

fn settings(with: &[&str]) -> Settings {
    Settings {
        lambertian: true,
        occluders: false,
        iterations: Some(8),
        with: with.iter().map(|name| (*name).to_owned()).collect(),
        ..coarse()
    }
}

fn error(found: &Reconstruction, light: &Image) -> f64 {
    let score = environment::compare(&found.environment, light).score;
    score.texels.relative_rmse_aligned.unwrap()
}

#[test]
fn a_vignette_is_fitted_and_taken_out() {
    let (capture, light) = made(40);
    let taken = vignetted(&capture);
    let detached = Control::detached();
    let plain = joint::run(&taken, &settings(&[]), &detached).unwrap();
    let with = settings(&["vignetting"]);
    let found = joint::run(&taken, &with, &detached).unwrap();
    let camera = &found.metrics.extra["camera"]["vignetting"];
    let gain: f64 = camera
        .as_object()
        .unwrap()
        .values()
        .map(|v| v.as_f64().unwrap())
        .sum();
    // In the corners, where nothing of the object is seen, a and b count alike.
    assert!((gain - VIGNETTE).abs() < 0.15, "{camera}");
    let psnr = |found: &Reconstruction| found.metrics.photometric.psnr.unwrap();
    assert!(
        psnr(&found) > psnr(&plain) + 1.0,
        "{} {}",
        psnr(&found),
        psnr(&plain)
    );
    assert!(error(&found, &light) < error(&plain, &light));
    assert!(found.notes.iter().any(|note| note.contains("vignetting")));
    assert_eq!(found.settings, with);
}

#[test]
fn an_interrupted_run_goes_on_bit_for_bit() {
    // That both ends are the same takes no fine photographs.
    let (capture, _) = made(28);
    let taken = vignetted(&capture);
    let with = Settings {
        iterations: Some(3),
        ..settings(&["vignetting", "black_level"])
    };
    let whole = joint::run(&taken, &with, &Control::detached()).unwrap();
    let saved: Mutex<Option<Checkpoint>> = Mutex::new(None);
    let stop = AtomicBool::new(false);
    let interrupted = Control {
        stop: &stop,
        checkpoint: &|checkpoint| {
            if checkpoint.iteration == 1 {
                stop.store(true, Ordering::Relaxed);
            }
            *saved.lock().unwrap() = Some(checkpoint.clone());
            Ok(())
        },
        ..Control::detached()
    };
    joint::run(&taken, &with, &interrupted).unwrap();
    let saved = saved.into_inner().unwrap().unwrap();
    saved.check(&with, checkpoint::fingerprint(&taken)).unwrap();
    let resumed = Control {
        resume: Some(&saved),
        ..Control::detached()
    };
    let found = joint::run(&taken, &with, &resumed).unwrap();
    assert_eq!(found.environment, whole.environment);
    assert_eq!(found.renders, whole.renders);
    let camera = |of: &Reconstruction| of.metrics.extra["camera"].clone();
    assert!(camera(&found)["vignetting"].is_object());
    assert_eq!(camera(&found), camera(&whole));
}

#[test]
fn an_interrupt_ends_the_fit_of_the_camera() {
    let (capture, _) = made(28);
    let with = Settings {
        iterations: Some(1),
        ..settings(&["vignetting"])
    };
    let stop = AtomicBool::new(false);
    let interrupted = Control {
        stop: &stop,
        progress: &|progress| {
            if progress.stage == "camera" {
                stop.store(true, Ordering::Relaxed);
            }
        },
        ..Control::detached()
    };
    let found = joint::run(&capture, &with, &interrupted).unwrap();
    assert_eq!((found.ended, &found.settings), (Ended::Interrupted, &with));
    assert!(!found.metrics.extra.contains_key("camera"));
    let says = |note: &String| note.contains("before the camera was fitted");
    assert!(found.notes.iter().any(says), "{:?}", found.notes);
}

#[test]
fn only_effects_of_the_camera_are_accepted() {
    for name in ["nonsense", "moving_light"] {
        let error = joint::of_the_camera(&[name.to_owned()]).err();
        assert!(matches!(error, Some(JointError::Unknown { .. })), "{name}");
    }
    let names = ["response_curve", "vignetting", "vignetting"].map(str::to_owned);
    let found = joint::of_the_camera(&names).unwrap();
    let ids: Vec<&str> = found.iter().map(|effect| effect.id()).collect();
    assert_eq!(ids, ["vignetting", "response_curve"]);
}
