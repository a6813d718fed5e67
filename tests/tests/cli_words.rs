//! What the program says to slips: which option, which folder, what to give instead.

use std::{fs, path::Path, process::Output};

use eclipse::{capture::write, output, report::ReportOptions};
use eclipse_tests::{
    perfect,
    program::{self, stderr, stdout, text},
    small_capture::{self, small_capture},
};
use glam::Vec3;

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}

/// The message of a call that ends with `code`, which must hold all `parts`.
#[track_caller]
fn says(arguments: &[&str], code: i32, parts: &[&str]) -> String {
    let output = eclipse(arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
    message
}

#[test]
fn a_folder_without_a_run_is_told_by_the_command_that_was_typed() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("nowhere");
    let nowhere = text(&nowhere);
    let takes = |command: &str| {
        format!("eclipse {command} takes a folder that `eclipse reconstruct` wrote")
    };
    let message = says(
        &["export", nowhere, "--for", "blender"],
        3,
        &[&takes("export"), nowhere],
    );
    assert!(!message.contains("relight"), "{message}");
    says(
        &["relight", nowhere, "--environment", "sky.exr"],
        3,
        &[&takes("relight")],
    );
    let truth = perfect::bundled().join("truth");
    let truth = text(&truth);
    says(
        &["evaluate", nowhere, "--truth", truth],
        3,
        &[&takes("evaluate")],
    );
    // A file of a run in place of its folder.
    let file = folder.path().join("report.html");
    fs::write(&file, "").unwrap();
    let own = format!("give its own: {}", folder.path().display());
    for arguments in [
        &["export", text(&file), "--for", "blender"][..],
        &["relight", text(&file), "--environment", "sky.exr"],
        &["evaluate", text(&file), "--truth", truth],
    ] {
        says(arguments, 3, &["report.html is a file", &own]);
    }
}

#[test]
fn values_below_zero_are_told_their_range() {
    for (line, part) in [
        ("reconstruct c --time-limit -5s", "`-5s` is not a duration"),
        (
            "reconstruct c --seed -1",
            "`-1` is not a whole number from 0",
        ),
        (
            "reconstruct c --iterations -2",
            "`-2` is not a whole number from 1",
        ),
        (
            "reconstruct c --hold-out -8",
            "`-8` is not a whole number from 2",
        ),
        ("reconstruct c --threads -1", "-1 is not in 1..=1024"),
        ("reconstruct c --memory -1GiB", "`-1GiB` is not a size"),
        ("reconstruct c --max-size -3", "-3 is not in 1.."),
        (
            "relight r --environment e --frames -3",
            "-3 is not in 1..=10000",
        ),
        (
            "relight r --environment e --size -1x5",
            "`-1x5` is not a size",
        ),
        (
            "relight r --environment e --distance -1",
            "`-1` is not a number between",
        ),
        ("diagnose c --time-limit -5", "`-5` is not a duration"),
        (
            "synthesize --mesh m --environment e --out o --noise -1",
            "`-1` is not a number between 0 and 1",
        ),
        (
            "synthesize --mesh m --environment e --out o --frames -3",
            "-3 is not in 1..=1000",
        ),
        ("study recovery --time-limit -1m", "`-1m` is not a duration"),
        ("study nulls --seed -1", "`-1` is not a whole number from 0"),
    ] {
        let words: Vec<&str> = line.split_whitespace().collect();
        says(&words, 2, &[part]);
    }
}

#[test]
fn what_is_missing_is_named_with_what_does_in_its_place() {
    says(
        &["relight", "r"],
        2,
        &["--environment <", "--environments <"],
    );
    says(&["evaluate", "r"], 2, &["--truth <", "--stanford-orb <"]);
    for line in [
        "relight r --environment a --environments b",
        "evaluate r --truth a --stanford-orb b",
    ] {
        let words: Vec<&str> = line.split_whitespace().collect();
        says(&words, 2, &["cannot be used with"]);
    }
    says(
        &["relight", "r", "--environment", "e", "--up", "y"],
        2,
        &["--up is of the cameras that --camera names", "z axis"],
    );
}

#[test]
fn a_hold_out_that_holds_nothing_out_is_refused() {
    let capture = small_capture::on_disk();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let common = ["reconstruct", text(capture), "--out", text(&out)];
    says(
        &[&common[..], &["--hold-out", "1000"]].concat(),
        2,
        &["--hold-out 1000", "the capture has only 8", "from 2 to 8"],
    );
    says(
        &[&common[..], &["--with", ""]].concat(),
        2,
        &["--with \"\": ", "expected some of exposure_drift"],
    );
    says(
        &[&common[..], &["--memory", "1"]].concat(),
        3,
        &[
            "photographs and masks alone take",
            "more than the 1 byte allowed",
        ],
    );
    says(
        &[&common[..], &["--memory", "4MiB"]].concat(),
        3,
        &["a run takes about", "more than the 4 MiB allowed"],
    );
    assert!(!out.exists());
}

#[test]
fn a_diagnosis_takes_no_reconstruction_of_another_capture() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, other, out] = ["whole", "other", "out"].map(|name| folder.path().join(name));
    let capture = small_capture::on_disk();
    let short = ["--lambertian", "--iterations", "1", "--out", text(&whole)];
    let run = eclipse(&[&["reconstruct", text(capture)], &short[..]].concat());
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    // As many photographs of the same sizes, two of them in each other's place.
    fs::create_dir(&other).unwrap();
    for entry in fs::read_dir(capture).unwrap() {
        let path = entry.unwrap().path();
        let name = match path.file_name().unwrap().to_str().unwrap() {
            "000.exr" => "001.exr".to_owned(),
            "001.exr" => "000.exr".to_owned(),
            name => name.to_owned(),
        };
        if path.is_file() {
            fs::copy(&path, other.join(name)).unwrap();
        }
    }
    let diagnose = |reconstruction: &Path, parts: &[&str]| {
        let given = [
            "--reconstruction",
            text(reconstruction),
            "--out",
            text(&out),
        ];
        says(
            &[&["diagnose", text(&other)], &given[..]].concat(),
            3,
            parts,
        );
    };
    diagnose(&whole, &[text(&whole), "from another capture"]);
    diagnose(&folder.path().join("nowhere"), &["nowhere is no folder"]);
}

#[test]
fn a_diagnosis_does_not_write_over_occluders_of_somebody_else() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("occluders.exr");
    fs::write(&own, "mine").unwrap();
    let out = text(folder.path());
    let capture = text(small_capture::on_disk());
    says(
        &["diagnose", capture, "--out", out],
        2,
        &[text(&own), "of no diagnosis", "--out"],
    );
    assert_eq!(fs::read_to_string(&own).unwrap(), "mine");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_folder_that_cannot_be_made_is_nothing_to_resume() {
    let capture = small_capture::on_disk();
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let mut places = vec![folder.path().join("file/out")];
    if cfg!(target_os = "linux") {
        places.push("/proc/x".into());
    }
    for out in places {
        let arguments = ["reconstruct", text(capture), "--out", text(&out)];
        let message = says(
            &arguments,
            1,
            &[text(&out), "choose another folder with --out"],
        );
        assert!(!message.contains("resume"), "{message}");
    }
}

#[test]
fn studies_say_what_they_take_and_leave_nothing_where_they_fail() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("st");
    let bundled = perfect::bundled();
    let study = |captures: &Path, parts: &[&str]| {
        let arguments = [
            "study",
            "recovery",
            "--glance",
            "--out",
            text(&out),
            "--captures",
            text(captures),
        ];
        says(&arguments, 3, parts);
        assert!(!out.exists());
    };
    study(
        &bundled,
        &[
            "potatoes: it is a capture itself",
            "takes the folder that it lies in",
            text(bundled.parent().unwrap()),
        ],
    );
    study(
        &folder.path().join("none"),
        &["none", "name their folder with --captures"],
    );
    let labels = folder.path().join("labels.json");
    let message = says(
        &["study", "mismatch", "captures", "--labels", text(&labels)],
        3,
        &[
            "labels.json",
            "by its folder's name",
            r#"{"effects": ["vignetting"]}"#,
        ],
    );
    assert_eq!(message.lines().count(), 1);
}

#[test]
fn one_is_no_plural() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let mut one = small_capture(Vec3::ZERO);
    one.frames.truncate(1);
    write(&path, &one).unwrap();
    let shown = stdout(&eclipse(&["inspect", text(&path)]));
    assert!(shown.contains("only 1 photograph:"), "{shown}");
    assert!(shown.contains("mesh.glb: "), "{shown}");

    let capture = perfect::capture();
    let run = folder.path().join("run");
    let solved = perfect::reconstruction(&capture);
    output::write(&run, &capture, &solved, &ReportOptions::default()).unwrap();
    let sky = run.join("environment.exr");
    let relit = eclipse(&[
        "relight",
        text(&run),
        "--environment",
        text(&sky),
        "--frames",
        "1",
        "--size",
        "8x8",
        "--samples",
        "1",
    ]);
    let shown = stdout(&relit);
    assert!(
        shown.starts_with("wrote 1 picture to "),
        "{shown}{}",
        stderr(&relit)
    );
}
