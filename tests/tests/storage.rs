//! Where results are written: full, read-only or taken, a run ends with one message and leaves nothing half made.
#![cfg(unix)]

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use eclipse_tests::{
    perfect,
    program::{stderr, text},
};

const PROGRAM: &str = env!("CARGO_BIN_EXE_eclipse-under-test");

/// Runs the program where no file may grow beyond `blocks` of half a kibibyte or a kibibyte, as the shell counts.
///
/// The signal that comes with it is ignored, so that writes fail as they do on a full disk.
fn on_a_full_disk(blocks: usize, arguments: &[&str]) -> Output {
    Command::new("sh")
        .arg("-c")
        .arg(format!(
            "trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\""
        ))
        .arg(PROGRAM)
        .args(arguments)
        .output()
        .unwrap()
}

fn files(folder: &Path) -> Vec<String> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.path().is_dir() {
            all.extend(files(&entry.path()));
        } else {
            all.push(entry.file_name().into_string().unwrap());
        }
    }
    all
}

#[test]
fn a_full_disk_ends_with_one_message_and_no_half_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let short = [
        text(&perfect::bundled()).to_owned(),
        "--lambertian".to_owned(),
        "--iterations".to_owned(),
        "1".to_owned(),
        "--out".to_owned(),
        text(&out).to_owned(),
    ];
    let arguments: Vec<&str> = ["reconstruct"]
        .into_iter()
        .chain(short.iter().map(String::as_str))
        .collect();
    // Room for small files, not for a map of the environment.
    let output = on_a_full_disk(8, &arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    let errors = message.lines().filter(|line| line.starts_with("error: "));
    assert_eq!(errors.count(), 1, "{message}");
    assert!(
        message.contains("cannot write") || message.contains("cannot save"),
        "{message}"
    );
    let left = files(&out);
    assert!(
        left.iter().all(|name| !name.starts_with(".writing-")),
        "{left:?}"
    );
    assert!(!left.contains(&"report.html".to_owned()), "{left:?}");
}

#[test]
fn a_full_disk_leaves_an_earlier_result_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("result");
    fs::write(&path, "earlier").unwrap();
    let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
    let written = eclipse::files::atomic::write(&path, |file| {
        use std::io::Write;
        file.write_all(b"half of")?;
        Err(full)
    });
    assert_eq!(written.unwrap_err().kind(), std::io::ErrorKind::StorageFull);
    assert_eq!(fs::read_to_string(&path).unwrap(), "earlier");
    assert_eq!(files(folder.path()), ["result"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_read_only_folder_is_noticed_before_the_run() {
    // Nobody may make folders there, not even root, whom permissions do not stop.
    let output = Command::new(PROGRAM)
        .args(["reconstruct", text(&perfect::bundled()), "--out"])
        .arg("/sys/kernel/eclipse-out")
        .output()
        .unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(
        message.contains("choose another folder with --out"),
        "{message}"
    );
}
