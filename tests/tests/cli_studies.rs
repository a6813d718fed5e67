//! `eclipse study NAME`: what a study needs and what it has no use for.

use std::{path::Path, process::Output, sync::atomic::AtomicBool};

use eclipse::studies::{self, Bench, Scale, Verdict};
use eclipse_tests::program::{run_study, stderr};

/// Runs a study into a folder, however it ends.
fn run(name: &str, out: &Path, arguments: &[&str]) -> Output {
    run_study(
        env!("CARGO_BIN_EXE_eclipse-under-test"),
        name,
        out,
        arguments,
    )
}

#[test]
fn without_real_photographs_their_study_asks_for_them() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = run("real", &out, &["--glance"]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(
        message.contains("--real DIR") && message.contains("ECLIPSE_REAL"),
        "{message}"
    );
    assert!(!out.exists() && output.stdout.is_empty());
    // Among all studies it is passed over, and says so.
    let stop = AtomicBool::new(false);
    let bench = Bench::new(Scale::Quick, folder.path(), &stop, &|_| ());
    let evidence = studies::run(studies::by_name("real").unwrap(), &bench).unwrap();
    assert_eq!(evidence.verdict, Verdict::NotTested);
    let said = evidence.first_line();
    assert!(said.contains("no real photographs were given"), "{said}");
}

#[test]
fn options_that_a_study_has_no_use_for_are_told_and_not_in_its_help() {
    let folder = tempfile::tempdir().unwrap();
    let given = [
        "--glance",
        "--captures",
        "x",
        "--time-limit",
        "1s",
        "--real",
        "y",
    ];
    let output = run("ambiguity", folder.path(), &given);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{message}");
    for part in [
        "--captures changes nothing here, `ambiguity` having no use for it: it is for limit, recovery",
        "--time-limit changes nothing here",
        "--real changes nothing here, `ambiguity` having no use for it: it is for real",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let help = |name: &str| {
        let output = run(name, folder.path(), &["--help"]);
        String::from_utf8(output.stdout).unwrap()
    };
    for (name, captures, real) in [
        ("ambiguity", false, false),
        ("limit", true, false),
        ("masks", true, false),
        ("real", true, true),
        ("all", true, true),
    ] {
        let help = help(name);
        assert!(help.contains("--threads"), "{help}");
        assert_eq!(help.contains("--captures"), captures, "{help}");
        assert_eq!(help.contains("--real"), real, "{help}");
    }
}
