//! The program as a user meets it: output, messages, exit codes.

use std::{
    fs,
    process::{Command, Output},
};

use eclipse::{
    capture::{Capture, LoadOptions},
    output,
    report::ReportOptions,
};
use eclipse_tests::{
    perfect,
    program::{self, stderr, stdout, text},
    skipped,
};

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}

#[test]
fn help_has_examples_and_the_exit_codes_and_succeeds() {
    let help = eclipse(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    assert!(
        stdout(&help)
            .contains("Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 130 interrupted")
    );
    for command in ["evaluate", "synthesize"] {
        let help = eclipse(&[command, "--help"]);
        assert_eq!(help.status.code(), Some(0));
        assert!(stdout(&help).contains("Example"), "{command}");
    }
    assert!(stdout(&eclipse(&["--version"])).starts_with("eclipse "));
}

#[test]
fn wrong_usage_exits_with_two_and_prints_no_results() {
    for arguments in [
        &["nonsense"][..],
        &[],
        &["evaluate"],
        &["evaluate", "somewhere"],
    ] {
        let output = eclipse(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(
            stdout(&output).is_empty() && stderr(&output).contains("Usage"),
            "{arguments:?}"
        );
    }
}

#[test]
fn evaluate_prints_a_table_or_json() {
    let capture = perfect::capture();
    let folder = tempfile::tempdir().unwrap();
    let options = ReportOptions::default();
    output::write(
        folder.path(),
        &capture,
        &perfect::reconstruction(&capture),
        &options,
    )
    .unwrap();
    let truth = perfect::bundled().join("truth");
    let arguments = ["evaluate", text(folder.path()), "--truth", text(&truth)];

    let table = eclipse(&arguments);
    assert_eq!(table.status.code(), Some(0), "{}", stderr(&table));
    assert!(stdout(&table).contains("relative RMSE, aligned"));
    assert!(stdout(&table).contains("41.250"));

    let json = eclipse(&[&arguments[..], &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_str(&stdout(&json)).unwrap();
    assert_eq!(json["occluders"]["iou"], 1.0);
    assert_eq!(json["photometric"]["psnr"], 41.25);
}

#[test]
fn bad_input_exits_with_three_and_one_message() {
    let empty = tempfile::tempdir().unwrap();
    let truth = perfect::bundled().join("truth");
    let output = eclipse(&["evaluate", text(empty.path()), "--truth", text(&truth)]);
    assert_eq!(output.status.code(), Some(3));
    let message = stderr(&output);
    assert!(
        message.starts_with("error: ") && message.contains("environment.exr"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1);
}

#[test]
fn synthesize_makes_a_capture_that_loads_with_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, map, made) = (
        folder.path().join("m.obj"),
        folder.path().join("e.png"),
        folder.path().join("made"),
    );
    fs::write(
        &mesh,
        "v 9 0 0\nv 10 0 0\nv 9 1 0\nv 9 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    )
    .unwrap();
    eclipse::image_io::write_png8(&map, &render::image::Image::filled(8, 4, 3, 0.5)).unwrap();
    let arguments = [
        "synthesize",
        "--mesh",
        text(&mesh),
        "--environment",
        text(&map),
        "--operator",
        "--bsdf",
        "lambert",
        "--frames",
        "3",
        "--resolution",
        "12",
        "--variation",
        "0",
        "--noise",
        "0",
        "--out",
        text(&made),
    ];
    let output = eclipse(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("wrote"));

    // Twelve pixels are too few to compare silhouettes closely.
    let options = LoadOptions {
        min_overlap: 0.5,
        ..Default::default()
    };
    let capture = Capture::load(&made, &options).unwrap();
    assert_eq!(capture.frames.len(), 3);
    assert!((capture.centre - glam::Vec3::new(9.5, 0.5, 0.5)).length() < 1e-5);
    let albedo = eclipse::image_io::read_exr(&made.join("truth/albedo_002.exr")).unwrap();
    let seen: Vec<&[f32]> = albedo
        .data
        .chunks_exact(3)
        .filter(|pixel| pixel[0] > 0.0)
        .collect();
    assert!(seen.len() > 10);
    for pixel in seen {
        assert!(
            (pixel[0] - 0.5).abs() < 1e-3 && (pixel[2] - 0.4).abs() < 1e-3,
            "{pixel:?}"
        );
    }
    let masks = eclipse::image_io::read_exr(&made.join("truth/occluders.exr")).unwrap();
    assert_eq!((masks.width, masks.height), (100, 150));
    // A grey albedo below one under light of 0.214 (linear of ½) cannot shine brighter than that.
    let brightest = capture
        .frames
        .iter()
        .flat_map(|frame| &frame.image.data)
        .fold(0.0f32, |a, &b| a.max(b));
    assert!(
        brightest > 0.02 && brightest < 0.214 * 0.5 + 1e-3,
        "{brightest}"
    );

    let again = eclipse(&arguments);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("not empty"), "{}", stderr(&again));
}

/// The names of the program's commands, as its help lists them.
fn commands() -> Vec<String> {
    let help = stdout(&eclipse(&["--help"]));
    let (_, list) = help.split_once("Commands:\n").unwrap();
    let names = list.lines().take_while(|line| line.starts_with("  "));
    // Descriptions may go on on lines that are indented further.
    let names = names.filter(|line| !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next());
    names
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

#[test]
fn completions_of_every_shell_know_every_command_and_its_options() {
    let commands = commands();
    assert!(commands.len() >= 7, "{commands:?}");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = eclipse(&["completions", shell]);
        assert_eq!(output.status.code(), Some(0), "{shell}");
        let script = stdout(&output);
        for word in commands
            .iter()
            .map(String::as_str)
            .chain(["time-limit", "truth"])
        {
            assert!(script.contains(word), "{shell} lacks {word}");
        }
    }
    assert_eq!(eclipse(&["completions", "dos"]).status.code(), Some(2));
}

#[test]
fn bash_takes_its_completions_and_completes_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("eclipse.bash");
    fs::write(&path, eclipse(&["completions", "bash"]).stdout).unwrap();
    let script = r#"
        source "$1" || exit 9
        COMP_WORDS=(eclipse inspect --js); COMP_CWORD=2
        _eclipse eclipse --js inspect
        echo "${COMPREPLY[@]}"
    "#;
    let bash = Command::new("bash")
        .args(["-c", script, "bash", text(&path)])
        .output();
    let Ok(completed) = bash else {
        skipped("no bash");
        return;
    };
    assert_eq!(completed.status.code(), Some(0), "{}", stderr(&completed));
    assert_eq!(stdout(&completed).trim(), "--json");
}

#[test]
fn the_manual_page_has_every_command_its_options_and_the_exit_codes() {
    let output = eclipse(&["man"]);
    assert_eq!(output.status.code(), Some(0));
    let page = stdout(&output);
    assert!(page.contains(".TH eclipse 1"), "{}", &page[..300]);
    for command in commands() {
        let heading = format!(".SH \"ECLIPSE {}\"", command.to_uppercase());
        assert!(page.contains(&heading), "{heading}");
    }
    // Hyphens are escaped in manual pages.
    for option in [r"\-\-time\-limit", r"\-\-truth"] {
        assert!(page.contains(option), "{option}");
    }
    assert!(page.contains("130 interrupted; what was found until then is saved"));
    assert!(page.contains(".SS \"EXAMPLES\"") && page.contains(".SH \"EXIT STATUS\""));
    assert!(!page.contains("EXTRA"));
}
