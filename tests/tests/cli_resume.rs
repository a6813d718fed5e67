//! `eclipse reconstruct --resume`: with the options of the beginning where none are given, and the work divided as it was.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use eclipse::{
    capture::{Capture, LoadOptions},
    checkpoint::{self, Array},
    reconstruct,
    settings::Settings,
};
use eclipse_tests::{
    program::{stderr, text},
    small_capture::on_disk as capture,
};

/// Runs `options`, a line of words, into `out`.
fn run(out: &Path, options: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eclipse-under-test"));
    command.args(["reconstruct", text(capture()), "--json"]);
    command.args(["--out", text(out)]);
    command.args(options.split_whitespace()).output().unwrap()
}

fn done(out: &Path, options: &str) {
    let output = run(out, options);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{options}: {message}");
}

fn refused(out: &Path, options: &str) -> String {
    let output = run(out, options);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{options}: {message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

/// Begins in `out` where `begun` stands.
fn copied(begun: &Path, out: &Path) {
    fs::create_dir_all(out).unwrap();
    let name = "checkpoint.bin";
    fs::copy(begun.join(name), out.join(name)).unwrap();
}

/// Whether all images that two runs left are the same, byte for byte.
fn assert_same_results(a: &Path, b: &Path) {
    let mut compared = 0;
    for folder in ["", "occluders", "materials", "renders"] {
        for entry in fs::read_dir(a.join(folder)).unwrap() {
            let name = entry.unwrap().file_name();
            let timeless = Path::new(&name)
                .extension()
                .is_some_and(|extension| extension == "exr" || extension == "glb");
            if timeless {
                let read = |root: &Path| fs::read(root.join(folder).join(&name)).unwrap();
                assert!(read(a) == read(b), "{folder}/{name:?} differs");
                compared += 1;
            }
        }
    }
    assert!(compared > 24, "only {compared} files");
}

#[test]
fn options_that_are_not_given_are_those_of_the_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let options = "--lambertian --hold-out 4 --seed 5";
    done(&at("whole"), &format!("{options} --iterations 3"));
    done(&at("begun"), &format!("{options} --iterations 1"));
    for (name, more) in [("none", ""), ("all", options), ("one", "--hold-out 4")] {
        copied(&at("begun"), &at(name));
        done(&at(name), &format!("--resume --iterations 3 {more}"));
        assert_same_results(&at("whole"), &at(name));
        let settings = fs::read_to_string(at(name).join("settings.json")).unwrap();
        let settings: Settings = serde_json::from_str(&settings).unwrap();
        assert_eq!((settings.hold_out, settings.seed), (Some(4), 5), "{name}");
        assert!(settings.lambertian, "{name}");
    }
    // What repeats the run has them all.
    let page = fs::read_to_string(at("none").join("report.html")).unwrap();
    let (_, command) = page.split_once("<pre>").unwrap();
    let (command, _) = command.split_once("</pre>").unwrap();
    for option in options.split(" --") {
        assert!(command.contains(option), "{option}: {command}");
    }
    assert!(!command.contains("--resume"), "{command}");
}

#[test]
fn what_is_given_and_shapes_the_result_must_be_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    done(out, "--hold-out 4 --lambertian --iterations 1");
    for (options, expected) in [
        ("--hold-out 2", "`hold_out` = 4, now it is 2"),
        ("--seed 1", "`seed` = 0, now it is 1"),
        ("--preset paper", "`preset` = \"fast\", now it is \"paper\""),
        ("--no-occluders", "`occluders` = true, now it is false"),
        (
            "--color srgb",
            "`color` = what the capture says, now it is srgb",
        ),
    ] {
        let message = refused(out, &format!("--resume --iterations 2 {options}"));
        assert!(message.contains(expected), "{options}: {message}");
    }
    // The defaults, too, once they are typed.
    done(out, "--resume --iterations 2 --seed 0 --preset fast");
}

#[test]
fn what_looks_like_a_result_and_is_none_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let says = |options: &str, expected: &str| {
        let output = run(&out, &format!("--lambertian {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let notes = said["notes"].to_string();
        notes.contains(expected)
    };
    // However short the time: what is written is a result, and can be gone on from.
    assert!(!says("--time-limit 0.01s", "no step was taken"));
    assert_eq!(checkpoint::load(&out).unwrap().iteration, 1);
    fs::remove_dir_all(&out).unwrap();
    let further = "no further step was taken: the run had its 2 iterations before";
    assert!(!says("--iterations 2", further));
    assert!(says("--resume --iterations 2", further));
    assert!(!says("--resume --iterations 3", further));

    let latest = out.join("checkpoint.bin");
    let bytes = fs::read(&latest).unwrap();
    fs::write(&latest, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(checkpoint::load(&out).unwrap().iteration, 2);
    let output = run(&out, "--resume --iterations 3");
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{message}");
    let told = "the latest checkpoint cannot be gone on from, the one before it is";
    assert!(
        message.contains(told) && message.contains("damaged"),
        "{message}"
    );
    assert_eq!(checkpoint::load(&out).unwrap().iteration, 3);
}

#[test]
fn how_colours_were_read_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let options = "--lambertian --color srgb";
    done(&at("whole"), &format!("{options} --iterations 2"));
    done(&at("parts"), &format!("{options} --iterations 1"));
    done(&at("parts"), "--resume --iterations 2");
    assert_same_results(&at("whole"), &at("parts"));
    let message = refused(&at("parts"), "--resume --iterations 3 --color linear");
    assert!(
        message.contains("`color` = srgb, now it is linear"),
        "{message}"
    );
}

#[test]
fn the_work_stays_divided_as_it_was_whatever_memory_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let loaded = Capture::load(capture(), &LoadOptions::default()).unwrap();
    let planned = |memory: u64| {
        let settings = Settings {
            memory,
            ..Settings::default()
        };
        reconstruct::memory(&loaded, &settings)
    };
    let (coarsest, finest) = (planned(1), planned(4 << 30));
    // Little more than the least: fewer patches than even the coarse stage would take.
    let little = coarsest + (finest - coarsest) / 5;
    let taken = planned(little);
    assert!(
        coarsest < taken && taken < finest,
        "{coarsest} {taken} {finest}"
    );

    let options = format!("--lambertian --memory {little}");
    done(&at("whole"), &format!("{options} --iterations 3"));
    done(&at("begun"), &format!("{options} --iterations 1"));
    let plan = |name: &str| match &checkpoint::load(&at(name)).unwrap().arrays["plan"] {
        Array::U64(numbers) => numbers.clone(),
        other => panic!("a plan of {other:?}"),
    };
    assert!(plan("whole")[1] < 800, "{:?}", plan("whole"));

    // With all memory, and from a checkpoint as it was before plans were kept.
    copied(&at("begun"), &at("more"));
    copied(&at("begun"), &at("older"));
    let mut older = checkpoint::load(&at("older")).unwrap();
    older.arrays.remove("plan").unwrap();
    checkpoint::save(&at("older"), &older).unwrap();
    for name in ["more", "older"] {
        done(&at(name), "--resume --iterations 2 --memory 4GiB");
        done(&at(name), "--resume --iterations 3");
        assert_eq!(plan(name), plan("whole"), "{name}");
        assert_same_results(&at("whole"), &at(name));
    }

    // With less than it takes it cannot go on, and is told what suffices.
    let options = format!("--resume --iterations 3 --memory {coarsest}");
    let message = refused(&at("begun"), &options);
    let enough = format!("--memory {}MiB", taken.div_ceil(1 << 20));
    assert!(message.contains(&enough), "{enough}: {message}");
    done(&at("begun"), &format!("--resume --iterations 3 {enough}"));
    assert_same_results(&at("whole"), &at("begun"));
}
