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
    image_io::{read_exr, write_exr},
    mesh_io::read_mesh,
    output,
    report::ReportOptions,
};
use eclipse_tests::{
    capture_turned::lying,
    perfect,
    program::{self, stderr, text},
    small_capture,
};
use render::image::Image;
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

    assert_eq!(json(&turned.join("settings.json"))["reading"]["up"], "-y");
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
    let line = relight(&map, &cameras);
    done(&line, &turned, &relit);
    assert_seen_as_by(&relit, &capture);
}

/// A picture through the first of these cameras, the run in place of the capture.
fn relight(map: &Path, cameras: &Path) -> String {
    format!(
        "relight CAPTURE --environment {} --camera {} --size 16x16 --samples 2 --frames 1 --out OUT",
        text(map),
        text(cameras)
    )
}

/// That the picture in `relit` was taken from where the first of the capture's was.
fn assert_seen_as_by(relit: &Path, capture: &Capture) {
    let record = json(&relit.join("relight.json"));
    let mut pose = capture.frames[0].camera.world_from_camera;
    pose.w_axis += capture.centre.extend(0.0);
    for row in 0..4 {
        for column in 0..4 {
            let expected = f64::from(pose.col(column)[row]);
            let found = record["cameras"][0][row][column].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}

#[test]
fn relight_reads_cameras_as_the_run_read_its_capture() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (run_folder, cameras, map) = (at("run"), at("capture"), at("light.exr"));
    let capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    let oblique = "0.1,-0.9,0.3";
    solved.settings.reading.up = Some(oblique.to_owned());
    output::write(&run_folder, &capture, &solved, &ReportOptions::default()).unwrap();
    write(&cameras, &lying(&capture, oblique.parse().unwrap())).unwrap();
    write_exr(&map, &Image::filled(8, 4, 3, 0.5), &["R", "G", "B"]).unwrap();
    let line = relight(&map, &cameras);
    done(&line, &run_folder, &at("as it was read"));
    assert_seen_as_by(&at("as it was read"), &capture);
    // What is typed counts: of cameras in the world in which results are written z is up.
    let upright = at("upright");
    write(&upright, &capture).unwrap();
    let line = relight(&map, &upright) + " --up z";
    done(&line, &run_folder, &at("as it is typed"));
    assert_seen_as_by(&at("as it is typed"), &capture);

    // Whoever trusts a capture says so again.
    #[cfg(unix)]
    {
        fs::rename(cameras.join("transforms.json"), at("elsewhere.json")).unwrap();
        std::os::unix::fs::symlink("../elsewhere.json", cameras.join("transforms.json")).unwrap();
        let line = relight(&map, &cameras);
        let refused = run(&line, &run_folder, &at("refused"));
        assert_eq!(refused.status.code(), Some(3));
        assert!(stderr(&refused).contains("give --allow-outside"));
        done(&(line + " --allow-outside"), &run_folder, &at("trusted"));
        assert_seen_as_by(&at("trusted"), &capture);
    }

    let settings = run_folder.join("settings.json");
    let mut edited = json(&settings);
    edited["reading"]["up"] = "sideways".into();
    fs::write(&settings, edited.to_string()).unwrap();
    let refused = run(&relight(&map, &upright), &run_folder, &at("refused"));
    let message = stderr(&refused);
    assert_eq!(refused.status.code(), Some(3), "{message}");
    for part in [
        "settings.json: `reading.up` is \"sideways\"",
        "expected one of x, y",
        "give --up",
    ] {
        assert!(message.contains(part), "{part}: {message}");
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
    for options in [
        "--up up",
        "--up 3",
        "--up 0,0,0",
        "--max-size 0",
        "--max-size big",
    ] {
        let line = format!("inspect CAPTURE {options}");
        let output = run(&line, small_capture::on_disk(), Path::new("unused"));
        assert_eq!(output.status.code(), Some(2), "{options}");
    }
    let help = eclipse(&["reconstruct", "--help"]);
    assert!(program::stdout(&help).contains("--up <AXIS>"));
}
