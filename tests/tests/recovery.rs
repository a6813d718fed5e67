//! A capture made by `synthesize` is taken apart again: light comes out close to what it was made with.

use eclipse::{
    control::Control,
    evaluate::environment,
    reconstruct,
    settings::Settings,
    synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
};
use eclipse_tests::scenes;
use render::{bsdf::Model, image::Image, lat_long::LatLong};

/// Relative error of a map after the best scale per channel.
fn error(map: &Image, truth: &Image) -> f64 {
    let score = environment::compare(map, truth).score;
    score
        .texels
        .relative_rmse_aligned
        .expect("the truth is not black")
}

#[test]
fn the_light_of_a_small_synthetic_capture_is_recovered() {
    let truth = scenes::interior(LatLong::new(50, 100)).image().clone();
    let scene = Scene {
        mesh: scenes::pair().mesh().clone(),
        environment: truth.clone(),
        model: Model::Lambertian,
        albedo: Pattern {
            mean: [0.6, 0.5, 0.4],
            variation: 0.2,
        },
        alpha: 0.5,
        kappa: 0.04,
        occluders: Occluders::Operator,
    };
    let shooting = Shooting {
        frames: 16,
        resolution: 40,
        distance: 4.0,
        noise: 0.002,
        seed: 5,
    };
    let made = synthesize(&scene, &shooting, |_| true).unwrap();
    let settings = Settings {
        lambertian: true,
        time_limit: None,
        iterations: Some(8),
        ..Settings::default()
    };
    let found = reconstruct::run(&made.capture, &settings, &Control::detached()).unwrap();

    // A constant map is what knows nothing; half of its error is far beyond chance.
    let constant = error(&Image::filled(100, 50, 3, 1.0), &truth);
    let recovered = error(&found.environment, &truth);
    assert!(constant > 0.8, "{constant}");
    assert!(
        recovered < 0.75 * constant,
        "{recovered}, where a constant map scores {constant}"
    );
}
