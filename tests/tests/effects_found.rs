//! Each effect, planted in the model's own images, leads the first screening.

use eclipse::criticism::{
    diagnose::screen_at,
    effects::{self, Term},
    fit::Fit,
    transport::Lobe,
};
use eclipse_tests::planted::{
    LARGE, LOBE, capture, leads, pattern, plant, plant_on, screened, study, terms, truth,
};

/// Plants an effect and asserts that it leads the physics of the first screening, among the first `among`.
fn finds(id: &str, ceiling: f32, among: usize, beta: &dyn Fn(usize, &Term) -> f64) {
    finds_with(LOBE, id, ceiling, among, beta);
}

/// The same for a baseline with this lobe.
fn finds_with(
    lobe: Option<Lobe>,
    id: &str,
    ceiling: f32,
    among: usize,
    beta: &dyn Fn(usize, &Term) -> f64,
) {
    let capture = capture(ceiling, &LARGE);
    let mut study = study(&capture, lobe, &LARGE);
    let effect = effects::by_id(id).unwrap();
    plant(&mut study, Some((effect, beta)));
    leads(&screened(&study), id, among);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_moving_occluder_is_found() {
    finds("moving_occluder", 1.0, 1, &|_, t| {
        let behind = t.name.contains("-8° to 8° from") && t.name.contains("6° to 24°");
        if behind { 0.9 } else { 0.0 }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn exposure_drift_is_found() {
    finds("exposure_drift", 1.0, 1, &|k, _| {
        if k % 3 == 0 { 0.05 * pattern(k) } else { 0.0 }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_response_curve_is_found_where_somebody_walks_past_the_lamp() {
    // In one light that stands still every place shows one level only, and a curve is another albedo. Somebody in the light,
    // whom the model has, shows places at several.
    finds_beside_an_occluder("response_curve", &|k, _| [-0.2, 0.0, 0.0][k]);
}

/// The same as [`finds`] where a wide occluder is in the model: it has to come first.
fn finds_beside_an_occluder(id: &str, beta: &dyn Fn(usize, &Term) -> f64) {
    let capture = capture(1.0, &LARGE);
    let mut study = study(&capture, LOBE, &LARGE);
    let mut fit = truth(&study);
    let occluder = effects::by_id("moving_occluder").unwrap();
    let opacity: Vec<f64> = terms(&study, &fit, occluder)
        .iter()
        .map(|t| {
            let any = |parts: &[&str]| parts.iter().any(|part| t.name.contains(part));
            let beside = any(&["-24° to -8° from", "-8° to 8° from", " 8° to 24° from"]);
            let there = t.frame.is_none() && beside && any(&["6° to 24°", "24° to 49°"]);
            if there { 0.9 } else { 0.0 }
        })
        .collect();
    assert_eq!(opacity.iter().filter(|o| **o > 0.0).count(), 6);
    fit.add(occluder, opacity.clone());
    fit.relink(&study).unwrap();
    let effect = effects::by_id(id).unwrap();
    plant_on(&mut study, &fit, Some((effect, beta)));
    let mut fit = Fit::start(&study).unwrap();
    fit.add(occluder, opacity);
    fit.refine(&study, 6).unwrap();
    let others = effects::all()
        .into_iter()
        .filter(|e| e.id() != occluder.id());
    leads(&screen_at(&study, &fit, others).unwrap(), id, 1);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn vignetting_is_found() {
    finds("vignetting", 1.0, 1, &|k, _| [-0.3, -0.1][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_black_level_is_found() {
    finds("black_level", 1.0, 1, &|_, _| 0.012);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn veiling_glare_is_found() {
    finds("veiling_glare", 1.0, 1, &|k, _| [0.0, 0.03, 0.04][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn clipping_is_found() {
    finds("clipping", 0.24, 1, &|k, _| [0.0, 0.9][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_moving_light_is_found() {
    finds("moving_light", 1.0, 1, &|_, t| {
        if t.name == "turn about z with time (radian)" {
            0.25
        } else {
            0.0
        }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn defocus_is_found() {
    finds("defocus", 1.0, 1, &|k, _| [0.0, 0.8][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn wrong_poses_are_found() {
    finds("pose_error", 1.0, 1, &|k, _| 0.7 * pattern(k));
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn haze_is_found() {
    finds("medium", 1.0, 1, &|k, _| [0.12, 0.0, 0.0, 0.0][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn interreflection_is_found() {
    finds("interreflection", 1.0, 3, &|_, _| 1.0);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn emission_is_found() {
    finds("emission", 1.0, 3, &|k, _| {
        [0.1, 0.05, 0.02].get(k).copied().unwrap_or(0.0)
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_near_light_is_found() {
    finds("near_field_light", 1.0, 3, &|k, _| {
        if k == 20 { 1.2 } else { 0.0 }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_bright_ground_is_found() {
    finds("ground_bounce", 1.0, 3, &|k, _| {
        if k < 3 { 0.8 } else { 0.0 }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_gloss_is_found() {
    finds_with(None, "specular_lobe", 1.0, 3, &|k, _| {
        if k == 0 { 0.08 } else { 0.0 }
    });
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn translucency_is_found() {
    finds("translucency", 1.0, 3, &|k, _| [0.0, 0.6][k]);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn tilted_normals_are_found() {
    finds("normal_error", 1.0, 3, &|k, _| 0.15 * pattern(k));
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_pale_occluder_is_found() {
    finds_beside_an_occluder("occluder_bounce", &|_, t| {
        if t.name == "radiance (of the mean) of the occluder" {
            1.2
        } else {
            0.0
        }
    });
}
