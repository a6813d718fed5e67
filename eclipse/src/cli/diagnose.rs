//! `eclipse diagnose`.

mod found;
mod outline;
mod summary;

use std::{
    io::Write,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use clap::Args;

use self::summary::summary;
use super::{
    Failure, Outcome,
    arguments::ReadingArguments,
    print,
    reconstruct::reading::Reading,
    shown::{self, ProgressArguments},
    stop_on_interrupt, taken, units,
};
use crate::{
    capture::{Capture, LoadOptions},
    checkpoint,
    control::Control,
    criticism::{self, DiagnoseError, Diagnosis, Options, Simulation, page, silhouette},
    joint, layout,
    progress::{ProgressDisplay, Style},
    reconstruction::{Ended, Reconstruction},
    relight,
    settings::Settings,
};

const EXAMPLES: &str = "Examples:
  eclipse diagnose my-capture
  eclipse diagnose my-capture --reconstruction out/mine --out out/diagnosis
  eclipse diagnose my-capture --effects exposure_drift,vignetting --json

Effects: moving_occluder, occluder_bounce, exposure_drift, response_curve, vignetting, black_level, \
veiling_glare, clipping, interreflection, ground_bounce, near_field_light, moving_light, emission, \
specular_lobe, translucency, pose_error, defocus, normal_error, medium; where the lamps are known (`lamp` \
in transforms.json) lamp_direction, ambient_light, and of the others those that such light lets tell.";

/// Share of the time that the reconstruction a diagnosis makes for itself may take.
const RECONSTRUCTION: f64 = 0.4;
/// Its steps, which a small capture takes in less: its diagnosis is then the same on any machine. The diagnosis fits light, texture
/// and lobe anew and ends in the same place from 4, 8 and 30 of them; what these save is its own first steps.
const STEPS: u64 = 6;

#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct DiagnoseArguments {
    /// Folder with photographs, their cameras and a mesh.
    pub capture: PathBuf,
    /// Folder that reconstruct wrote [default: a reconstruction without occluders is made].
    #[arg(long, value_name = "DIR")]
    pub reconstruction: Option<PathBuf>,
    /// Folder for the results [default: out/<name of the capture>-diagnosis].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Time (a bare number is seconds) after which no further effect is looked for, the reconstruction included. Effects are compared once however long that takes (a minute or two on two cores), which is told where it goes beyond; an occluder's outline may take an eighth more.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = units::duration, default_value = "8m")]
    pub time_limit: f64,
    /// Effects to try, separated by commas [default: all].
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = units::trimmed)]
    pub effects: Vec<String>,
    /// Mesh to use in place of the capture's own.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = units::at_least::<0>)]
    pub seed: u64,
    /// Threads; results do not depend on it [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print diagnosis.json instead of a summary.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub reading: ReadingArguments,
    #[command(flatten)]
    pub progress: ProgressArguments,
}

/// What one diagnosis needs besides the capture.
pub(super) struct Job<'a> {
    pub capture: &'a Path,
    pub reconstruction: Option<&'a Path>,
    pub out: Option<&'a Path>,
    pub time_limit: f64,
    pub effects: &'a [String],
    pub reading: LoadOptions,
    pub seed: u64,
    pub threads: usize,
    pub style: Style,
}

pub(super) fn run(arguments: &DiagnoseArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    let folder = arguments.out.clone().unwrap_or_else(|| {
        let named = arguments
            .capture
            .canonicalize()
            .unwrap_or_else(|_| arguments.capture.clone());
        let name = named.file_name().unwrap_or("capture".as_ref());
        PathBuf::from("out").join(format!("{}-diagnosis", name.to_string_lossy()))
    });
    let job = Job {
        capture: &arguments.capture,
        reconstruction: arguments.reconstruction.as_deref(),
        out: Some(&folder),
        time_limit: arguments.time_limit,
        effects: &arguments.effects,
        reading: reading(arguments)?,
        seed: arguments.seed,
        threads: arguments
            .threads
            .map_or(Settings::default().threads, usize::from),
        style: arguments.progress.style(arguments.json),
    };
    let stop = stop_on_interrupt()?;
    let Some(diagnosis) = diagnose(&job, stop, &mut |_| Ok(()))? else {
        let _ = writeln!(std::io::stderr(), "interrupted: nothing was written");
        return Ok(Outcome::Interrupted);
    };
    let text = if arguments.json {
        serde_json::to_string_pretty(&diagnosis).map_err(Failure::failed)? + "\n"
    } else {
        summary(&diagnosis, &folder)
    };
    print(out, &text)?;
    if stop.load(Ordering::Relaxed) {
        let _ = writeln!(
            std::io::stderr(),
            "interrupted: what was found by then was written"
        );
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

/// How the capture is read: as was typed and, where nothing was, as the reconstruction that is given read it.
fn reading(arguments: &DiagnoseArguments) -> Result<LoadOptions, Failure> {
    let options = arguments.reading.options(arguments.mesh.as_deref());
    let typed = Reading::typed(&arguments.reading);
    let Some(folder) = &arguments.reconstruction else {
        return Ok(options);
    };
    let kept = relight::reading(folder).map_err(Failure::bad_input)?;
    if let Some(problem) = Reading::misunderstood(&kept, typed.clone()) {
        let path = folder.join(layout::SETTINGS);
        let message = format!("{}: {problem}", path.display());
        return Err(Failure::bad_input(message));
    }
    Ok(typed.or(Reading::told(&kept)).into_options(options))
}

/// Refuses what was reconstructed of another capture: its renders would be blamed on physics.
fn of_this_capture(folder: &Path, capture: &Capture) -> Result<(), Failure> {
    if !folder.is_dir() {
        return Err(Failure::bad_input(format!(
            "--reconstruction {} is no folder; name one that reconstruct wrote",
            folder.display()
        )));
    }
    match checkpoint::is_of(folder, capture) {
        Some(false) => Err(Failure::bad_input(format!(
            "{} was reconstructed from another capture, or from this one with other photographs, cameras, masks, mesh or axes than now: \
             name a reconstruction of this capture, or leave out --reconstruction",
            folder.display()
        ))),
        _ => Ok(()),
    }
}

/// Diagnoses a capture; `None` when interrupted before there was anything to say. An occluder's outline, which comes last, is left
/// out then.
pub(super) fn diagnose(
    job: &Job<'_>,
    stop: &AtomicBool,
    inspect: &mut dyn FnMut(&criticism::Outcome<'_>) -> Result<(), DiagnoseError>,
) -> Result<Option<Diagnosis>, Failure> {
    let began = Instant::now();
    shown::notes_of(job.capture, &job.reading, job.style);
    let capture = Capture::load(job.capture, &job.reading).map_err(Failure::bad_input)?;
    // Before anybody waits for a reconstruction.
    criticism::chosen(job.effects, criticism::light_of(&capture)).map_err(refused)?;
    if let Some(out) = job.out.filter(|out| silhouette::is_foreign(out)) {
        return Err(Failure {
            outcome: Outcome::Usage,
            message: format!(
                "{} is there already and of no diagnosis, which would replace it; name another folder with --out",
                out.join(silhouette::FILE).display()
            ),
        });
    }
    let _lock = job.out.map(taken).transpose()?;
    let report = shown::tell(job.style);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(job.threads)
        .build()
        .map_err(|error| Failure::failed(format!("cannot start threads: {error}")))?;
    let mut reconstruction = 0.0;
    let simulation = match (&capture.lamps, job.reconstruction) {
        (Some(_), Some(folder)) => {
            return Err(Failure {
                outcome: Outcome::Usage,
                message: format!(
                    "the lamps of {} are known (`lamp` in transforms.json), so that there is nothing to reconstruct: leave out \
                     --reconstruction {}",
                    job.capture.display(),
                    folder.display()
                ),
            });
        }
        (Some(lamps), None) => {
            Simulation::under_lamps(&capture, lamps).map_err(Failure::bad_input)?
        }
        (None, Some(folder)) => {
            of_this_capture(folder, &capture)?;
            Simulation::load(folder, &capture).map_err(Failure::bad_input)?
        }
        (None, None) => {
            report("reconstructing without occluders");
            let reconstructing = Instant::now();
            let settings = Settings {
                occluders: false,
                time_limit: Some(RECONSTRUCTION * job.time_limit),
                iterations: Some(STEPS),
                ..job.settings()
            };
            let Some(solved) = job.solve(&capture, &settings, &pool, stop)? else {
                return Ok(None);
            };
            reconstruction = reconstructing.elapsed().as_secs_f64();
            Simulation::of(&solved)
        }
    };
    let options = Options {
        seed: job.seed,
        effects: job.effects.to_vec(),
        time_limit: Some((job.time_limit - began.elapsed().as_secs_f64()).max(1.0)),
        ..Options::default()
    };
    let go_on = |text: &str| {
        report(text);
        !stop.load(Ordering::Relaxed)
    };
    let outcome = pool.install(|| criticism::diagnose(&capture, &simulation, &options, &go_on));
    let mut outcome = match outcome {
        Err(DiagnoseError::Interrupted) => return Ok(None),
        other => other.map_err(refused)?,
    };
    // Where the lamps are known there is nothing to reconstruct.
    if capture.lamps.is_none() {
        let lambertian = found::is_lambertian(&outcome);
        outcome.diagnosis.command = found::reconstruction_with(job, &outcome.diagnosis, lambertian);
    }
    outline::draw(job, &capture, &mut outcome, (began, &pool, stop), &report);
    let seconds = &mut outcome.diagnosis.seconds;
    seconds.insert("reconstruction".to_owned(), reconstruction);
    seconds.insert("total".to_owned(), began.elapsed().as_secs_f64());
    inspect(&outcome).map_err(Failure::failed)?;
    if let Some(folder) = job.out {
        page::write(folder, &outcome).map_err(Failure::failed)?;
    }
    Ok(Some(outcome.diagnosis))
}

impl Job<'_> {
    /// What all reconstructions of a diagnosis have in common.
    fn settings(&self) -> Settings {
        Settings {
            seed: self.seed,
            threads: self.threads,
            mesh: self.reading.mesh.clone(),
            ..Settings::default()
        }
    }

    /// A reconstruction; `None` when interrupted.
    fn solve(
        &self,
        capture: &Capture,
        settings: &Settings,
        pool: &rayon::ThreadPool,
        stop: &AtomicBool,
    ) -> Result<Option<Reconstruction>, Failure> {
        let display = ProgressDisplay::new(settings, self.style);
        let control = Control {
            stop,
            progress: &|progress| display.update(progress),
            ..Control::detached()
        };
        let solved = pool.install(|| joint::run(capture, settings, &control));
        display.finish();
        match solved {
            Ok(solved) => Ok((solved.ended != Ended::Interrupted).then_some(solved)),
            Err(error) if error.is_an_interrupt() => Ok(None),
            Err(error) => {
                let input = error.is_of_the_input();
                Err(Failure::of(error, input))
            }
        }
    }
}

/// Whose fault it is.
fn refused(error: DiagnoseError) -> Failure {
    match error {
        DiagnoseError::Unknown(_) | DiagnoseError::OtherLight { .. } => Failure {
            outcome: Outcome::Usage,
            message: error.to_string(),
        },
        DiagnoseError::Study(_) => Failure::bad_input(error),
        other => Failure::failed(other),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::{
        capture::UpAxis,
        cli::arguments::{Arguments, Command},
    };

    #[test]
    fn a_capture_is_read_as_its_reconstruction_read_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut settings = Settings::default();
        settings.reading.up = Some("-y".to_owned());
        settings.reading.max_size = Some(640);
        let json = serde_json::to_string(&settings).unwrap();
        std::fs::write(folder.path().join(crate::layout::SETTINGS), json).unwrap();
        let options = |typed: &[&str]| {
            let words = [["eclipse", "diagnose", "capture"].as_slice(), typed].concat();
            match Arguments::try_parse_from(words).unwrap().command {
                Command::Diagnose(arguments) => reading(&arguments).ok().unwrap(),
                _ => unreachable!("the subcommand was given"),
            }
        };
        let with = ["--reconstruction", folder.path().to_str().unwrap()];
        let read = options(&with);
        assert_eq!((read.up, read.max_size), (UpAxis::NegY, Some(640)));
        let read = options(&[with.as_slice(), &["--up", "x"]].concat());
        assert_eq!((read.up, read.max_size), (UpAxis::X, Some(640)));
        assert_eq!(options(&[]).up, UpAxis::default());
    }

    #[test]
    fn a_reading_that_cannot_be_understood_is_told_unless_it_is_typed_anew() {
        let folder = tempfile::tempdir().unwrap();
        let mut settings = Settings::default();
        settings.reading.up = Some("sideways".to_owned());
        settings.reading.color = Some("sepia".to_owned());
        let json = serde_json::to_string(&settings).unwrap();
        std::fs::write(folder.path().join(crate::layout::SETTINGS), json).unwrap();
        let refused = |typed: &[&str]| {
            let with = ["--reconstruction", folder.path().to_str().unwrap()];
            let words = [["eclipse", "diagnose", "capture"].as_slice(), &with, typed].concat();
            match Arguments::try_parse_from(words).unwrap().command {
                Command::Diagnose(arguments) => reading(&arguments).err().map(|f| f.message),
                _ => unreachable!("the subcommand was given"),
            }
        };
        assert!(refused(&[]).unwrap().contains("sepia"));
        assert!(refused(&["--color", "srgb"]).unwrap().contains("sideways"));
        assert_eq!(refused(&["--color", "srgb", "--up", "x"]), None);
    }
}
