//! `eclipse reconstruct`.

mod limit;
mod place;
pub(super) mod reading;
mod resume;
mod summary;

use std::{
    ffi::OsString,
    io::Write,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use clap::{Args, ValueEnum};
use render::image::Image;
use serde_json::json;

use self::{
    resume::Chosen,
    summary::{no_step, summary},
};
use super::{
    Failure, Outcome, arguments::ReadingArguments, print, shown, shown::ProgressArguments,
    stop_on_interrupt, taken, units,
};
use crate::{
    capture::Capture,
    checkpoint,
    control::Control,
    inspect,
    joint::{self, JointError},
    output,
    progress::{Dashboard, ProgressDisplay, Style, say},
    reconstruct::{self, ReconstructError},
    reconstruction::Ended,
    report::{ReportOptions, radiance},
    settings::{OccluderPrior, Preset, Settings},
    wording::counted,
};

const RECONSTRUCT_EXAMPLES: &str = "Examples:
  eclipse reconstruct tests/captures/potatoes
  eclipse reconstruct my-capture --out out/first --time-limit 10m --hold-out 8
  # after Ctrl-C, with the same options:
  eclipse reconstruct my-capture --out out/first --resume
  # an hour in all, all else the same:
  eclipse reconstruct my-capture --out out/first --resume --time-limit 1h
  eclipse reconstruct my-capture --out out/refined --preset paper \\
    --from out/first --hold-out 8
  eclipse reconstruct my-capture --out out/camera \\
    --with exposure_drift,vignetting
  # y points down in it, the photographs are large:
  eclipse reconstruct my-colmap --out out/colmap --up -y --max-size 1024

A capture is a folder with transforms.json (Blender/NeRF or nerfstudio), transforms_train.json (Blender's splits, Stanford-ORB) or a \
COLMAP model, the photographs it names (EXR, HDR, PNG, JPEG; alpha or masks) and a mesh (mesh.glb, .gltf, .obj or .ply). The light is \
recovered with z up. Which way is up in a COLMAP model is arbitrary: say it with --up, where it is not z; eclipse inspect tells it.

With --resume, options that are not given are those of the run's beginning (but for --allow-outside, which has to be given again). Time \
limit, iterations, threads and memory may be others, with the same result bit for bit as far as a run goes.";

#[derive(Args, Debug)]
#[command(after_help = RECONSTRUCT_EXAMPLES)]
pub(super) struct ReconstructArguments {
    /// Folder with photographs, their cameras and a mesh.
    pub capture: PathBuf,
    /// Folder for the results [default: out/<name of the capture>].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Algorithm: the best known, or the paper's to the letter.
    #[arg(long, value_enum, default_value_t = PresetName::Fast)]
    pub preset: PresetName,
    /// Start from the result in DIR, of the same capture (paper preset).
    #[arg(long, value_name = "DIR")]
    pub from: Option<PathBuf>,
    /// Time for the solve, such as 90s, 10m or 1h30m; a bare number is seconds [default: 120s, or none with --iterations].
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = units::duration)]
    pub time_limit: Option<f64>,
    /// Most iterations of the optimiser [default: the preset's].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = units::at_least::<1>)]
    pub iterations: Option<u64>,
    /// Do not model occluders.
    #[arg(long)]
    pub no_occluders: bool,
    /// What is assumed about occluders: an upright person behind the camera, or nothing.
    #[arg(long, value_enum, default_value_t = PriorName::Operator, conflicts_with = "no_occluders")]
    pub occluder_prior: PriorName,
    /// Purely diffuse materials.
    #[arg(long)]
    pub lambertian: bool,
    /// Mesh to use in place of the capture's own.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = units::at_least::<0>)]
    pub seed: u64,
    /// Threads; results do not depend on it [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Memory to stay within.
    #[arg(long, value_name = "SIZE", default_value = "4GiB", allow_hyphen_values = true, value_parser = units::size)]
    pub memory: u64,
    /// Keep every K-th frame out of the fit of environment and materials, and judge by it.
    #[arg(long, value_name = "K", allow_negative_numbers = true, value_parser = units::at_least::<2>)]
    pub hold_out: Option<u64>,
    /// Effects of the camera to fit jointly: exposure_drift, vignetting, black_level, response_curve, veiling_glare.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = units::trimmed)]
    pub with: Vec<String>,
    #[command(flatten)]
    pub reading: ReadingArguments,
    /// Continue the run in --out from its checkpoint, with its options where none are given.
    #[arg(long)]
    pub resume: bool,
    /// Print the metrics as JSON and nothing else.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub progress: ProgressArguments,
    /// A screen with the loss, the light as it stands, the pace and the time left, in place of the bar.
    #[arg(long, conflicts_with = "progress")]
    pub tui: bool,
}

/// Runs the command that was typed as `typed`.
pub(super) fn run(
    arguments: &ReconstructArguments,
    typed: &[OsString],
    out: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let folder = arguments.out();
    // Nothing to continue from is said at once, not after the photographs are read.
    let begun = arguments.resume.then(|| checkpoint::load(&folder));
    let begun = begun.transpose().map_err(Failure::bad_input)?;
    let chosen = Chosen::of(arguments, typed, begun.as_ref());
    let settings = &chosen.settings;
    if settings.from.is_some() && settings.preset != Preset::Paper {
        return Err(Failure {
            outcome: Outcome::Usage,
            message: "--from is of the paper preset: add --preset paper".to_owned(),
        });
    }
    joint::of_the_camera(&settings.with).map_err(|error| Failure {
        outcome: Outcome::Usage,
        message: error.to_string(),
    })?;
    let options = chosen.options(arguments);
    let style = match arguments.tui {
        true => Style::Hidden,
        false => arguments.progress.style(arguments.json),
    };
    shown::notes_of(&arguments.capture, &options, style);
    let capture = Capture::load(&arguments.capture, &options).map_err(Failure::bad_input)?;
    // Before a folder is made for it.
    let frames = settings.check_frames(capture.frames.len());
    frames.map_err(|error| Failure {
        outcome: Outcome::Usage,
        message: error.to_string(),
    })?;
    reconstruct::check_light(&capture).map_err(Failure::bad_input)?;
    reconstruct::check_memory(&capture, settings).map_err(Failure::bad_input)?;
    // A run that goes on has no need of what it started from.
    if let Some(from) = settings.from.as_ref().filter(|_| !arguments.resume) {
        reconstruct::paper::start::check(from, &capture).map_err(Failure::bad_input)?;
    }
    place::check(&folder, &arguments.capture)?;
    // From here on there is a folder to tidy up.
    let stop = stop_on_interrupt()?;
    let _lock = taken(&folder)?;
    // Again, now that nobody else can write it.
    let resumed = arguments.resume.then(|| checkpoint::load(&folder));
    let resumed = resumed.transpose().map_err(Failure::bad_input)?;
    let planned = match &resumed {
        None => reconstruct::memory(&capture, settings),
        Some(checkpoint) => {
            let checked = chosen.check(checkpoint, &capture);
            checked
                .map_err(|error| Failure::bad_input(format!("{}: {error}", folder.display())))?;
            reconstruct::run::memory_to_resume(&capture, settings, checkpoint)
                .map_err(Failure::bad_input)?
        }
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(settings.threads)
        .build();
    let pool = pool.map_err(|error| Failure::failed(format!("cannot start threads: {error}")))?;

    announce(&capture, settings, planned, style);
    let upright = settings.occluders && settings.occluder_prior == OccluderPrior::Operator;
    for warning in inspect::of_cameras(&capture, options.up, upright) {
        shown::warn(style, &format!("note: {warning}"));
    }
    if !arguments.resume && checkpoint::is_in(&folder) {
        warn_of_earlier(&folder, style);
    }
    if arguments.resume
        && let Some(damage) = checkpoint::passed_over(&folder)
    {
        let warning =
            format!("the latest checkpoint cannot be gone on from, the one before it is: {damage}");
        shown::warn(style, &warning);
    }
    let display = ProgressDisplay::new(settings, style);
    let dashboard = arguments.dashboard(settings)?;
    let light: &(dyn Fn(&Image) + Sync) = &|environment| {
        if let Some(dashboard) = &dashboard {
            dashboard.light(environment);
        }
    };
    let saved = AtomicBool::new(arguments.resume);
    let control = Control {
        stop,
        progress: &|progress| match &dashboard {
            Some(dashboard) => dashboard.update(progress),
            None => display.update(progress),
        },
        light: dashboard.as_ref().map(|_| light),
        checkpoint: &|checkpoint| {
            checkpoint::save(&folder, checkpoint)?;
            saved.store(true, Ordering::Relaxed);
            Ok(())
        },
        resume: resumed.as_ref(),
    };
    let solved = pool.install(|| {
        let mut solved = joint::run(&capture, settings, &control)?;
        let limit = limit::of(&capture, &solved);
        solved.metrics.extra.insert("limit".to_owned(), limit);
        solved.notes.extend(no_step(&solved, resumed.as_ref()));
        Ok::<_, JointError>(solved)
    });
    display.finish();
    drop(dashboard);
    let solved = match solved {
        // Whatever lies in the folder says more than a start.
        Err(error) if error.is_an_interrupt() => return interrupted(style, &error),
        Ok(solved) if solved.ended == Ended::Interrupted && !saved.load(Ordering::Relaxed) => {
            return interrupted(style, &ReconstructError::Interrupted);
        }
        Ok(solved) => solved,
        Err(error) => {
            let input = error.is_of_the_input();
            return Err(Failure::of(error, input));
        }
    };
    // The report names it, and comes last.
    radiance::write(&folder, &solved.environment).map_err(Failure::failed)?;
    let report = ReportOptions::new(command(typed, &chosen.inherited));
    output::write(&folder, &capture, &solved, &report).map_err(Failure::failed)?;
    print(out, &summary(&folder, &solved, arguments.json))?;
    Ok(if solved.ended == Ended::Interrupted {
        Outcome::Interrupted
    } else {
        Outcome::Done
    })
}

/// What is said where nothing is left of the work.
fn interrupted(style: Style, why: &dyn std::fmt::Display) -> Result<Outcome, Failure> {
    shown::warn(style, &why.to_string());
    Ok(Outcome::Interrupted)
}

/// What is said before the work begins.
fn announce(capture: &Capture, settings: &Settings, planned: u64, style: Style) {
    let (frames, preset) = (capture.frames.len(), settings.preset.name());
    match style {
        // A closed standard error is no failure.
        Style::Bar => {
            let _ = writeln!(
                std::io::stderr(),
                "{}, {preset} preset: about {} of memory, {} allowed",
                counted(frames, "frame"),
                units::bytes(planned),
                units::bytes(settings.memory)
            );
        }
        Style::Lines => say(&json!({
            "event": "start", "frames": frames, "preset": preset, "memory_bytes": planned,
            "memory_allowed_bytes": settings.memory,
        })),
        Style::Hidden => {}
    }
}

/// Folders that other commands leave in a result's.
const DERIVED: [&str; 4] = ["blender", "mitsuba", "threejs", "relit"];

/// Said even where progress is not shown: results are about to be lost.
fn warn_of_earlier(folder: &Path, style: Style) {
    let derived = DERIVED
        .into_iter()
        .filter(|name| folder.join(name).is_dir());
    let derived: Vec<&str> = derived.collect();
    let derived = match derived.is_empty() {
        true => String::new(),
        false => format!(
            "; what was made of it stays as it is: {}",
            derived.join(", ")
        ),
    };
    // Ctrl-C before the first step leaves all as it is.
    let warning = format!(
        "{} holds an earlier run, which this one begins to write over with its first step; --resume goes on with it instead{derived}",
        folder.display()
    );
    shown::warn(style, &warning);
}

/// The command as a shell would take it, without `--resume`, but with the options that it `inherited`: a repeat starts afresh.
fn command(typed: &[OsString], inherited: &[String]) -> String {
    let mut words = units::shell_words(typed);
    words.retain(|word| word != "--resume");
    // Behind the name of the command: what was typed may end in words that are no options.
    let place = words.len().min(2);
    let inherited = inherited.iter().map(|word| units::shell_word(word));
    words.splice(place..place, inherited);
    words.join(" ")
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum PresetName {
    Fast,
    Paper,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum PriorName {
    Operator,
    None,
}

impl ReconstructArguments {
    /// The folder for the results: as asked, or `out/` and the capture's name.
    pub(super) fn out(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            // `.` and `..` have no name of their own.
            let named = self
                .capture
                .canonicalize()
                .unwrap_or_else(|_| self.capture.clone());
            PathBuf::from("out").join(named.file_name().unwrap_or("capture".as_ref()))
        })
    }

    /// The screen, where it is asked for.
    fn dashboard(&self, settings: &Settings) -> Result<Option<Dashboard>, Failure> {
        if !self.tui {
            return Ok(None);
        }
        let name = self.out();
        let name = name.file_name().unwrap_or_default().to_string_lossy();
        let title = format!("{name}, {} preset", settings.preset.name());
        let begun = Dashboard::begin(title, settings).map_err(|error| Failure {
            outcome: Outcome::Usage,
            message: format!("--tui cannot be shown: {error}; use --progress bar or json"),
        });
        begun.map(Some)
    }

    /// Every option with its value.
    pub(super) fn settings(&self) -> Settings {
        let default = Settings::of(match self.preset {
            PresetName::Fast => Preset::Fast,
            PresetName::Paper => Preset::Paper,
        });
        Settings {
            time_limit: self.time_limit.or(if self.iterations.is_some() {
                None
            } else {
                default.time_limit
            }),
            iterations: self.iterations,
            seed: self.seed,
            threads: self.threads.map_or(default.threads, usize::from),
            memory: self.memory,
            occluders: !self.no_occluders,
            occluder_prior: match self.occluder_prior {
                PriorName::Operator => OccluderPrior::Operator,
                PriorName::None => OccluderPrior::None,
            },
            lambertian: self.lambertian,
            hold_out: self.hold_out.map(|every| every as usize),
            mesh: self.mesh.clone(),
            from: self.from.clone(),
            with: self.with.clone(),
            ..default
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::{
        super::arguments::{Arguments, Command},
        *,
    };

    fn reconstruct(arguments: &str) -> Result<ReconstructArguments, clap::Error> {
        let arguments = ["eclipse", "reconstruct"]
            .into_iter()
            .chain(arguments.split_whitespace());
        match Arguments::try_parse_from(arguments)?.command {
            Command::Reconstruct(arguments) => Ok(arguments),
            _ => unreachable!("the subcommand was given"),
        }
    }

    #[test]
    fn plain_arguments_resolve_to_the_default_settings() {
        let plain = reconstruct("some/capture").unwrap();
        assert_eq!(plain.settings(), Settings::default());
        assert_eq!(plain.out(), PathBuf::from("out/capture"));
    }

    #[test]
    fn every_option_reaches_the_settings() {
        let all = "c --out o --preset paper --time-limit 10m --iterations 7 --occluder-prior none --lambertian \
                   --mesh m.obj --seed 3 --threads 2 --memory 1GiB --hold-out 8";
        let expected = Settings {
            preset: Preset::Paper,
            time_limit: Some(600.0),
            iterations: Some(7),
            seed: 3,
            threads: 2,
            memory: 1 << 30,
            occluder_prior: OccluderPrior::None,
            lambertian: true,
            hold_out: Some(8),
            harmonic_degree: 24,
            mesh: Some("m.obj".into()),
            ..Settings::default()
        };
        assert_eq!(reconstruct(all).unwrap().settings(), expected);
        assert!(
            !reconstruct("c --no-occluders")
                .unwrap()
                .settings()
                .occluders
        );
    }

    #[test]
    fn asking_for_iterations_lifts_the_time_limit() {
        assert_eq!(
            reconstruct("c --iterations 7")
                .unwrap()
                .settings()
                .time_limit,
            None
        );
    }

    #[test]
    fn nonsense_is_refused() {
        for arguments in [
            "",
            "c --time-limit soon",
            "c --memory much",
            "c --hold-out 1",
            "c --threads 0",
            "c --iterations 0",
            "c --no-occluders --occluder-prior none",
            "c --preset best",
        ] {
            assert!(reconstruct(arguments).is_err(), "{arguments}");
        }
    }

    #[test]
    fn the_command_can_be_pasted_and_starts_afresh() {
        let typed = [
            "/usr/bin/eclipse",
            "reconstruct",
            "my captures/it's",
            "--resume",
            "--seed",
            "3",
        ];
        let typed: Vec<OsString> = typed.into_iter().map(OsString::from).collect();
        assert_eq!(
            command(&typed, &[]),
            r"eclipse reconstruct 'my captures/it'\''s' --seed 3"
        );
        // What a run that went on had from its beginning is a part of it.
        let inherited = ["--mesh", "my m.obj"].map(str::to_owned);
        assert_eq!(
            command(&typed, &inherited),
            r"eclipse reconstruct --mesh 'my m.obj' 'my captures/it'\''s' --seed 3"
        );
    }
}
