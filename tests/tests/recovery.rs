//! Captures are taken apart: what moving shadows tell is found, and nothing where there are none.

use std::sync::OnceLock;

use eclipse::{
    capture::{Capture, LoadOptions},
    control::Control,
    evaluate::environment,
    image_io::read_exr,
    reconstruct,
    reconstruction::Reconstruction,
    settings::{OccluderPrior, Settings},
    synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
};
use eclipse_tests::{coarse, perfect::bundled, scenes};
use render::{bsdf::Model, lat_long::LatLong};

/// What a few steps recover of a matte object, occluders modelled or not.
fn recovered(capture: &Capture, occluders: bool, iterations: u64) -> Reconstruction {
    let settings = Settings {
        lambertian: true,
        occluders,
        iterations: Some(iterations),
        ..coarse()
    };
    reconstruct::run(capture, &settings, &Control::detached()).unwrap()
}

#[test]
fn moving_shadows_tell_more_of_the_light_than_shading() {
    // Of photographs with fewer pixels, where visibility takes less time; shadows are seen by twenty-four of them all the same.
    let options = LoadOptions {
        max_size: Some(36),
        ..LoadOptions::default()
    };
    let capture = Capture::load(&bundled(), &options).unwrap();
    let truth = read_exr(&bundled().join("truth/environment.exr")).unwrap();
    let error = |occluders: bool| {
        let found = recovered(&capture, occluders, 7).environment;
        let score = environment::compare(&found, &truth).score;
        score
            .texels
            .relative_rmse_aligned
            .expect("the truth is not black")
    };
    let [with, without] = [error(true), error(false)];
    assert!(
        with < 0.85 * without,
        "{with} with shadows modelled, {without} without"
    );
}

/// What two rounds recover of the pair with an operator, every fourth frame held out.
fn of_held_out(occluders: bool, occluder_prior: OccluderPrior) -> Reconstruction {
    let settings = Settings {
        lambertian: true,
        occluders,
        occluder_prior,
        hold_out: Some(4),
        iterations: Some(12),
        ..coarse()
    };
    let capture = pair(Occluders::Operator);
    reconstruct::run(&capture, &settings, &Control::detached()).unwrap()
}

/// The same with the operator modelled, made once.
fn held_out() -> &'static Reconstruction {
    static FOUND: OnceLock<Reconstruction> = OnceLock::new();
    FOUND.get_or_init(|| of_held_out(true, OccluderPrior::Operator))
}

/// Frames of a pair of balls in a room, with an operator or without.
fn pair(occluders: Occluders) -> Capture {
    let scene = Scene {
        mesh: scenes::pair().mesh().clone(),
        environment: scenes::interior(LatLong::new(50, 100)).image().clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.6, 0.5, 0.4],
            variation: 0.2,
        },
        alpha: 0.5,
        kappa: 0.04,
        occluders,
    };
    let shooting = Shooting {
        frames: 16,
        resolution: 40,
        distance: 4.0,
        noise: 0.002,
        seed: 5,
    };
    synthesize(&scene, &shooting, |_| true).unwrap().capture
}

#[test]
fn nobody_is_found_where_nobody_stood() {
    let found = recovered(&pair(Occluders::None), true, 8);
    assert!(found.occluders.is_empty());
    let says = |note: &String| note.contains("no sign of an occluder");
    assert!(found.notes.iter().any(says), "{:?}", found.notes);

    let found = held_out();
    assert_eq!(found.occluders.len(), 16);
    assert!(!found.notes.iter().any(says), "{:?}", found.notes);
}

#[test]
fn frames_that_are_held_out_find_their_own_occluders() {
    let psnr = |found: &Reconstruction| found.metrics.photometric.psnr_held_out.unwrap();
    let without = psnr(&of_held_out(false, OccluderPrior::Operator));
    for prior in [OccluderPrior::Operator, OccluderPrior::None] {
        let found = match prior {
            OccluderPrior::Operator => held_out(),
            OccluderPrior::None => &of_held_out(true, prior),
        };
        assert!(
            psnr(found) > without + 1.0,
            "{prior:?}: {} dB, {without} dB without occluders",
            psnr(found)
        );
        // The last of four is held out: its mask begins at 0.993, and nothing but the fit to its own half moves it.
        for frame in [3, 7, 11, 15] {
            let darkest = found.occluders[frame]
                .data
                .iter()
                .copied()
                .fold(1.0f32, f32::min);
            assert!(darkest < 0.9, "{prior:?}, frame {frame}: {darkest}");
        }
    }
}
