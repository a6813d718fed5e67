//! Whatever ends a run, what it had done is there, and the end is the same bit for bit.
#![cfg(unix)]

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::OnceLock,
    time::{Duration, Instant, SystemTime},
};

use eclipse::files::lock::Lock;
use eclipse_tests::{
    program::{stderr, text},
    small_capture::on_disk as capture,
};

const PROGRAM: &str = env!("CARGO_BIN_EXE_eclipse-under-test");

/// Steps of a whole run.
const STEPS: &str = "5";

/// A short run into `out`, which goes on from a checkpoint where there is one.
fn reconstruct(out: &Path) -> Command {
    run_of(STEPS, out)
}

fn run_of(steps: &str, out: &Path) -> Command {
    run_with(&["--lambertian", "--iterations", steps], out)
}

/// The same with other options.
fn run_with(options: &[&str], out: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.args(["reconstruct", text(capture()), "--json"]);
    command.args(options);
    command.args(["--threads", "2", "--out", text(out)]);
    let begun = ["checkpoint.bin", "checkpoint.prev.bin"]
        .iter()
        .any(|name| out.join(name).is_file());
    if begun {
        command.arg("--resume");
    }
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn finish(out: &Path) {
    let output = reconstruct(out).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

/// The run that nothing disturbed, made once, and how long it took.
fn undisturbed() -> &'static (tempfile::TempDir, Duration) {
    static RUN: OnceLock<(tempfile::TempDir, Duration)> = OnceLock::new();
    RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        capture();
        let began = Instant::now();
        finish(folder.path());
        (folder, began.elapsed())
    })
}

/// All files below `folder` by their path.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            let inner = files(&path);
            let name = PathBuf::from(path.file_name().unwrap());
            found.extend(inner.into_iter().map(|path| name.join(path)));
        } else {
            found.push(path.file_name().unwrap().into());
        }
    }
    found.sort();
    found
}

/// Every file is there, none is half-written, and all that does not tell the time is the same.
fn assert_like_undisturbed(out: &Path) {
    assert_same(undisturbed().0.path(), out);
}

fn assert_same(whole: &Path, out: &Path) {
    assert_eq!(files(out).len(), files(whole).len(), "{:?}", files(out));
    let mut compared = 0;
    for path in files(whole) {
        let timeless = path
            .extension()
            .is_some_and(|extension| extension == "exr" || extension == "glb");
        if timeless {
            let same = fs::read(whole.join(&path)).unwrap() == fs::read(out.join(&path)).unwrap();
            assert!(same, "{} differs", path.display());
            compared += 1;
        }
    }
    assert!(compared > 3 * 8, "only {compared} files");
}

/// Ends a process as the system does when memory runs out: no handler hears of it.
fn kill(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_killed_at_any_moments_ends_like_one_that_never_was() {
    let mut took = undisturbed().1;
    // Places between the start and the end, the same in every run of this test.
    let mut place = 0.37f64;
    for round in 0..3 {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let mut killed = 0;
        for _ in 0..12 {
            if killed == 3 {
                break;
            }
            place = (place + 0.618_034).fract();
            let mut child = reconstruct(&out).spawn().unwrap();
            std::thread::sleep(took.mul_f64(place));
            if child.try_wait().unwrap().is_none() {
                kill(child);
                killed += 1;
            } else {
                // The machine has less to do than when the first was timed: others end as early.
                took = took.mul_f64(0.7);
            }
        }
        assert!(killed > 0, "no run was killed in round {round}");
        finish(&out);
        assert_like_undisturbed(&out);
    }
}

#[test]
fn whatever_is_fitted_a_killed_run_ends_like_one_that_never_was() {
    let kinds: [&[&str]; 3] = [
        &["--iterations", "2"],
        &[
            "--iterations",
            "2",
            "--hold-out",
            "4",
            "--occluder-prior",
            "none",
        ],
        &["--preset", "paper", "--iterations", "6"],
    ];
    for (round, options) in kinds.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let [whole, out] = ["whole", "out"].map(|name| folder.path().join(name));
        let end = |out: &Path| {
            let output = run_with(options, out).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        };
        let began = Instant::now();
        end(&whole);
        let took = began.elapsed();
        let mut killed = 0;
        for share in [0.8, 0.5, 0.3, 0.1] {
            let mut child = run_with(options, &out).spawn().unwrap();
            std::thread::sleep(took.mul_f64(share - 0.05 * round as f64));
            if child.try_wait().unwrap().is_none() {
                kill(child);
                killed += 1;
            }
        }
        assert!(killed > 0, "no run with {options:?} was killed");
        end(&out);
        assert_same(&whole, &out);
    }
}

/// A run with fewer steps, which leaves the state after the third and the second.
fn run_three_steps(out: &Path) {
    let short = run_of("3", out).output().unwrap();
    assert_eq!(short.status.code(), Some(0), "{}", stderr(&short));
}

#[test]
fn a_damaged_checkpoint_falls_back_to_the_one_before_it() {
    undisturbed();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    run_three_steps(out);
    let latest = out.join("checkpoint.bin");
    let bytes = fs::read(&latest).unwrap();
    fs::write(&latest, &bytes[..bytes.len() * 2 / 3]).unwrap();
    finish(out);
    assert_like_undisturbed(out);

    // When both are damaged, a run says so and touches nothing.
    for name in ["checkpoint.bin", "checkpoint.prev.bin"] {
        let bytes = fs::read(out.join(name)).unwrap();
        fs::write(out.join(name), &bytes[..bytes.len() / 2]).unwrap();
    }
    let before = fs::read(out.join("environment.exr")).unwrap();
    let output = reconstruct(out).output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{message}");
    assert!(
        message.contains("start again without --resume"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1, "{message}");
    assert_eq!(fs::read(out.join("environment.exr")).unwrap(), before);
}

#[test]
fn a_clock_that_was_set_in_between_changes_nothing() {
    undisturbed();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    run_three_steps(out);
    // The latest state as old as a file can be, and the one before it, with all results, from the next century.
    let century = Duration::from_secs(100 * 365 * 24 * 3600);
    for name in files(out) {
        let time = match name == Path::new("checkpoint.bin") {
            true => SystemTime::UNIX_EPOCH,
            false => SystemTime::now() + century,
        };
        let file = File::options().write(true).open(out.join(name)).unwrap();
        file.set_modified(time).unwrap();
    }
    finish(out);
    assert_like_undisturbed(out);
}

#[test]
fn two_runs_do_not_write_to_one_folder() {
    undisturbed();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    // The first run, as soon as it has the folder, and while it is at work.
    let first = Command::new(PROGRAM)
        .args(["reconstruct", text(capture()), "--lambertian", "--json"])
        .args(["--time-limit", "10m", "--out", text(&out)])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let owned = || fs::read_to_string(out.join(".lock")).is_ok_and(|owner| !owner.is_empty());
    while !owned() && began.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    let second = reconstruct(&out).output().unwrap();
    let expected = format!("is being written by another run (process {})", first.id());
    kill(first);
    let message = stderr(&second);
    assert_eq!(second.status.code(), Some(1), "{message}");
    assert!(message.contains(&expected), "{message}");
    assert!(
        message.contains("choose another folder with --out"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1, "{message}");
    // A killed run holds nothing.
    drop(Lock::acquire(&out).unwrap());
}

#[test]
fn every_command_that_writes_waits_for_nobody_and_says_who_has_the_folder() {
    let whole = undisturbed().0.path();
    let folder = tempfile::tempdir().unwrap();
    let (labels, mesh) = (
        folder.path().join("labels.json"),
        folder.path().join("m.obj"),
    );
    fs::write(&labels, "{}").unwrap();
    fs::write(&mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let out = folder.path().join("out");
    let map = whole.join("environment.exr");
    let commands: [&[&str]; 7] = [
        &["inspect", text(capture())],
        &["diagnose", text(capture())],
        &["relight", text(whole), "--environment", text(&map)],
        &["export", text(whole), "--for", "blender"],
        &["study", "theory"],
        &[
            "study",
            "mismatch",
            text(folder.path()),
            "--labels",
            text(&labels),
        ],
        &[
            "synthesize",
            "--mesh",
            text(&mesh),
            "--environment",
            text(&map),
        ],
    ];
    for arguments in commands {
        // Studies have a folder each; a capture is not there until it is whole.
        let lock = match arguments {
            ["synthesize", ..] => Lock::beside(&out),
            ["study", "theory"] => {
                fs::create_dir_all(out.join("theory")).unwrap();
                Lock::acquire(&out.join("theory"))
            }
            _ => {
                fs::create_dir_all(&out).unwrap();
                Lock::acquire(&out)
            }
        }
        .unwrap();
        let run = || {
            let mut command = Command::new(PROGRAM);
            command.args(arguments).args(["--out", text(&out)]);
            command.output().unwrap()
        };
        let output = run();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        let expected = format!("another run (process {})", std::process::id());
        assert!(message.contains(&expected), "{arguments:?}: {message}");
        assert!(message.contains("--out"), "{arguments:?}: {message}");
        drop(lock);
        fs::remove_dir_all(&out).ok();
        // Free again: whatever else these commands say, it is not that.
        if matches!(arguments, ["export", ..]) {
            let output = run();
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
            fs::remove_dir_all(&out).unwrap();
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_named_by_every_command_that_writes() {
    // Nobody may make folders there, not even root, whom permissions do not stop.
    let nowhere = "/sys/kernel/eclipse-out";
    let whole = undisturbed().0.path();
    let environment = whole.join("environment.exr");
    let commands: [&[&str]; 4] = [
        &["reconstruct", text(capture()), "--out", nowhere],
        &["inspect", text(capture()), "--out", nowhere],
        &[
            "relight",
            text(whole),
            "--environment",
            text(&environment),
            "--out",
            nowhere,
        ],
        &["export", text(whole), "--for", "blender", "--out", nowhere],
    ];
    for arguments in commands {
        let output: Output = Command::new(PROGRAM).args(arguments).output().unwrap();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(nowhere), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    }
}
