//! What a reconstruction can do about what was found.

use super::Job;
use crate::{
    capture::UpAxis,
    cli::{arguments::ColorName, units},
    criticism::{Diagnosis, effects},
    joint,
};

/// The command that reconstructs with what was found: effects of the camera fitted jointly, occluders if somebody moves in the
/// light; `None` where a reconstruction can do nothing about it.
pub(super) fn reconstruction_with(job: &Job<'_>, d: &Diagnosis) -> Option<String> {
    let with = of_the_camera(d);
    let somebody = somebody_found(d);
    if with.is_empty() && !somebody {
        return None;
    }
    let mut command = format!(
        "eclipse reconstruct {}",
        units::shell_word(&job.capture.to_string_lossy())
    );
    if let Some(mesh) = &job.reading.mesh {
        command += &format!(" --mesh {}", units::shell_word(&mesh.to_string_lossy()));
    }
    if job.reading.allow_outside {
        command += " --allow-outside";
    }
    if let Some(encoding) = job.reading.color_encoding {
        command += &format!(" --color {}", ColorName::of(encoding).name());
    }
    if job.reading.up != UpAxis::default() {
        command += &format!(" --up {}", job.reading.up.name());
    }
    if let Some(side) = job.reading.max_size {
        command += &format!(" --max-size {side}");
    }
    if !somebody {
        command += " --no-occluders";
    }
    if !with.is_empty() {
        command += &format!(" --with {}", with.join(","));
    }
    Some(command)
}

/// Effects that were found and that a reconstruction can fit jointly.
pub(super) fn of_the_camera(d: &Diagnosis) -> Vec<String> {
    let found = d.effects.iter().map(|finding| finding.id);
    found
        .filter(|id| effects::by_id(id).is_some_and(|e| e.is_of_the_camera()))
        .map(str::to_owned)
        .collect()
}

/// Whether somebody was found in the light.
pub(super) fn somebody_found(d: &Diagnosis) -> bool {
    d.effects.iter().any(|f| f.id == joint::OCCLUDER)
}
