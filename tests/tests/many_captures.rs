//! Studies of many captures: what is derived is derived once, and one that fails does not take the others with it.

use std::{
    fs,
    process::{Command, Output},
};

use eclipse::{
    capture::{Capture, Lamp, Lamps},
    criticism::nulls,
};
use eclipse_tests::{
    program::{stderr, stdout, text},
    small_capture::small_capture,
};
use glam::Vec3;

const PROGRAM: &str = env!("CARGO_BIN_EXE_eclipse-under-test");

fn study(arguments: &[&str]) -> Output {
    let mut command = Command::new(PROGRAM);
    command.arg("study").args(arguments).output().unwrap()
}

#[test]
fn a_null_is_derived_again_when_its_base_has_changed() {
    let folder = tempfile::tempdir().unwrap();
    let plain = nulls::all()[0];
    let out = folder.path().join("base-plain");
    let seen = out.join("seen");
    // Whether deriving from `base` leaves what is there.
    let kept = |base: &Capture| {
        fs::write(&seen, "").unwrap();
        nulls::derive_into(&out, base.clone(), plain).unwrap();
        seen.exists()
    };

    let mut base = small_capture(Vec3::ZERO);
    nulls::derive_into(&out, base.clone(), plain).unwrap();
    assert!(out.join("transforms.json").is_file());
    assert!(kept(&base));
    base.frames[2].image.data[7] += 0.25;
    assert!(!kept(&base));
    assert!(kept(&base));
    let lamp = |strength| Lamp {
        direction: Vec3::Z,
        strength: [strength; 3],
    };
    for strength in [1.0, 2.0] {
        base.lamps = Some(Lamps {
            lamps: vec![lamp(strength); base.frames.len()],
            ball: false,
        });
        assert!(!kept(&base), "{strength}");
    }

    // What is no capture is not ours to remove.
    let taken = folder.path().join("taken");
    fs::create_dir(&taken).unwrap();
    fs::write(taken.join("notes.txt"), "mine").unwrap();
    let error = nulls::derive_into(&taken, base, plain).unwrap_err();
    assert!(error.to_string().contains("not empty"), "{error}");
    assert!(taken.join("notes.txt").is_file());
}

#[test]
fn bases_of_one_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (one, other) = (folder.path().join("a/x"), folder.path().join("b/x"));
    let out = folder.path().join("out");
    let output = study(&["nulls", text(&one), text(&other), "--out", text(&out)]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains(r#"are called "x""#), "{message}");
    assert!(!out.exists());
}

#[test]
fn every_capture_that_fails_is_listed_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (captures, out) = (folder.path().join("captures"), folder.path().join("out"));
    for name in ["first", "second"] {
        fs::create_dir_all(captures.join(name)).unwrap();
    }
    let labels = folder.path().join("labels.json");
    let label = r#"{"first": {"effects": []}, "second": {"effects": ["outside"]}}"#;
    fs::write(&labels, label).unwrap();
    let listed = |arguments: &[&str]| {
        let output = study(&[arguments, &["--out", text(&out), "--json"]].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(3), "{message}");
        let printed: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
        let kept = fs::read_to_string(out.join("scores.json")).unwrap();
        assert_eq!(kept, stdout(&output));
        for failed in printed["failed"].as_array().unwrap() {
            let [capture, problem] = ["capture", "problem"].map(|key| failed[key].as_str());
            assert!(message.contains(capture.unwrap()), "{message}");
            assert!(message.contains(problem.unwrap()), "{message}");
        }
        (printed["failed"].as_array().unwrap().len(), message)
    };

    let mismatch = ["mismatch", text(&captures), "--labels", text(&labels)];
    let (failed, message) = listed(&mismatch);
    assert_eq!(failed, 2);
    assert!(message.contains("2 of 2 captures"), "{message}");
    let (failed, _) = listed(&[
        "nulls",
        text(&captures.join("first")),
        "--structures",
        "plain,more_noise",
    ]);
    assert_eq!(failed, 2);
}

#[test]
fn folders_without_a_label_and_labels_without_a_folder_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let captures = folder.path().join("captures");
    for name in ["first", "unknown", "day/hall", ".git"] {
        fs::create_dir_all(captures.join(name)).unwrap();
    }
    let labels = folder.path().join("labels.json");
    let label =
        r#"{"first": {"effects": []}, "gone": {"effects": []}, "day/hall": {"effects": []}}"#;
    fs::write(&labels, label).unwrap();
    let mismatch = ["mismatch", text(&captures), "--labels", text(&labels)];
    let output = study(&[mismatch.as_slice(), &["--json"]].concat());
    let message = stderr(&output);
    let skipped = "unknown was not diagnosed: the labels do not name it";
    assert!(message.contains(skipped), "{message}");
    let skipped = "gone was not diagnosed: there is no such folder";
    assert!(message.contains(skipped), "{message}");
    let printed: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
    let names: Vec<&str> = printed["skipped"]
        .as_array()
        .unwrap()
        .iter()
        .map(|one| one["capture"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["unknown", "gone"]);
    let of = |arguments: &[&str]| stderr(&study(&[&mismatch, arguments].concat()));
    assert!(!of(&["--only", "first"]).contains("unknown"));
}

#[test]
fn labels_name_effects_that_are_known() {
    let folder = tempfile::tempdir().unwrap();
    let labels = folder.path().join("labels.json");
    fs::write(&labels, r#"{"hall": {"effects": ["exposure_drfit"]}}"#).unwrap();
    let output = study(&["mismatch", text(folder.path()), "--labels", text(&labels)]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    for part in [
        "labels.json",
        r#""hall""#,
        r#""exposure_drfit""#,
        "exposure_drift",
        "outside",
    ] {
        assert!(message.contains(part), "{message}");
    }
}
