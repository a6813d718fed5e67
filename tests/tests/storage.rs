//! Where results are written: full, read-only or taken, a run ends with one message and leaves nothing half made.
#![cfg(unix)]

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use eclipse_tests::{
    perfect,
    program::{stderr, text},
    small_capture,
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

/// The bytes of a block, as the shell counts.
fn block() -> u64 {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let script = "trap '' XFSZ; ulimit -f 1; head -c 4096 /dev/zero > \"$0\"";
    let mut shell = Command::new("sh");
    shell.args(["-c", script]).arg(&path).output().unwrap();
    let length = fs::metadata(&path).unwrap().len();
    assert!([512, 1024].contains(&length), "{length}");
    length
}

/// All that a run finds, by its path below `folder`: what tells the time is left out.
fn results(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(inner).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "exr" || e == "glb") {
                let name = path.strip_prefix(folder).unwrap().to_owned();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
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
        text(small_capture::on_disk()).to_owned(),
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
fn a_full_disk_ends_every_command_with_one_message_and_no_half_files() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, out, mesh] = ["whole", "out", "m.obj"].map(|name| folder.path().join(name));
    let capture = text(small_capture::on_disk());
    let short = ["--lambertian", "--iterations", "1", "--out", text(&whole)];
    let run = Command::new(PROGRAM)
        .args(["reconstruct", capture])
        .args(short)
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    let map = whole.join("environment.exr");
    fs::write(&mesh, "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let before = results(&whole);
    let commands: [&[&str]; 5] = [
        &["inspect", capture],
        &["relight", text(&whole), "--environment", text(&map)],
        &["export", text(&whole), "--for", "blender"],
        &["study", "theory", "--glance"],
        &[
            "synthesize",
            "--mesh",
            text(&mesh),
            "--environment",
            text(&map),
        ],
    ];
    for arguments in commands {
        let output = on_a_full_disk(4, &[arguments, &["--out", text(&out)]].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        let errors = message.lines().filter(|line| line.starts_with("error: "));
        assert_eq!(errors.count(), 1, "{arguments:?}: {message}");
        let left = files(&out);
        let half = left.iter().any(|name| name.starts_with(".writing-"));
        assert!(!half, "{arguments:?}: {left:?}");
        // A page comes last: where it is there, all that it shows is.
        let page = left.iter().any(|name| name.ends_with(".html"));
        assert!(!page, "{arguments:?}: {left:?}");
        fs::remove_dir_all(&out).ok();
    }
    assert!(results(&whole) == before, "what they read was touched");
}

#[test]
fn a_run_that_met_a_full_disk_ends_like_one_that_never_did() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, out) = (folder.path().join("whole"), folder.path().join("out"));
    let arguments = |steps, out| {
        let capture = text(small_capture::on_disk());
        let mut arguments = vec!["reconstruct", capture, "--lambertian", "--json"];
        arguments.extend(["--threads", "2", "--iterations", steps, "--out", out]);
        arguments
    };
    let run = |arguments: &[&str]| {
        let output = Command::new(PROGRAM).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    };
    run(&arguments("5", text(&whole)));
    run(&arguments("3", text(&out)));
    let checkpoint = || fs::read(out.join("checkpoint.bin")).unwrap();
    let (earlier, found) = (checkpoint(), results(&out));
    assert!(found.len() > 3 * 8, "only {} files", found.len());

    // Room for everything but the next checkpoint, which is no smaller than this one.
    let resumed = [&arguments("5", text(&out))[..], &["--resume"]].concat();
    let room = (earlier.len() as u64 - 1) / block();
    let output = on_a_full_disk(room as usize, &resumed);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot write the checkpoint"), "{message}");
    assert!(
        checkpoint() == earlier,
        "the earlier checkpoint was touched"
    );
    assert!(results(&out) == found, "earlier results were touched");
    let left = files(&out);
    assert!(
        left.iter().all(|name| !name.starts_with(".writing-")),
        "{left:?}"
    );

    run(&resumed);
    let (ended, undisturbed) = (results(&out), results(&whole));
    assert!(ended.keys().eq(undisturbed.keys()));
    for (name, bytes) in &undisturbed {
        assert!(ended[name] == *bytes, "{} differs", name.display());
    }
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
