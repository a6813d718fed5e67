//! Where results may go: never over files that no run has written.

use std::path::Path;

use crate::{
    checkpoint,
    cli::{Failure, Outcome},
    layout,
};

/// Files and folders that a run writes, or replaces.
const WRITTEN: [&str; 13] = [
    layout::ENVIRONMENT,
    layout::ENVIRONMENT_SD,
    layout::RADIANCE,
    layout::OCCLUDERS,
    layout::OCCLUDERS_SD,
    layout::ALBEDO_SD,
    layout::MATERIALS,
    layout::NETWORK,
    layout::RENDERS,
    layout::METRICS,
    layout::SETTINGS,
    layout::REPORT,
    layout::MESH,
];

/// Refuses a folder for results that is the capture's own, or that holds files which a run would replace and none has written.
///
/// # Errors
/// [`Outcome::Usage`], with the file and what to do.
pub(super) fn check(folder: &Path, capture: &Path) -> Result<(), Failure> {
    let refused = |message: String| Failure {
        outcome: Outcome::Usage,
        message: message + "; name another folder with --out",
    };
    if is_same(folder, capture) {
        return Err(refused(format!(
            "--out {} is the capture itself, whose files the results would replace",
            folder.display()
        )));
    }
    // What a run leaves: all of it at the end, a checkpoint before.
    let is_of_a_run = checkpoint::is_in(folder)
        || (folder.join(layout::SETTINGS).is_file() && folder.join(layout::METRICS).is_file());
    let foreign = WRITTEN
        .iter()
        .map(|name| folder.join(name))
        .find(|path| path.exists());
    match foreign {
        Some(path) if !is_of_a_run => Err(refused(format!(
            "{} is there already and not of a run: the results would replace it",
            path.display()
        ))),
        _ => Ok(()),
    }
}

/// Whether both name one folder that is there.
fn is_same(one: &Path, other: &Path) -> bool {
    match (one.canonicalize(), other.canonicalize()) {
        (Ok(one), Ok(other)) => one == other,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn only_what_a_run_has_written_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let [capture, out] = ["capture", "out"].map(|name| folder.path().join(name));
        fs::create_dir(&capture).unwrap();
        check(&out, &capture).unwrap();
        fs::create_dir(&out).unwrap();
        check(&out, &capture).unwrap();
        // Somebody's own, beside which results do no harm.
        fs::write(out.join("notes.txt"), "mine").unwrap();
        check(&out, &capture).unwrap();
        fs::write(out.join(layout::MESH), "mine").unwrap();
        let error = check(&out, &capture).unwrap_err();
        assert_eq!(error.outcome, Outcome::Usage);
        assert!(
            error.message.contains(layout::MESH) && error.message.contains("--out"),
            "{}",
            error.message
        );
        for name in [layout::SETTINGS, layout::METRICS] {
            fs::write(out.join(name), "{}").unwrap();
        }
        check(&out, &capture).unwrap();
        let error = check(&capture.join("../capture"), &capture).unwrap_err();
        assert!(
            error.message.contains("the capture itself"),
            "{}",
            error.message
        );
    }
}
