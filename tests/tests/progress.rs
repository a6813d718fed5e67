//! `--progress json`: what programs read while work is under way.

use std::process::{Command, Output};

use eclipse_tests::{
    program::{stderr, stdout, text},
    small_capture,
};
use serde_json::{Value, json};

fn eclipse(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"))
        .args(arguments)
        .args(["--progress", "json"])
        .output()
        .unwrap()
}

/// Standard error, of which every line must be an event; the last one tells the exit code.
fn events(output: &Output) -> Vec<Value> {
    let text = stderr(output);
    let parse =
        |line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{line:?}: {error}"));
    let events: Vec<Value> = text.lines().map(parse).collect();
    let last = events.last().expect("there is an event at least");
    assert_eq!(last["event"], "end", "{text}");
    assert_eq!(last["exit_code"], json!(output.status.code()), "{text}");
    let ends = events.iter().filter(|event| event["event"] == "end");
    assert_eq!(ends.count(), 1, "{text}");
    events
}

#[test]
fn a_reconstruction_tells_its_start_its_steps_and_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let capture = text(small_capture::on_disk());
    let out = folder.path().join("out");
    let options = ["--lambertian", "--iterations", "3", "--json"];
    let output = eclipse(&[&["reconstruct", capture, "--out", text(&out)][..], &options].concat());
    let events = events(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(
        (&events[0]["event"], &events[0]["frames"]),
        (&json!("start"), &json!(8))
    );
    assert!(events[0]["memory_bytes"].as_u64().unwrap() > 1 << 20);
    let steps: Vec<&Value> = events
        .iter()
        .filter(|event| event["event"] == "progress" && event["loss"].is_number())
        .collect();
    // Steps that follow at once are not all told, but the last of three is.
    let last = steps.last().expect("a step is told");
    assert_eq!(
        (&last["done"], &last["of"]),
        (&json!(3), &json!(3)),
        "{last}"
    );
    assert_eq!(last["share"], 1.0);
    assert!(last["samples_per_second"].as_f64().unwrap() > 0.0);
    assert!(last["seconds_left"].as_f64().unwrap() < 1e-9);
    let stages: Vec<&Value> = events.iter().map(|event| &event["stage"]).collect();
    assert!(
        stages.contains(&&json!("materials and renders")),
        "{stages:?}"
    );
    // Results keep standard output to themselves.
    let results: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert!(results["metrics"].is_object());

    let map = out.join("environment.exr");
    let relit = folder.path().join("relit");
    let output = eclipse(&[
        "relight",
        text(&out),
        "--environment",
        text(&map),
        "--frames",
        "2",
        "--size",
        "16x16",
        "--samples",
        "4",
        "--out",
        text(&relit),
    ]);
    let events = self::events(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let pictures = events.iter().filter(|event| event["stage"] == "pictures");
    assert!(pictures.clone().all(|event| event["of"] == json!(2)));
    assert!(pictures.count() >= 1);
}

#[test]
fn a_failure_is_an_event_too() {
    let output = eclipse(&["reconstruct", "/nowhere/capture"]);
    let events = events(&output);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(events.len(), 1);
    let error = events[0]["error"].as_str().unwrap();
    assert!(error.contains("/nowhere/capture"), "{error}");
}

#[test]
fn diagnoses_and_studies_tell_their_stages() {
    let folder = tempfile::tempdir().unwrap();
    let capture = text(small_capture::on_disk());
    let out = folder.path().join("out");
    let output = eclipse(&[
        "diagnose",
        capture,
        "--time-limit",
        "5m",
        "--effects",
        "vignetting",
        "--out",
        text(&out),
    ]);
    let told = events(&output);
    assert!(
        told.iter()
            .any(|event| event["stage"] == "reconstructing without occluders"),
        "{told:?}"
    );
    assert!(
        told.iter().any(|event| event["loss"].is_number()),
        "{told:?}"
    );

    let output = eclipse(&["study", "theory", "--out", text(&out)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let told = events(&output);
    assert!(
        told.iter().any(|event| event["event"] == "progress"),
        "{told:?}"
    );
}

#[test]
fn nothing_is_told_where_nobody_asks() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"))
        .args([
            "reconstruct",
            text(small_capture::on_disk()),
            "--lambertian",
        ])
        .args([
            "--iterations",
            "1",
            "--progress",
            "none",
            "--out",
            text(&out),
        ])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(stderr(&output), "");
}

#[test]
fn a_screen_needs_a_terminal_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"))
        .args([
            "reconstruct",
            text(small_capture::on_disk()),
            "--tui",
            "--out",
        ])
        .arg(folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let message = stderr(&output);
    assert!(message.contains("not a terminal"), "{message}");
    assert!(!message.contains('\u{1b}'), "{message:?}");
}
