//! Effects planted in the model's own images are found, and at their null they change no bit.

use std::{
    path::Path,
    sync::{Arc, LazyLock},
};

use eclipse::{
    capture::Capture,
    criticism::{
        Simulation, Verdict,
        certainty::standard_errors,
        chain::{Chain, Link},
        compete, confirm,
        diagnose::screen_at,
        diagnosis::Refitted,
        effects::{self, Effect, Term},
        fit::Fit,
        locate::Structured,
        refit,
        score::Screen,
        study::Study,
        told,
        transport::Lobe,
        verdict::{self, Grounds},
    },
};
use eclipse_tests::{
    painted,
    scenes::{add_sphere, interior},
};
use glam::Vec3;
use render::{camera::Camera, lat_long::LatLong, mesh::Mesh, sampler::SampleKey};

/// How large a capture is, and how much of it is looked at.
struct Scale {
    size: usize,
    frames: usize,
    sites: usize,
}

const SMALL: Scale = Scale {
    size: 48,
    frames: 14,
    sites: 700,
};
/// Enough for effects that light and albedo imitate nearly: fewer places leave their gains within three standard errors.
const LARGE: Scale = Scale {
    size: 72,
    frames: 24,
    sites: 2000,
};
const NOISE: f32 = 0.01;

/// Three balls in a heap: concavities, cast shadows and normals of all directions.
fn heap() -> Mesh {
    let mut mesh = Mesh::default();
    for (centre, radius) in [
        (Vec3::new(-0.45, -0.1, -0.2), 0.5),
        (Vec3::new(0.45, 0.05, -0.25), 0.45),
        (Vec3::new(0.0, 0.1, 0.4), 0.38),
    ] {
        add_sphere(&mut mesh, centre, radius, 24);
    }
    mesh
}

/// A capture whose photographs the tests replace by the model's own values.
fn capture(ceiling: f32, scale: &Scale) -> Capture {
    let Scale { size, frames, .. } = *scale;
    let cameras = (0..frames).map(move |t| {
        let azimuth = t as f32 / frames as f32 * std::f32::consts::TAU;
        let height = 0.25 + 0.5 * ((t * 5) % frames) as f32 / frames as f32;
        let eye = 5.0 * Vec3::new(azimuth.cos(), azimuth.sin(), height).normalize();
        Camera::look_at(size, size, 0.5, eye, Vec3::ZERO)
    });
    painted::capture(heap(), Path::new("heap"), cameras, |point| {
        let light = 0.35 + 0.25 * point.normal.dot(Vec3::new(0.3, -0.8, 0.5));
        [0, 1, 2].map(|c| {
            let wave = (4.0 * point.position[c] + c as f32).sin();
            (light * (0.5 + 0.25 * wave)).min(ceiling)
        })
    })
}

const LOBE: Option<Lobe> = Some(Lobe {
    alpha: 0.4,
    kappa: 0.05,
});

fn study<'a>(capture: &'a Capture, lobe: Option<Lobe>, scale: &Scale) -> Study<'a> {
    let simulation = Simulation {
        environment: interior(LatLong::new(20, 40)).image().clone(),
        lobe,
        renders: capture.frames.iter().map(|f| f.image.clone()).collect(),
        occluders: Vec::new(),
    };
    Study::new(capture, &simulation, scale.sites, 20, 3).unwrap()
}

/// The true model: the simulation's light on a smooth texture.
fn truth(study: &Study<'_>) -> Fit {
    let mut fit = Fit::start(study).unwrap();
    let mut stream = SampleKey {
        seed: 5,
        ..SampleKey::default()
    }
    .stream();
    for w in &mut fit.parameters.texture {
        *w = 0.8 * (stream.uniform() - 0.5);
    }
    fit.evaluate(study).unwrap();
    fit
}

fn terms(study: &Study<'_>, fit: &Fit, effect: &'static dyn Effect) -> Arc<Vec<Term>> {
    Arc::new(effect.terms(&fit.scene(study)))
}

/// A study and its true model, made once for all tests that plant nothing.
fn true_model() -> &'static (Study<'static>, Fit) {
    static CAPTURE: LazyLock<Capture> = LazyLock::new(|| capture(1.0, &SMALL));
    static MODEL: LazyLock<(Study<'static>, Fit)> = LazyLock::new(|| {
        let study = study(&CAPTURE, LOBE, &SMALL);
        let fit = truth(&study);
        (study, fit)
    });
    &MODEL
}

/// An effect and how much of each of its columns a term has.
type Planted<'a> = (&'static dyn Effect, &'a dyn Fn(usize, &Term) -> f64);

/// Puts the true model's values with `beta` of an effect and noise into the study.
fn plant(study: &mut Study<'_>, effect: Option<Planted<'_>>) {
    let fit = truth(study);
    plant_on(study, &fit, effect);
}

/// The same for the values of `fit`.
fn plant_on(study: &mut Study<'_>, fit: &Fit, effect: Option<Planted<'_>>) {
    let mut values = fit.ideal.clone();
    if let Some((effect, beta)) = effect {
        let terms = terms(study, fit, effect);
        let betas: Vec<f64> = terms.iter().enumerate().map(|(k, t)| beta(k, t)).collect();
        let link = Link { effect, terms };
        let mut chain = Chain::new(&[link], study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &[betas]).unwrap();
        values = chain.values().unwrap();
    }
    let mut stream = SampleKey {
        seed: 9,
        ..SampleKey::default()
    }
    .stream();
    let mut normal = || (0..12).map(|_| stream.uniform()).sum::<f32>() - 6.0;
    let variance: Vec<f32> = values
        .iter()
        .map(|v| (NOISE * v).powi(2) + 0.002f32.powi(2))
        .collect();
    for (value, variance) in values.iter_mut().zip(&variance) {
        *value += variance.sqrt() * normal();
    }
    study.replace(values, variance);
}

fn screened(study: &Study<'_>) -> Screen {
    let mut fit = Fit::start(study).unwrap();
    fit.refine(study, 6).unwrap();
    screen_at(study, &fit, effects::all().into_iter()).unwrap()
}

#[test]
fn nulls_change_no_bit() {
    let (study, fit) = true_model();
    let plain = Chain::new(&[], study.seen.len()).and_then(|mut chain| {
        chain.bind(&fit.ideal, &[])?;
        chain.values()
    });
    let plain = plain.unwrap();
    for effect in effects::all() {
        let terms = terms(study, fit, effect);
        let betas = vec![0.0; terms.len()];
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &[betas]).unwrap();
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(
            bits(&chain.values().unwrap()),
            bits(&plain),
            "{}",
            effect.id()
        );
    }
}

/// The derivative by one sum for all numbers of an effect is that by each of them.
#[test]
fn columns_are_slopes() {
    let (study, fit) = true_model();
    for effect in effects::all() {
        let terms = terms(study, fit, effect);
        let some: Vec<usize> = [0, 1, terms.len() / 2]
            .into_iter()
            .filter(|k| *k < terms.len())
            .collect();
        let beta = |k: usize| 0.1 * terms[k].scale * pattern(k).abs();
        let base: Vec<f64> = (0..terms.len()).map(beta).collect();
        let scales: Vec<f64> = terms.iter().map(|t| t.scale).collect();
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        for k in some {
            let mut at = |step: f64| {
                let mut betas = base.clone();
                betas[k] += step * scales[k];
                chain.bind(&fit.ideal, &[betas]).unwrap();
                chain.values().unwrap()
            };
            let (more, less) = (at(0.02), at(-0.02));
            let mut at_base = || {
                chain.bind(&fit.ideal, std::slice::from_ref(&base)).unwrap();
                chain.column(0, k).unwrap()
            };
            let column = at_base();
            let (mut wrong, mut size) = (0.0f64, 0.0f64);
            for ((m, l), c) in more.iter().zip(&less).zip(&column) {
                let slope = f64::from(m - l) / (0.04 * scales[k]);
                wrong += (slope - f64::from(*c)).powi(2);
                size += slope.powi(2);
            }
            assert!(
                wrong.sqrt() <= 0.02 * size.sqrt() + 1e-6,
                "{} {k}: {wrong} of {size}",
                effect.id()
            );
        }
    }
}

/// What an effect of the camera does to whole photographs is what it does on the tape, and can be taken back.
#[test]
fn the_camera_is_undone_as_it_is_recorded() {
    let (study, fit) = true_model();
    let mut checked = 0;
    for effect in effects::all().into_iter().filter(|e| e.is_of_the_camera()) {
        let terms = terms(study, fit, effect);
        let beta = |(k, term): (usize, &Term)| {
            let part = term.scale * pattern(k);
            if term.least == 0.0 { part.abs() } else { part }
        };
        let betas: Vec<f64> = terms.iter().enumerate().map(beta).collect();
        let numbers = effect.camera_numbers(&terms, &betas);
        let map = effect.camera_map(study.capture, &numbers).unwrap();
        assert!(effect.camera_map(study.capture, &numbers[1..]).is_none());
        let mut chain = Chain::new(&[Link { effect, terms }], study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &[betas]).unwrap();
        let recorded = chain.values().unwrap();
        for i in (0..study.seen.views.len()).step_by(97) {
            let view = &study.seen.views[i];
            let frame = view.frame as usize;
            let mut image = study.capture.frames[frame].image.clone();
            for pixel in image.data.chunks_exact_mut(3) {
                pixel.copy_from_slice(&fit.ideal[3 * i..3 * i + 3]);
            }
            (map.apply)(frame, &mut image);
            let found = effects::support::sample(&image, view.at);
            for c in 0..3 {
                let expected = recorded[3 * i + c];
                assert!(
                    (found[c] - expected).abs() < 2e-3 * expected.abs() + 1e-5,
                    "{}: {} for {expected}",
                    effect.id(),
                    found[c]
                );
            }
        }
        for (t, frame) in study.capture.frames.iter().enumerate() {
            let mut image = frame.image.clone();
            (map.apply)(t, &mut image);
            assert_ne!(image.data, frame.image.data, "{}", effect.id());
            (map.undo)(t, &mut image);
            for (a, b) in image.data.iter().zip(&frame.image.data) {
                assert!((a - b).abs() < 1e-4, "{}: {a} for {b}", effect.id());
            }
        }
        checked += 1;
    }
    assert!(checked >= 5);
}

#[test]
#[ignore = "half a minute each; run with --ignored"]
fn a_true_null_has_nothing_to_tell() {
    let capture = capture(1.0, &LARGE);
    let mut study = study(&capture, LOBE, &LARGE);
    plant(&mut study, None);
    let screen = screened(&study);
    assert!(
        compete::contenders(&screen).is_empty(),
        "{:?}",
        screen.scores[0]
    );
    let chi2 = screen.before / screen.count as f64;
    assert!((0.7..1.4).contains(&chi2), "{chi2}");
}

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

/// Asserts that an effect leads the physics of a screening, among the first `among`.
fn leads(screen: &Screen, id: &str, among: usize) {
    let physics: Vec<_> = screen
        .scores
        .iter()
        .filter(|s| effects::by_id(s.id).is_some_and(|e| !e.is_capacity()))
        .collect();
    let at = physics.iter().position(|s| s.id == id).unwrap();
    let list: Vec<_> = physics
        .iter()
        .take(6)
        .map(|s| (s.id, s.gain, s.gain_se))
        .collect();
    assert!(at < among, "{id} comes {at}: {list:?}");
    assert!(
        physics[at].gain > 3.0 * physics[at].gain_se,
        "{id}: {list:?}"
    );
}

/// What is left in frames that no fit has seen tells a mismatch as frames of development do.
#[test]
fn sealed_frames_share_what_was_planted_and_nothing_else() {
    let capture = capture(1.0, &SMALL);
    let mut study = study(&capture, LOBE, &SMALL);
    let fit = truth(&study);
    plant_on(&mut study, &fit, None);
    let null = Structured::in_sealed_frames(&study, &fit).unwrap();
    assert!(null < 0.2, "{null}");
    let effect = effects::by_id("vignetting").unwrap();
    plant_on(&mut study, &fit, Some((effect, &|k, _| [-0.3, -0.1][k])));
    let planted = Structured::in_sealed_frames(&study, &fit).unwrap();
    assert!(planted > 0.5, "{planted}");
}

/// From the photographs to the verdict: what the ignored tests below ask of screening alone, on a capture small enough for every day.
#[test]
fn what_was_planted_is_found_refitted_confirmed_and_told() {
    let capture = capture(1.0, &SMALL);
    let mut study = study(&capture, LOBE, &SMALL);
    let planted = |k: usize| {
        if k.is_multiple_of(3) {
            0.08 * pattern(k)
        } else {
            0.0
        }
    };
    let effect = effects::by_id("exposure_drift").unwrap();
    plant(&mut study, Some((effect, &|k, _| planted(k))));
    let mut first = Fit::start(&study).unwrap();
    first.refine(&study, 6).unwrap();
    let among = ["exposure_drift", "vignetting", "black_level"];
    let among = among.into_iter().filter_map(effects::by_id);
    let screen = screen_at(&study, &first, among).unwrap();
    leads(&screen, "exposure_drift", 1);

    let contenders = compete::contenders(&screen);
    let round = refit::round(&study, &first, &screen.nuisance, contenders, &|_| Ok(())).unwrap();
    assert_eq!(round.evidence[0].0, "exposure_drift");
    let evidence = round.evidence.iter();
    let mut refits: Vec<Refitted> = evidence
        .map(|&(id, evidence)| Refitted {
            after: 0,
            id,
            evidence,
            sealed: None,
        })
        .collect();
    let rounds = [round];
    let opened = confirm::open(&study, &rounds, &mut refits).unwrap();
    let step = &opened.path[0];
    assert!(refits[0].sealed.unwrap().confirmed);
    assert!(step.gain.gain > 3.0 * step.gain.error, "{:?}", step.gain);

    let errors = standard_errors(&study, step.fit).unwrap();
    let finding = told::finding(step, step.fit, &errors);
    assert_eq!(finding.id, "exposure_drift");
    // What all frames share is light and albedo as well.
    let seen = |t: &usize| !study.frame_is_sealed(*t as u32);
    let numbers = (0..SMALL.frames).filter(seen).map(|t| {
        let name = format!("gain of frame {t} (log)");
        (finding.parameters[&name], planted(3 * t))
    });
    let numbers: Vec<(f64, f64)> = numbers.collect();
    let count = numbers.len() as f64;
    let shared = numbers.iter().map(|(own, truth)| own - truth).sum::<f64>() / count;
    for (own, truth) in &numbers {
        assert!((own - truth - shared).abs() < 0.03, "{numbers:?}");
    }
    let structured = [&rounds[0].null, step.fit].map(|fit| Structured::of(&study, fit));
    let ranking = told::ranked(&screen);
    let grounds = Grounds {
        found: std::slice::from_ref(&finding),
        unknown: opened.unknown,
        refused: opened.refused,
        ranking: &ranking,
        structured: verdict::judged(structured),
    };
    assert_eq!(
        verdict::verdict(&grounds),
        Verdict::Explained,
        "{structured:?}"
    );
}

/// Deviations of a pattern without regularity.
fn pattern(k: usize) -> f64 {
    ((k * 37 + 11) % 17) as f64 / 8.0 - 1.0
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
