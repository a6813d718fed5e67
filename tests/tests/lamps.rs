//! Captures whose lamps are known: read, inspected, refused by what looks for unknown light, and criticised.

use std::{
    fs,
    process::Output,
    sync::{Arc, OnceLock},
};

use eclipse::{
    capture::{Capture, LoadOptions, write},
    criticism::{
        self, Outcome, Simulation, Verdict,
        chain::{Chain, Link},
        diagnose::{DiagnoseError, Options},
        effects,
        fit::Fit,
        light::Light,
        locate,
        study::Study,
    },
    inspect::inspect,
    reconstruct::check_light,
    settings::Settings,
};
use eclipse_tests::{
    lit_ball::{self, FRAMES, SCALE, SIZE, lamps, written},
    program,
};
use glam::Vec3;
use render::camera::Projection;
use serde_json::{Value, json};

/// The ball as its capture says, made once.
fn plain() -> &'static Capture {
    static PLAIN: OnceLock<Capture> = OnceLock::new();
    PLAIN.get_or_init(|| lit_ball::capture(&lamps(), &lamps(), |_, _, light| light))
}

/// The message that a capture is refused with after `spoil` changed its `transforms.json`.
fn says(spoil: impl Fn(&mut Value)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut json = written(folder.path(), plain());
    spoil(&mut json);
    fs::write(folder.path().join("transforms.json"), json.to_string()).unwrap();
    match Capture::load(folder.path(), &LoadOptions::default()) {
        Ok(_) => panic!("it loaded"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_ball_under_lamps_is_read_and_understood() {
    let folder = tempfile::tempdir().unwrap();
    let made = plain();
    let json = written(folder.path(), made);
    fs::write(folder.path().join("transforms.json"), json.to_string()).unwrap();
    let (inspection, capture) =
        inspect(folder.path(), LoadOptions::default(), &Settings::default()).unwrap();
    let known = capture.lamps.as_ref().unwrap();
    assert!(known.ball);
    for (lamp, direction) in known.lamps.iter().zip(lamps()) {
        assert!((lamp.direction - direction).length() < 1e-5);
        assert_eq!(lamp.strength, [1.0; 3]);
    }
    for frame in &capture.frames {
        assert_eq!(frame.camera.projection, Projection::Orthographic);
        // Off the object, wherever the file put it.
        assert!(frame.camera.centre().z > 2.0);
        let [x, y] = frame.camera.project(Vec3::new(0.5, -0.25, 0.0)).unwrap();
        let [cx, cy] = made.frames[0].camera.principal;
        assert!((x - cx - 0.5 * SCALE).abs() < 1e-3 && (y - cy - 0.25 * SCALE).abs() < 1e-3);
    }
    assert_eq!(inspection.problem, None);
    assert_eq!(inspection.warnings, [""; 0]);
    assert!(inspection.silhouettes.worst > 0.95);
    let told = inspection.lamps.unwrap();
    assert!((told.angles[0] - 0.75f32.to_degrees()).abs() < 0.1);
    assert!(told.spread > 60.0 && told.ball);

    // Written by the program it says the same again.
    let again = folder.path().join("again");
    write(&again, &capture).unwrap();
    let read = Capture::load(&again, &LoadOptions::default()).unwrap();
    assert_eq!(read.lamps, capture.lamps);
    for (a, b) in read.frames.iter().zip(&capture.frames) {
        assert_eq!(a.camera.focal, b.camera.focal);
        assert_eq!(a.camera.projection, b.camera.projection);
    }
}

#[test]
fn what_is_wrong_is_said() {
    let message = says(|json| json["frames"][3]["lamp"] = Value::Null);
    assert!(
        message.contains("\"03\"") && message.contains("`lamp`"),
        "{message}"
    );
    let message = says(|json| json["frames"][2]["lamp"]["direction"] = json!([0.0, 0.5, 0.5]));
    for part in ["\"02\"", "`lamp.direction`", "0.7071", "unit vector"] {
        assert!(message.contains(part), "{part} in {message}");
    }
    let message = says(|json| json["frames"][2]["lamp"]["direction"] = json!([0.0, 1.0]));
    assert!(
        message.contains("2 numbers") && message.contains("expected 3"),
        "{message}"
    );
    let message = says(|json| json["frames"][1]["lamp"]["strength"] = json!([1.0, -1.0, 1.0]));
    assert!(message.contains("`lamp.strength`"), "{message}");
    let message = says(|json| json["pixels_per_unit"] = Value::Null);
    assert!(
        message.contains("`pixels_per_unit` is missing"),
        "{message}"
    );
    let message = says(|json| json["pixels_per_unit"] = json!(-3.0));
    assert!(message.contains("`pixels_per_unit` is -3"), "{message}");
    let message = says(|json| json["shape"]["sphere"]["radius"] = json!(0.0));
    assert!(message.contains("shape.sphere.radius"), "{message}");
    let message = says(|json| json["shape"] = json!({ "cube": {} }));
    assert!(message.contains("cube"), "{message}");
    let message = says(|json| {
        for frame in json["frames"].as_array_mut().unwrap() {
            frame["lamp"] = Value::Null;
        }
    });
    assert!(
        message.contains("ORTHOGRAPHIC") && message.contains("`lamp`"),
        "{message}"
    );
    // A ball twice as large is not where the masks are.
    let message = says(|json| json["shape"]["sphere"]["radius"] = json!(2.0));
    assert!(message.contains("disagree"), "{message}");
}

#[test]
fn whoever_looks_for_unknown_light_is_told_where_to_go() {
    let capture = plain();
    let message = check_light(capture).unwrap_err().to_string();
    assert!(message.contains("eclipse diagnose"), "{message}");
    let (output, made) = run("reconstruct", capture);
    assert!(!output.status.success());
    assert!(program::stderr(&output).contains("eclipse diagnose"));
    assert!(!made);
}

/// What a command says of a capture, and whether it made the folder of its results.
fn run(command: &str, capture: &Capture) -> (Output, bool) {
    let folder = tempfile::tempdir().unwrap();
    let json = written(folder.path(), capture);
    fs::write(folder.path().join("transforms.json"), json.to_string()).unwrap();
    let out = folder.path().join("out");
    let arguments = [
        command,
        program::text(folder.path()),
        "--out",
        program::text(&out),
    ];
    let output = program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), &arguments);
    (output, out.exists())
}

#[test]
fn too_few_photographs_are_bad_input() {
    // No place is seen in three frames.
    let few = &lamps()[..2];
    let capture = lit_ball::capture(few, few, |_, _, light| light);
    let (output, _) = run("diagnose", &capture);
    let message = program::stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains("seen well in three frames"), "{message}");
}

fn simulation(capture: &Capture) -> Simulation {
    Simulation::under_lamps(capture, capture.lamps.as_ref().unwrap()).unwrap()
}

/// Without anything added the simulation is what the formula draws, shadow and all.
#[test]
fn the_simulation_is_the_formula() {
    let capture = plain();
    let simulation = simulation(capture);
    let (mut squares, mut count, mut dark) = (0.0, 0, 0);
    for (frame, render) in capture.frames.iter().zip(&simulation.renders) {
        for (p, &inside) in frame.mask.data.iter().enumerate() {
            if inside < 0.999 {
                continue;
            }
            let (value, model) = (frame.image.data[3 * p], render.data[3 * p]);
            // Clouds of a tenth of the albedo, and noise.
            assert!(
                (value - model).abs() < 0.16 * model + 0.03,
                "{value} {model}"
            );
            squares += f64::from(value - model).powi(2);
            count += 1;
            dark += usize::from(model == 0.0);
        }
    }
    assert!((squares / count as f64).sqrt() < 0.04);
    assert!(dark > 500, "{dark}");
}

#[test]
fn nulls_change_no_bit_under_lamps() {
    let capture = plain();
    let study = Study::new(capture, &simulation(capture), 500, 20, 3).unwrap();
    let fit = Fit::start(&study).unwrap();
    let values = |links: &[Link], betas: &[Vec<f64>]| {
        let mut chain = Chain::new(links, study.seen.len()).unwrap();
        chain.bind(&fit.ideal, betas).unwrap();
        let values = chain.values().unwrap();
        values.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let plain = values(&[], &[]);
    let mut told = Vec::new();
    for effect in effects::all().into_iter().filter(|e| e.under(Light::Lamps)) {
        let terms = Arc::new(effect.terms(&fit.scene(&study)));
        if terms.is_empty() {
            continue;
        }
        told.push(effect.id());
        let null = vec![0.0; terms.len()];
        let given = study.horizon.lamps().unwrap();
        assert!(effect.moved_lamps(given, &study.seen, &null).is_none());
        let with = values(&[Link { effect, terms }], &[null]);
        assert_eq!(with, plain, "{}", effect.id());
    }
    for id in [
        "lamp_direction",
        "ambient_light",
        "exposure_drift",
        "near_field_light",
    ] {
        assert!(told.contains(&id), "{id} of {told:?}");
    }
}

/// A lamp is its frame's own: every frame takes part, and may be where the photographs differ whatever is in the model.
#[test]
fn no_frame_is_sealed_under_known_lamps() {
    let gain = |t: usize| if t == 3 { 1.3 } else { 1.0 };
    let capture = lit_ball::capture(&lamps(), &lamps(), |t, _, light| light.map(|v| gain(t) * v));
    let study = Study::new(&capture, &simulation(&capture), 500, 20, 3).unwrap();
    assert!(!study.seals_frames());
    let mut fit = Fit::start(&study).unwrap();
    fit.add(effects::by_id("exposure_drift").unwrap(), Vec::new());
    fit.relink(&study).unwrap();
    fit.evaluate(&study).unwrap();
    assert!(!fit.is_shared());
    let spots = locate::hot_spots(&study, &fit, &fit, 12);
    assert_eq!(spots.first().map(|spot| spot.frame), Some(3));
}

fn diagnosed(capture: &Capture) -> Outcome<'_> {
    let options = Options {
        sites: 1200,
        ..Options::default()
    };
    criticism::diagnose(capture, &simulation(capture), &options, &|_| true).unwrap()
}

#[test]
fn effects_of_unknown_light_are_refused_by_name() {
    let capture = plain();
    let options = Options {
        effects: vec!["moving_occluder".to_owned()],
        ..Options::default()
    };
    let refused = criticism::diagnose(capture, &simulation(capture), &options, &|_| true);
    let Err(error @ DiagnoseError::OtherLight { .. }) = refused else {
        panic!("it was not refused");
    };
    assert!(error.to_string().contains("moving_occluder"));
}

#[test]
fn true_lamps_have_nothing_missing() {
    let d = diagnosed(plain()).diagnosis;
    let told = format!("{} ({:?}, {:?})", d.sentence, d.structured, d.refits);
    assert_eq!(d.verdict, Verdict::NothingMissing, "{told}");
}

/// Rounding is not independent from pixel to pixel, so that eight bits may leave a doubt, but no physics.
#[test]
fn eight_bits_are_no_physics() {
    let mut capture = plain().clone();
    lit_ball::to_eight_bits(&mut capture);
    let outcome = diagnosed(&capture);
    assert!(outcome.study.seen.eight_bits);
    let d = outcome.diagnosis;
    let harmless = [Verdict::NothingMissing, Verdict::Underpowered];
    assert!(
        d.effects.is_empty() && harmless.contains(&d.verdict),
        "{}",
        d.sentence
    );
}

/// Turns a direction by degrees to the right of the image and upwards.
fn turned(direction: Vec3, right: f32, up: f32) -> Vec3 {
    let across = (Vec3::X - Vec3::X.dot(direction) * direction).normalize();
    let above = direction.cross(across);
    let angle = right.hypot(up).to_radians();
    let along = (right * across + up * above).normalize();
    angle.cos() * direction + angle.sin() * along
}

#[test]
fn a_ball_that_is_elsewhere_is_found_where_it_is() {
    // In its radii, to the right and upwards: so little that normals are linear in it.
    let moved = [-0.02f32, 0.012];
    let mut capture = plain().clone();
    for frame in &mut capture.frames {
        frame.camera.principal[0] -= moved[0] * SCALE;
        frame.camera.principal[1] += moved[1] * SCALE;
    }
    let d = diagnosed(&capture).diagnosis;
    let found = d.effects.first();
    assert_eq!(found.map(|e| e.id), Some("pose_error"), "{}", d.sentence);
    let found = &found.unwrap().parameters;
    for (name, wanted) in [("further to the right", moved[0]), ("higher", moved[1])] {
        let number = found[&format!("the ball is {name} (its radii)")];
        assert!(
            (number - f64::from(wanted)).abs() < 0.006,
            "{name}: {number}"
        );
    }
}

#[test]
fn lamps_that_stand_elsewhere_are_found_where_they_are() {
    let wrong = [(2, [4.0f32, -2.0]), (5, [-3.0, 3.0]), (9, [0.0, 6.0])];
    let mut shone = lamps();
    for (frame, [right, up]) in wrong {
        shone[frame] = turned(shone[frame], right, up);
    }
    let capture = lit_ball::capture(&lamps(), &shone, |_, _, light| light);
    let d = diagnosed(&capture).diagnosis;
    assert_eq!(
        d.effects.first().map(|e| e.id),
        Some("lamp_direction"),
        "{}",
        d.sentence
    );
    assert_eq!(d.verdict, Verdict::Explained, "{}", d.sentence);
    let found = &d.effects[0];
    assert!(found.sealed_gain > 3.0 * found.sealed_gain_se);
    for frame in 0..FRAMES {
        let truth = wrong
            .iter()
            .find(|(t, _)| *t == frame)
            .map_or([0.0; 2], |(_, turn)| *turn);
        for (side, truth) in ["to the image's right", "upwards"].iter().zip(truth) {
            let name = format!("lamp of frame {frame} {side} (degrees)");
            let (value, error) = (found.parameters[&name], found.standard_errors[&name]);
            assert!(error < 0.5, "{name} ± {error}");
            let away = (value - f64::from(truth)).abs();
            assert!(
                away < 4.0 * error + 0.05,
                "{name}: {value} ± {error} for {truth}"
            );
        }
    }
    let named: Vec<usize> = found.place["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|t| t.as_u64().unwrap() as usize)
        .collect();
    assert!(wrong.iter().all(|(t, _)| named.contains(t)), "{named:?}");
    // Errors hold noise alone; what pixels and facets do is a few hundredths of a degree, and may name a frame besides.
    assert!(named.len() <= wrong.len() + 2, "{named:?}");
}

#[test]
fn lamps_of_unlike_strength_are_exposure() {
    let gain = |t: usize| [1.0, 1.12, 0.93, 1.05][t % 4];
    let capture = lit_ball::capture(&lamps(), &lamps(), |t, _, light| light.map(|v| gain(t) * v));
    let d = diagnosed(&capture).diagnosis;
    assert_eq!(
        d.effects.first().map(|e| e.id),
        Some("exposure_drift"),
        "{}",
        d.sentence
    );
}

#[test]
fn light_besides_the_lamps_is_found() {
    let mut lit = plain().clone();
    // A dim sky above: the formula again, per pixel.
    for frame in &mut lit.frames {
        for p in 0..SIZE * SIZE {
            let [cx, cy] = frame.camera.principal;
            let x = ((p % SIZE) as f32 + 0.5 - cx) / SCALE;
            let y = (cy - (p / SIZE) as f32 - 0.5) / SCALE;
            if x * x + y * y < 1.0 {
                let sky = 0.03 * 0.5 * (1.0 + y);
                (0..3).for_each(|c| frame.image.data[3 * p + c] += sky);
            }
        }
    }
    let d = diagnosed(&lit).diagnosis;
    let first = d.effects.first().expect("an effect");
    // On a ball of nearly one albedo, light that it gives off itself does as well.
    let alike = ["ambient_light", "emission"];
    assert!(alike.contains(&first.id), "{}", d.sentence);
}
