//! What a reconstruction can do about what was found.

use super::Job;
use crate::{
    capture::UpAxis,
    cli::{arguments::ColorName, units},
    criticism::{Diagnosis, Outcome, diagnosis::Finding, effects},
    joint,
};

/// The command that reconstructs with what was found: effects of the camera fitted jointly, occluders if somebody moves in the
/// light, a surface without gloss where `lambertian` says so; `None` where a reconstruction can do nothing about it.
pub(super) fn reconstruction_with(
    job: &Job<'_>,
    d: &Diagnosis,
    lambertian: bool,
) -> Option<String> {
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
    if let Some(images) = &job.reading.images {
        let images = units::shell_word(&images.to_string_lossy());
        command += &format!(" --images {images}");
    }
    if lambertian {
        command += " --lambertian";
    }
    if !somebody {
        command += " --no-occluders";
    }
    if !with.is_empty() {
        command += &format!(" --with {}", with.join(","));
    }
    Some(command)
}

/// Whether a reconstruction should have no gloss: the first model had none, and none was found.
pub(super) fn is_lambertian(outcome: &Outcome<'_>) -> bool {
    let gloss = |f: &Finding| f.id == "specular_lobe";
    outcome.before.lobe.is_none() && !outcome.diagnosis.effects.iter().any(gloss)
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::{capture::LoadOptions, criticism::Verdict, progress::Style};

    #[test]
    fn the_command_keeps_what_was_known_of_the_surface() {
        let job = Job {
            capture: Path::new("my capture"),
            reconstruction: None,
            out: None,
            time_limit: 60.0,
            effects: &[],
            reading: LoadOptions::default(),
            seed: 0,
            threads: 1,
            style: Style::Hidden,
        };
        let found = vec![Finding::example("vignetting", Vec::new())];
        let mut d = Diagnosis::example(Verdict::Explained, found);
        let command = |d: &Diagnosis, lambertian| reconstruction_with(&job, d, lambertian);
        let glossy = command(&d, false).unwrap();
        assert!(glossy.starts_with("eclipse reconstruct "), "{glossy}");
        assert!(
            glossy.ends_with(" --no-occluders --with vignetting"),
            "{glossy}"
        );
        let matte = command(&d, true).unwrap();
        assert!(
            matte.ends_with(" --lambertian --no-occluders --with vignetting"),
            "{matte}"
        );
        d.effects = vec![Finding::example("defocus", Vec::new())];
        assert_eq!(command(&d, true), None);
    }
}
