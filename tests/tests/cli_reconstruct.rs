//! `eclipse reconstruct` as a user meets it: a short run, the same again, interrupted and resumed, bad input.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
    time::Duration,
};

use eclipse::checkpoint;
use eclipse_tests::{
    perfect,
    program::{stderr, text},
    small_capture,
};

fn eclipse(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"));
    command.arg("reconstruct").args(arguments);
    command
}

fn run(arguments: &[&str]) -> Output {
    eclipse(arguments).output().unwrap()
}

/// Whether all images that two runs left are the same, byte for byte.
fn assert_same_results(a: &Path, b: &Path) {
    let mut compared = 0;
    for folder in ["", "occluders", "materials", "renders"] {
        for entry in fs::read_dir(a.join(folder)).unwrap() {
            let name = entry.unwrap().file_name();
            if Path::new(&name)
                .extension()
                .is_some_and(|extension| extension == "exr" || extension == "glb")
            {
                let read = |root: &Path| fs::read(root.join(folder).join(&name)).unwrap();
                assert!(read(a) == read(b), "{folder}/{name:?} differs");
                compared += 1;
            }
        }
    }
    assert!(compared > 24, "only {compared} files");
}

#[test]
fn a_short_run_leaves_everything_and_threads_do_not_matter() {
    let capture = perfect::bundled();
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    // Dividing the surface takes most of the time where photographs are large, and shows nothing that smaller ones do not.
    let short = [
        text(&capture),
        "--lambertian",
        "--max-size",
        "32",
        "--iterations",
        "2",
        "--json",
    ];
    let output = run(&[&short[..], &["--threads", "1", "--out", text(&one)]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["metrics"]["photometric"]["psnr"].is_number(), "{json}");
    // What can be told at best: more with somebody in the light.
    let limit = |name: &str| json["metrics"]["limit"][name].as_f64().unwrap();
    assert!(limit("with_somebody") < limit("with_nobody") && limit("with_nobody") < 1.0);
    let page = fs::read_to_string(one.join("report.html")).unwrap();
    let told = 100.0 * (1.0 - limit("with_nobody").powi(2));
    let told = format!(" {told:.0} % with nobody");
    assert!(page.contains(&told), "{told}");
    for name in [
        "environment.exr",
        "environment.hdr",
        "mesh.glb",
        "metrics.json",
        "settings.json",
        "report.html",
        "checkpoint.bin",
    ] {
        assert!(one.join(name).is_file(), "{name}");
    }

    // The light that the report's viewer takes is the light, as exactly as eight bits have it.
    let [exact, shown] = ["environment.exr", "environment.hdr"]
        .map(|name| eclipse::image_io::read_image(&one.join(name), None).unwrap());
    assert_eq!([exact.width, exact.height], [shown.width, shown.height]);
    for (exact, shown) in exact.data.chunks_exact(3).zip(shown.data.chunks_exact(3)) {
        let brightest = exact.iter().copied().fold(0.0, f32::max);
        let close = |(a, b): (&f32, &f32)| (a - b).abs() <= brightest / 120.0;
        assert!(exact.iter().zip(shown).all(close), "{exact:?} {shown:?}");
    }

    let output = run(&[&short[..], &["--threads", "2", "--out", text(&two)]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_same_results(&one, &two);
    let bytes = |folder: &Path| fs::read(folder.join("environment.hdr")).unwrap();
    assert!(bytes(&one) == bytes(&two));
}

#[test]
fn what_lies_outside_is_read_only_when_it_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let small = small_capture::on_disk();
    let (own, out) = (folder.path().join("own"), folder.path().join("out"));
    fs::create_dir(&own).unwrap();
    fs::copy(small.join("mesh.glb"), own.join("mesh.glb")).unwrap();
    let transforms = fs::read_to_string(small.join("transforms.json")).unwrap();
    let mut transforms: serde_json::Value = serde_json::from_str(&transforms).unwrap();
    for frame in transforms["frames"].as_array_mut().unwrap() {
        let name = frame["file_path"].as_str().unwrap();
        frame["file_path"] = text(&small.join(name)).into();
    }
    fs::write(own.join("transforms.json"), transforms.to_string()).unwrap();
    let arguments = [text(&own), "--lambertian", "--iterations", "1"];
    let arguments = [&arguments[..], &["--json", "--out", text(&out)]].concat();
    let output = run(&arguments);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("--allow-outside"));
    let output = run(&[&arguments[..], &["--allow-outside"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[test]
fn a_resumed_run_ends_like_one_that_never_stopped() {
    let capture = small_capture::on_disk();
    let folder = tempfile::tempdir().unwrap();
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let arguments = [text(capture), "--lambertian", "--json", "--out"];
    let code = |out: &Path, more: &[&str]| {
        let output = run(&[&arguments[..], &[text(out)], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    };
    code(&whole, &["--iterations", "3"]);
    code(&parts, &["--iterations", "1"]);
    code(&parts, &["--iterations", "3", "--resume"]);
    assert_same_results(&whole, &parts);
}

#[test]
fn a_run_resumed_within_a_round_has_the_rounds_own_data_and_lobe() {
    let capture = small_capture::glossy_on_disk();
    let folder = tempfile::tempdir().unwrap();
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let run_to = |out: &Path, steps: u64, more: &[&str]| {
        let steps = steps.to_string();
        let to = [
            text(capture),
            "--json",
            "--iterations",
            &steps,
            "--out",
            text(out),
        ];
        let output = run(&[&to[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    // A round takes six steps at most, and the lobe is fitted at the start of the second: the first part ends within the first
    // round, the second within the second.
    let ended = run_to(&whole, 8, &[]);
    let notes = ended["notes"].to_string();
    assert!(notes.contains("specular reflection: alpha"), "{notes}");
    assert!(!notes.contains("no sign of an occluder"), "{notes}");
    for (steps, round, more) in [
        (4, 0, &[][..]),
        (7, 1, &["--resume"]),
        (8, 1, &["--resume"]),
    ] {
        run_to(&parts, steps, more);
        let kept = checkpoint::load(&parts).unwrap();
        let place = kept.u64s("stage", 3).unwrap();
        assert_eq!(place[..2], [0, round], "after step {steps}");
        // The lobe of the second round is one that shows, so that another would give other images.
        let lobe = kept.f32s("lobe", 2 * round as usize).unwrap();
        assert!(lobe.iter().all(|v| *v > 0.02), "{lobe:?}");
    }
    assert_same_results(&whole, &parts);
}

#[test]
#[cfg(unix)]
fn an_interrupt_saves_everything_and_exits_with_130() {
    let capture = perfect::bundled();
    let folder = tempfile::tempdir().unwrap();
    let mut child = eclipse(&[
        text(&capture),
        "--lambertian",
        "--max-size",
        "32",
        "--time-limit",
        "10m",
        "--out",
        text(folder.path()),
    ])
    .stdout(Stdio::null())
    .stderr(Stdio::null())
    .spawn()
    .unwrap();
    // The first checkpoint shows that the solve has begun.
    let checkpoint = folder.path().join("checkpoint.bin");
    for _ in 0..600 {
        if checkpoint.is_file() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    for name in ["environment.exr", "report.html", "checkpoint.bin"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

#[test]
#[cfg(unix)]
fn an_interrupt_before_the_first_step_is_answered_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let capture = perfect::bundled();
    let arguments = [text(&capture), "--max-size", "64", "--progress", "json"];
    let mut child = eclipse(&[&arguments[..], &["--out", text(&out)]].concat())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = lines.next().unwrap().unwrap();
    assert!(first.contains("\"start\""), "{first}");
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let rest: Vec<String> = lines.map_while(Result::ok).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    let says = |line: &String| line.contains("interrupted before the first step");
    assert!(rest.iter().any(says), "{rest:?}");
    // Not even standard deviations were begun.
    assert!(!rest.iter().any(|line| line.contains("deviations")));
    assert!(!out.exists());
}

#[test]
fn bad_input_exits_with_three_and_one_message() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing");
    let output = run(&[text(&missing), "--out", text(folder.path())]);
    assert_eq!(output.status.code(), Some(3));
    assert!(
        stderr(&output).contains("transforms.json"),
        "{}",
        stderr(&output)
    );
    assert_eq!(stderr(&output).lines().count(), 1);

    let capture = perfect::bundled();
    let output = run(&[text(&capture), "--resume", "--out", text(folder.path())]);
    assert_eq!(output.status.code(), Some(3));
    assert!(
        stderr(&output).contains("no checkpoint in"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_run_that_writes_over_an_earlier_one_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let says = |steps: &str, more: &[&str]| {
        let short = [text(small_capture::on_disk()), "--lambertian"];
        let options = ["--iterations", steps, "--out", text(&out)];
        let output = run(&[&short[..], &options[..], more].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{message}");
        message.contains("holds an earlier run") && message.contains("--resume")
    };
    assert!(!says("1", &[]));
    assert!(says("1", &[]));
    assert!(!says("2", &["--resume"]));
    // Whatever is shown of progress: a result is about to be lost.
    assert!(says("1", &["--progress", "none"]));
    assert!(says("1", &["--json"]));
}

#[test]
fn a_world_that_is_not_z_up_is_told_where_an_operator_is_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let short = [text(small_capture::on_disk()), "--lambertian", "--json"];
    let options = [
        "--iterations",
        "1",
        "--up",
        "x",
        "--out",
        text(folder.path()),
    ];
    for (prior, told) in [("operator", true), ("none", false)] {
        let output = run(&[&short[..], &options[..], &["--occluder-prior", prior]].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{message}");
        let says = message.contains("off the world's z axis") && message.contains("--up z");
        assert_eq!(says, told, "{prior}: {message}");
    }
}

#[test]
fn nothing_that_no_run_has_written_is_written_over() {
    let capture = small_capture::on_disk();
    let refused = |out: &Path, says: &str| {
        let output = run(&[text(capture), "--iterations", "1", "--out", text(out)]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(says), "{}", stderr(&output));
    };
    let mesh = fs::read(capture.join("mesh.glb")).unwrap();
    refused(capture, "the capture itself");
    assert_eq!(fs::read(capture.join("mesh.glb")).unwrap(), mesh);
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("report.html"), "mine").unwrap();
    refused(folder.path(), "report.html");
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), 1, "{left:?}");
}

#[test]
fn what_a_run_cannot_start_from_is_said_before_a_folder_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let (missing, out) = (folder.path().join("missing"), folder.path().join("out"));
    let capture = perfect::bundled();
    let output = run(&[
        text(&capture),
        "--preset",
        "paper",
        "--from",
        text(&missing),
        "--out",
        text(&out),
    ]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(message.contains("cannot start from"), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(!out.exists());
}

#[test]
fn a_place_that_cannot_be_written_is_noticed_before_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let output = run(&[text(&perfect::bundled()), "--out", text(&file.join("out"))]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("choose another folder with --out"),
        "{}",
        stderr(&output)
    );
}
