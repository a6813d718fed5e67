//! What `eclipse diagnose` leaves in its folder, by the program itself on photographs of a ball under known lamps.

use std::{fs, path::PathBuf, sync::OnceLock};

use eclipse::{image_io::read_exr, layout};
use eclipse_tests::{
    lit_ball::{self, FRAMES, SIZE, lamps, written},
    program,
};
use serde_json::Value;
use tempfile::TempDir;

/// The folder of results and what was printed, made once: lamps of unlike strength, three effects to choose from.
fn diagnosed() -> &'static (TempDir, PathBuf, String) {
    static MADE: OnceLock<(TempDir, PathBuf, String)> = OnceLock::new();
    MADE.get_or_init(|| {
        let gain = |t: usize| [1.0, 1.12, 0.93, 1.05][t % 4];
        let capture =
            lit_ball::capture(&lamps(), &lamps(), |t, _, light| light.map(|v| gain(t) * v));
        let folder = tempfile::tempdir().unwrap();
        let ball = folder.path().join("ball");
        fs::create_dir(&ball).unwrap();
        let json = written(&ball, &capture);
        fs::write(ball.join("transforms.json"), json.to_string()).unwrap();
        let out = folder.path().join("out");
        let arguments = [
            "diagnose",
            program::text(&ball),
            "--out",
            program::text(&out),
            "--effects",
            "exposure_drift,lamp_direction,black_level",
            "--json",
        ];
        let output = program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), &arguments);
        assert!(output.status.success(), "{}", program::stderr(&output));
        (folder, out, program::stdout(&output))
    })
}

fn json() -> Value {
    let (_, out, _) = diagnosed();
    serde_json::from_slice(&fs::read(out.join("diagnosis.json")).unwrap()).unwrap()
}

/// Asserts that an object has these keys.
fn has(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some(), "{key} of {object:#}");
    }
}

#[test]
fn diagnosis_json_has_what_is_promised() {
    let d = json();
    let (_, _, printed) = diagnosed();
    assert_eq!(serde_json::from_str::<Value>(printed).unwrap(), d);
    let keys = [
        "verdict",
        "effects",
        "ranking",
        "sealed",
        "unexplained_fraction",
        "hot_spots",
        "sentence",
    ];
    has(&d, &keys);
    let verdicts = [
        "explained",
        "ambiguous",
        "underpowered",
        "nothing_missing",
        "unexplained",
    ];
    assert!(verdicts.contains(&d["verdict"].as_str().unwrap()));
    let effects = d["effects"].as_array().unwrap();
    assert_eq!(effects[0]["id"], "exposure_drift", "{}", d["sentence"]);
    for effect in effects {
        let numbers = [
            "sealed_gain",
            "sealed_gain_se",
            "p_holm",
            "survival",
            "minimum_detectable",
            "size",
            "size_se",
        ];
        has(effect, &numbers);
        assert!(numbers.iter().all(|key| effect[key].is_f64()), "{effect:#}");
        let names = |key: &str| -> Vec<String> {
            effect[key].as_object().unwrap().keys().cloned().collect()
        };
        assert_eq!(names("parameters"), names("standard_errors"));
        assert!(effect["ambiguous_with"].is_array() && effect["where"].is_object());
        assert!(!effect["confused_with"].as_array().unwrap().is_empty());
    }
    for ranked in d["ranking"].as_array().unwrap() {
        has(ranked, &["id", "gain", "gain_se", "p"]);
    }
    has(&d["sealed"], &["rmse_before", "rmse_after"]);
    let chi2 = ["chi2_before", "chi2_after"].map(|key| d["sealed"][key].as_f64().unwrap());
    assert!(chi2[1] < 0.5 * chi2[0], "{chi2:?}");
    let left = d["unexplained_fraction"].as_f64().unwrap();
    assert!((0.0..0.5).contains(&left), "{left}");
    let spots = d["hot_spots"].as_array().unwrap();
    assert!(!spots.is_empty());
    for spot in spots {
        has(spot, &["sigma"]);
        assert!((spot["frame"].as_u64().unwrap() as usize) < FRAMES);
        assert_eq!(spot["pixels"].as_array().unwrap().len(), 4);
        assert_eq!(spot["surface_point"].as_array().unwrap().len(), 3);
    }
    // Nothing was reconstructed, and all else took its time.
    let seconds = |part: &str| d["seconds"][part].as_f64().unwrap();
    assert_eq!(seconds("reconstruction"), 0.0);
    assert!(seconds("total") >= seconds("all") && seconds("all") > 0.0);
    let ambiguous = d["verdict"] == "ambiguous";
    assert_eq!(!d["separate_by"].as_array().unwrap().is_empty(), ambiguous);
}

#[test]
fn the_page_says_and_shows_it() {
    let (_, out, _) = diagnosed();
    let d = json();
    let page = fs::read_to_string(out.join("diagnosis.html")).unwrap();
    let sentence = d["sentence"].as_str().unwrap().replace('"', "&quot;");
    for part in [
        "<title>Diagnosis of ball</title>",
        &sentence,
        "<h2>Added to the model</h2>",
        "<b>exposure_drift</b>",
        "<h2>Where they differ</h2>",
        "<svg class=\"strip\"",
        "<div class=\"boxed\">",
        "<h3>Most, after</h3>",
        "<h2>All effects</h2>",
        "added to the model",
        "<h2>Refits</h2>",
        // Under known lamps no frame is sealed, and no number is unknown.
        "one patch of surface in seven, in all frames",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("was not fitted"));
    for tag in ["table", "div", "svg", "p", "ul"] {
        let opened =
            page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
        let closed = page.matches(&format!("</{tag}>")).count();
        assert_eq!(opened, closed, "{tag}");
    }
    // As many boxes as there are hot spots, at least.
    let spots = d["hot_spots"].as_array().unwrap().len();
    assert!(page.matches("<span style=\"left:").count() >= spots);
}

#[test]
fn maps_of_every_frame_are_smaller_after_than_before() {
    let (_, out, _) = diagnosed();
    let energy = |kind: &str, channels: usize| {
        let mut sum = 0.0;
        for t in 0..FRAMES {
            let file = format!("{kind}-{}", layout::numbered(t));
            let map = read_exr(&out.join(layout::MAPS).join(file)).unwrap();
            assert_eq!(
                [map.width, map.height, map.channels],
                [SIZE, SIZE, channels]
            );
            let known = map.data.iter().filter(|v| v.is_finite());
            sum += known.map(|v| f64::from(*v).powi(2)).sum::<f64>();
        }
        sum
    };
    for (kind, channels) in [("residual", 3), ("significance", 1)] {
        let [before, after] =
            ["before", "after"].map(|when| energy(&format!("{kind}-{when}"), channels));
        assert!(
            0.0 < after && after < 0.7 * before,
            "{kind}: {before} {after}"
        );
    }
}
