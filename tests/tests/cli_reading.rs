//! `--up` and `--max-size`: what is written is upright, and a run that goes on reads as it began.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
    sync::OnceLock,
};

use eclipse::{
    capture::{Capture, LoadOptions, UpAxis, write},
    evaluate::environment,
    image_io::read_exr,
    mesh_io::read_mesh,
};
use eclipse_tests::{
    capture_turned::lying,
    program::{self, stderr, text},
    small_capture,
};
use serde_json::Value;
use tempfile::TempDir;

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}

/// Runs a line of words, the capture and the folder of the results in place of `CAPTURE` and `OUT`.
fn run(line: &str, capture: &Path, out: &Path) -> Output {
    let word = |word| match word {
        "CAPTURE" => text(capture),
        "OUT" => text(out),
        other => other,
    };
    let words: Vec<&str> = line.split_whitespace().map(word).collect();
    eclipse(&words)
}

fn done(line: &str, capture: &Path, out: &Path) -> Output {
    let output = run(line, capture, out);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{line}: {message}");
    output
}

fn loaded() -> Capture {
    Capture::load(small_capture::on_disk(), &LoadOptions::default()).unwrap()
}

/// The small capture in a world whose y points down.
fn on_its_head() -> &'static Path {
    static FOLDER: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("capture");
        write(&path, &lying(&loaded(), UpAxis::NegY)).unwrap();
        (folder, path)
    });
    path
}

/// A file of a result.
fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    fs::read(folder.join(name)).unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_result_is_upright_whichever_axis_was_up() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, turned] = ["plain", "turned"].map(|name| folder.path().join(name));
    let line = "reconstruct CAPTURE --lambertian --iterations 2 --json --out OUT";
    done(line, small_capture::on_disk(), &plain);
    done(&format!("{line} --up -y"), on_its_head(), &turned);

    let mesh = read_mesh(&turned.join("mesh.glb")).unwrap();
    let capture = loaded();
    assert_eq!(mesh.positions.len(), capture.mesh.positions.len());
    for (found, expected) in mesh.positions.iter().zip(&capture.mesh.positions) {
        assert!((*found - *expected - capture.centre).length() < 1e-4);
    }
    // The same light from the same sides: rounding aside, the same run. Light from elsewhere would be off by far more.
    let light = |folder: &Path| read_exr(&folder.join("environment.exr")).unwrap();
    let apart = environment::compare(&light(&turned), &light(&plain)).score;
    let apart = apart.texels.relative_rmse_aligned.unwrap();
    assert!(apart < 0.1, "{apart}");
    for frame in 0..capture.frames.len() {
        let name = format!("renders/{frame:03}.exr");
        let [a, b] = [&plain, &turned].map(|out| read_exr(&out.join(&name)).unwrap());
        let sum = |values: &mut dyn Iterator<Item = f32>| values.sum::<f32>();
        let pairs = a.data.iter().zip(&b.data);
        let difference = sum(&mut pairs.map(|(a, b)| (a - b).abs()));
        let whole = sum(&mut a.data.iter().map(|v| v.abs()));
        assert!(difference < 0.05 * whole, "{name}: {difference} of {whole}");
    }

    // Through cameras of the capture's file.
    let cameras = on_its_head().join("transforms.json");
    let relit = folder.path().join("relit");
    let map = plain.join("environment.exr");
    let line = format!(
        "relight CAPTURE --environment {} --camera {} --up -y --size 16x16 --samples 2 --frames 1 --out OUT",
        text(&map),
        text(&cameras)
    );
    done(&line, &turned, &relit);
    let record = json(&relit.join("relight.json"));
    let pose = capture.frames[0].camera.world_from_camera;
    for row in 0..4 {
        for column in 0..4 {
            let centre = if column == 3 && row < 3 {
                capture.centre[row]
            } else {
                0.0
            };
            let expected = f64::from(pose.col(column)[row] + centre);
            let found = record["cameras"][0][row][column].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}

#[test]
fn a_run_that_goes_on_reads_as_it_began() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    let begin = "reconstruct CAPTURE --lambertian --json --out OUT --up -y --max-size 20";
    done(&format!("{begin} --iterations 2"), on_its_head(), &whole);
    done(&format!("{begin} --iterations 1"), on_its_head(), &parts);
    let go_on = "reconstruct CAPTURE --json --out OUT --resume --iterations";
    done(&format!("{go_on} 2"), on_its_head(), &parts);
    for name in ["environment.exr", "renders/003.exr", "mesh.glb"] {
        assert!(bytes(&whole, name) == bytes(&parts, name), "{name}");
    }
    let render = read_exr(&parts.join("renders/003.exr")).unwrap();
    assert_eq!([render.width, render.height], [20, 20]);
    // What repeats the run says it.
    let page = fs::read_to_string(parts.join("report.html")).unwrap();
    assert!(page.contains("--up -y --max-size 20"));

    for (option, expected) in [
        ("--up x", "`up` = -y, now it is x"),
        ("--max-size 16", "`max_size` = 20, now it is 16"),
    ] {
        let output = run(&format!("{go_on} 3 {option}"), on_its_head(), &parts);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(3), "{option}: {message}");
        assert!(message.contains(expected), "{option}: {message}");
    }
}

#[test]
fn inspect_sees_what_a_run_would() {
    let nowhere = Path::new("unused");
    let inspected = |line: &str, capture: &Path| -> Value {
        let output = done(line, capture, nowhere);
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let plain = inspected("inspect CAPTURE --json", small_capture::on_disk());
    let turned = inspected(
        "inspect CAPTURE --json --up -y --max-size 20",
        on_its_head(),
    );
    let on_its_side = inspected("inspect CAPTURE --json", on_its_head());
    let elevations = |inspection: &Value| -> Vec<f64> {
        let frames = inspection["frames"].as_array().unwrap().iter();
        frames.map(|f| f["elevation"].as_f64().unwrap()).collect()
    };
    let far = |a: &Value, b: &Value| {
        let pairs = elevations(a).into_iter().zip(elevations(b));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    assert!(far(&turned, &plain) < 0.1);
    assert!(far(&on_its_side, &plain) > 5.0);
    assert_eq!(turned["frames"][0]["width"], 20);
    assert_eq!(plain["frames"][0]["width"], 24);
}

#[test]
fn an_axis_that_is_none_and_a_size_of_nothing_are_wrong_usage() {
    for options in ["--up up", "--up 3", "--max-size 0", "--max-size big"] {
        let line = format!("inspect CAPTURE {options}");
        let output = run(&line, small_capture::on_disk(), Path::new("unused"));
        assert_eq!(output.status.code(), Some(2), "{options}");
    }
    let help = eclipse(&["reconstruct", "--help"]);
    assert!(program::stdout(&help).contains("--up <AXIS>"));
}
