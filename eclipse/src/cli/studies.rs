//! `eclipse study NAME` for the paper's experiments.

use std::{
    cell::RefCell,
    ffi::OsString,
    io::Write,
    path::{Path, PathBuf},
};

use clap::{Arg, Args, Subcommand};

use super::{
    Failure, Outcome,
    arguments::ReadingArguments,
    print,
    shown::{self, ProgressArguments},
    stop_on_interrupt, units,
};
use crate::{
    files::made::MadeFolder,
    progress::{Event, Lines, Style},
    studies::{self, Bench, CAPTURES, Evidence, Scale, Study, StudyError, page},
};

/// What is said where the study of real photographs has none.
const NO_PHOTOGRAPHS: &str = "`real` needs photographs of a real object, which are not part of the project: name the folder of a capture \
    that `eclipse inspect` accepts with --real DIR, or with the environment variable ECLIPSE_REAL";

/// Options that some studies have a use for, by their fields' names, each with those studies; all of them together use everything.
/// (How many captures there are decides how long a real one is reconstructed for.)
const OF_SOME: [(&str, &[&str]); 9] = [
    (
        "captures",
        &[
            "limit",
            "recovery",
            "lambertian",
            "masks",
            "relighting",
            "time",
            "real",
        ],
    ),
    (
        "time_limit",
        &[
            "recovery",
            "lambertian",
            "masks",
            "relighting",
            "time",
            "real",
        ],
    ),
    ("real", &["real"]),
    ("mesh", OF_PHOTOGRAPHS),
    ("allow_outside", OF_PHOTOGRAPHS),
    ("color", OF_PHOTOGRAPHS),
    ("up", OF_PHOTOGRAPHS),
    ("max_size", OF_PHOTOGRAPHS),
    ("images", OF_PHOTOGRAPHS),
];

/// Studies of a capture of somebody's own.
const OF_PHOTOGRAPHS: &[&str] = &["limit", "real"];

/// Leaves out of the help of a study what it has no use for.
fn as_used_by(study: &'static str) -> impl FnMut(Arg) -> Arg {
    move |option| {
        let of_some = OF_SOME.iter().find(|(name, _)| option.get_id() == *name);
        let unused = of_some.is_some_and(|(_, studies)| !studies.contains(&study));
        option.hide(unused)
    }
}

#[derive(Subcommand, Debug)]
pub(super) enum PaperStudy {
    /// Fig. 2: a matt sphere and a mirror that look the same, and an occluder that tells them apart.
    #[command(mut_args(as_used_by("ambiguity")))]
    Ambiguity(PaperArguments),
    /// Fig. 3: singular values of what is observed, over the number of occluders.
    #[command(mut_args(as_used_by("conditioning")))]
    Conditioning(PaperArguments),
    /// Fig. S8 and S9: masks as waves, light as a pyramid.
    #[command(mut_args(as_used_by("theory")))]
    Theory(PaperArguments),
    /// Fig. 1, 4 and S1: light, albedo and occluders of every capture with truth, against occluders not modelled.
    #[command(mut_args(as_used_by("recovery")))]
    Recovery(PaperArguments),
    /// Fig. 6: a matt object with and without somebody in the light.
    #[command(mut_args(as_used_by("lambertian")))]
    Lambertian(PaperArguments),
    /// Fig. 5: errors of masks against the light that they block.
    #[command(mut_args(as_used_by("masks")))]
    Masks(PaperArguments),
    /// What photographs can tell of the light at best, before anything is solved.
    #[command(mut_args(as_used_by("limit")))]
    Limit(LimitArguments),
    /// Whether standard deviations are of the size of errors, over draws of noise and seeds.
    #[command(mut_args(as_used_by("uncertainty")))]
    Uncertainty(PaperArguments),
    /// Table 1 and Fig. 10: harmonics and pyramid against free values, ratio, degree, bias.
    #[command(mut_args(as_used_by("parametrisation")))]
    Parametrisation(PaperArguments),
    /// S6: materials of shiny objects.
    #[command(mut_args(as_used_by("shiny")))]
    Shiny(PaperArguments),
    /// Fig. 9 and S3: lamps, roughness, person, noise, rays and photographs, one at a time.
    #[command(mut_args(as_used_by("sweeps")))]
    Sweeps(PaperArguments),
    /// S5: recovered objects in other light, with other finishes.
    #[command(mut_args(as_used_by("relighting")))]
    Relighting(PaperArguments),
    /// Quality over time of the presets `paper` and `fast`.
    #[command(mut_args(as_used_by("time")))]
    Time(PaperArguments),
    /// Fig. 8 and S2: real photographs, judged by views held out.
    #[command(mut_args(as_used_by("real")))]
    Real(PaperArguments),
    /// Every study there is, one after the other: the paper's experiments, limit, uncertainty and time.
    All(PaperArguments),
}

#[derive(Args, Debug)]
pub(super) struct LimitArguments {
    /// Folder of a capture, with or without a truth [default: all of --captures].
    pub capture: Option<PathBuf>,
    #[command(flatten)]
    pub paper: PaperArguments,
}

#[derive(Args, Debug)]
pub(super) struct PaperArguments {
    /// What settles the claim in minutes: short reconstructions, small captures; all studies within two hours [default].
    #[arg(long)]
    pub quick: bool,
    /// The paper's scale where that is a matter of minutes, and ten minutes for a reconstruction.
    #[arg(long, conflicts_with = "quick")]
    pub full: bool,
    /// Only whether everything runs, in seconds: one seed, tiny captures, a step or two. No claim is judged.
    #[arg(long, conflicts_with_all = ["quick", "full"])]
    pub glance: bool,
    /// Folder of captures with their truth, for the studies that do not make their own; `lambertian` and `recovery` compare a capture NAME
    /// with the same without anybody in the light, NAME-unoccluded.
    #[arg(long, value_name = "DIR", default_value = CAPTURES)]
    pub captures: PathBuf,
    /// Folder of a capture of real photographs, for the study `real` [default: the environment variable ECLIPSE_REAL].
    #[arg(long, value_name = "DIR")]
    pub real: Option<PathBuf>,
    /// Mesh to use in place of that capture's own.
    #[arg(long, value_name = "FILE")]
    pub mesh: Option<PathBuf>,
    #[command(flatten)]
    pub reading: ReadingArguments,
    /// Time for each reconstruction of those captures, a bare number being seconds [default: 2m or, where there are many captures, what leaves all studies
    /// within two hours; 10m with --full]. Captures that a study makes for itself take a fixed number of steps.
    #[arg(long, value_name = "TIME", allow_hyphen_values = true, value_parser = units::duration)]
    pub time_limit: Option<f64>,
    /// Threads [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Folder for a folder of each study.
    #[arg(long, value_name = "DIR", default_value = "out/studies")]
    pub out: PathBuf,
    /// Print JSON: one summary, or a list of them for `all`.
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub progress: ProgressArguments,
}

impl PaperStudy {
    /// Its name, or none for all of them, and its arguments.
    fn named(&self) -> (Option<&'static str>, &PaperArguments) {
        match self {
            Self::Ambiguity(arguments) => (Some("ambiguity"), arguments),
            Self::Conditioning(arguments) => (Some("conditioning"), arguments),
            Self::Theory(arguments) => (Some("theory"), arguments),
            Self::Recovery(arguments) => (Some("recovery"), arguments),
            Self::Lambertian(arguments) => (Some("lambertian"), arguments),
            Self::Masks(arguments) => (Some("masks"), arguments),
            Self::Limit(arguments) => (Some("limit"), &arguments.paper),
            Self::Uncertainty(arguments) => (Some("uncertainty"), arguments),
            Self::Parametrisation(arguments) => (Some("parametrisation"), arguments),
            Self::Shiny(arguments) => (Some("shiny"), arguments),
            Self::Sweeps(arguments) => (Some("sweeps"), arguments),
            Self::Relighting(arguments) => (Some("relighting"), arguments),
            Self::Time(arguments) => (Some("time"), arguments),
            Self::Real(arguments) => (Some("real"), arguments),
            Self::All(arguments) => (None, arguments),
        }
    }

    pub(super) fn arguments(&self) -> &PaperArguments {
        self.named().1
    }
}

pub(super) fn run(
    study: &PaperStudy,
    typed: &[OsString],
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let (name, arguments) = study.named();
    let Some(name) = name else {
        return every(arguments, typed, out, err);
    };
    let capture = match study {
        PaperStudy::Limit(arguments) => arguments.capture.as_deref(),
        _ => None,
    };
    let study = studies::by_name(name)
        .ok_or_else(|| Failure::failed(format!("there is no study called {name}")))?;
    arguments.tell_unused(name);
    if name == "real" && arguments.real().is_none() {
        return Err(Failure::bad_input(NO_PHOTOGRAPHS));
    }
    let mut ended = Ended::default();
    let evidence = arguments.with_bench(capture, err, |bench| {
        let evidence = one(study, bench, arguments, typed);
        ended.look_at(bench);
        evidence
    })?;
    match evidence {
        Ok(evidence) => {
            let text = if arguments.json {
                serde_json::to_string_pretty(&evidence.summary()).map_err(Failure::failed)? + "\n"
            } else {
                evidence.first_line() + "\n"
            };
            print(out, &text)?;
        }
        Err(StudyError::Stopped) => ended.interrupted = true,
        Err(error) => ended.failed.push(failure(name, &error)),
    }
    ended.outcome()
}

/// All of them on one bench; a study that cannot run does not keep the others from it, but from success.
fn every(
    arguments: &PaperArguments,
    typed: &[OsString],
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let (mut found, mut ended) = (Vec::new(), Ended::default());
    arguments.with_bench(None, err, |bench| {
        for study in studies::all() {
            if bench.stopped() {
                break;
            }
            match one(*study, bench, arguments, typed) {
                Ok(evidence) => {
                    if !arguments.json {
                        let line = format!("{}: {}\n", evidence.name, evidence.first_line());
                        print(out, &line)?;
                    }
                    found.push(evidence);
                }
                Err(StudyError::Stopped) => break,
                Err(error) => {
                    let failed = failure(study.name(), &error);
                    (bench.tell)(&failed.message);
                    ended.failed.push(failed);
                }
            }
        }
        ended.look_at(bench);
        Ok(())
    })??;
    if arguments.json {
        let summaries: Vec<_> = found.iter().map(Evidence::summary).collect();
        let text = serde_json::to_string_pretty(&summaries).map_err(Failure::failed)?;
        print(out, &(text + "\n"))?;
    }
    ended.outcome()
}

/// How the work ended: whatever is amiss keeps no study from being written and printed, but the command from success.
#[derive(Default)]
struct Ended {
    /// Whether somebody asked for the end.
    interrupted: bool,
    /// Studies that have nothing to say.
    failed: Vec<Failure>,
    /// Captures that were left out, each with the reason.
    unusable: Vec<String>,
}

impl Ended {
    fn look_at(&mut self, bench: &Bench<'_>) {
        self.interrupted = bench.stopped();
        self.unusable = bench.unusable();
    }

    fn outcome(self) -> Result<Outcome, Failure> {
        let mut failed = self.failed;
        failed.extend(self.unusable.into_iter().map(Failure::bad_input));
        let Some(first) = failed.first() else {
            return match self.interrupted {
                true => Err(Failure {
                    outcome: Outcome::Interrupted,
                    message: StudyError::Stopped.to_string(),
                }),
                false => Ok(Outcome::Done),
            };
        };
        let outcome = if self.interrupted {
            Outcome::Interrupted
        } else if failed.iter().all(|f| f.outcome == first.outcome) {
            first.outcome
        } else {
            Outcome::Failed
        };
        let messages: Vec<&str> = failed.iter().map(|f| f.message.as_str()).collect();
        Err(Failure {
            outcome,
            message: messages.join("\n  "),
        })
    }
}

/// Runs a study and writes its folder.
fn one(
    study: &dyn Study,
    bench: &Bench<'_>,
    arguments: &PaperArguments,
    typed: &[OsString],
) -> Result<Evidence, StudyError> {
    let folder = arguments.out.join(study.name());
    // Where the study fails nothing is left.
    let _made = MadeFolder::make(&folder)?;
    let evidence = studies::run(study, bench)?;
    page::write(&folder, &evidence, &command(typed, bench))?;
    (bench.tell)(&folder.join(page::PAGE).display().to_string());
    Ok(evidence)
}

/// The command as it was `typed`, as a shell would take it; with the folder that the environment named, if it did.
fn command(typed: &[OsString], bench: &Bench<'_>) -> String {
    let mut words = units::shell_words(typed);
    let by_option = words
        .iter()
        .any(|word| word == "--real" || word.starts_with("--real="));
    if let Some(real) = bench.real.filter(|_| !by_option) {
        words.push(format!(
            "--real {}",
            units::shell_word(&real.to_string_lossy())
        ));
    }
    words.join(" ")
}

fn failure(name: &str, error: &StudyError) -> Failure {
    Failure::of(
        format!("{name} did not run: {error}"),
        error.is_of_the_input(),
    )
}

impl PaperArguments {
    /// The folder of real photographs: as asked, or as the environment has it.
    fn real(&self) -> Option<PathBuf> {
        let named = || std::env::var_os("ECLIPSE_REAL").map(PathBuf::from);
        self.real.clone().or_else(named)
    }

    /// Says which options that were given this study has no use for: whoever gave them expects something of them.
    fn tell_unused(&self, study: &str) {
        let given = [
            self.captures != Path::new(CAPTURES),
            self.time_limit.is_some(),
            self.real.is_some(),
            self.mesh.is_some(),
            self.reading.allow_outside,
            self.reading.color.is_some(),
            self.reading.up.is_some(),
            self.reading.max_size.is_some(),
            self.reading.images.is_some(),
        ];
        let given = OF_SOME.iter().zip(given).filter(|(_, given)| *given);
        for ((name, studies), _) in given.filter(|((_, studies), _)| !studies.contains(&study)) {
            let option = name.replace('_', "-");
            let note = format!(
                "note: --{option} changes nothing here, `{study}` having no use for it: it is for {}",
                studies.join(", ")
            );
            shown::warn(self.progress.style(self.json), &note);
        }
    }

    /// What studies compute with, as was asked for.
    fn with_bench<T>(
        &self,
        capture: Option<&Path>,
        err: &mut dyn Write,
        work: impl FnOnce(&Bench<'_>) -> T,
    ) -> Result<T, Failure> {
        let scale = match (self.glance, self.full) {
            (true, _) => Scale::Glance,
            (false, true) => Scale::Full,
            (false, false) => Scale::Quick,
        };
        let err = RefCell::new(err);
        let (style, lines) = (self.progress.style(self.json), Lines::default());
        let tell = |message: &str| match style {
            // A message that nobody reads is no failure.
            Style::Bar => {
                let _ = writeln!(err.borrow_mut(), "{message}");
            }
            Style::Lines => lines.tell(&Event::stage(message)),
            Style::Hidden => {}
        };
        if let Some(threads) = self.threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
            // Only the first of a process counts, and a command makes one.
            let _ = pool.build_global();
        }
        let mut bench = Bench::new(scale, &self.captures, stop_on_interrupt()?, &tell);
        bench.threads = self.threads.map_or(bench.threads, usize::from);
        bench.time_limit = self.time_limit;
        bench.capture = capture;
        let real = self.real();
        bench.real = real.as_deref();
        bench.reading = self.reading.options(self.mesh.as_deref());
        Ok(work(&bench))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    fn of(outcome: Outcome, message: &str) -> Failure {
        Failure {
            outcome,
            message: message.to_owned(),
        }
    }

    #[test]
    fn what_is_amiss_decides_the_exit_code_and_is_all_said() {
        let ended = |interrupted, failed: Vec<Failure>, unusable: &[&str]| {
            let unusable = unusable.iter().map(|&line| line.to_owned()).collect();
            let ended = Ended {
                interrupted,
                failed,
                unusable,
            };
            match ended.outcome() {
                Ok(outcome) => (outcome, String::new()),
                Err(failure) => (failure.outcome, failure.message),
            }
        };
        assert_eq!(ended(false, Vec::new(), &[]).0, Outcome::Done);
        assert_eq!(ended(true, Vec::new(), &[]).0, Outcome::Interrupted);
        assert_eq!(
            ended(false, Vec::new(), &["spoon"]),
            (Outcome::BadInput, "spoon".to_owned())
        );
        let both = vec![of(Outcome::BadInput, "a"), of(Outcome::Failed, "b")];
        let (outcome, message) = ended(false, both, &["c"]);
        assert_eq!(
            (outcome, message.as_str()),
            (Outcome::Failed, "a\n  b\n  c")
        );
        assert_eq!(
            ended(true, vec![of(Outcome::Failed, "a")], &[]).0,
            Outcome::Interrupted
        );
    }

    #[test]
    fn the_command_can_be_pasted_and_names_what_the_environment_named() {
        let typed =
            |words: &[&str]| -> Vec<OsString> { words.iter().map(OsString::from).collect() };
        let stop = AtomicBool::new(false);
        let mut bench = Bench::new(Scale::Quick, Path::new("captures"), &stop, &|_| ());
        let words = [
            "/usr/bin/eclipse",
            "study",
            "all",
            "--full",
            "--captures",
            "it's mine",
        ];
        let all = r"eclipse study all --full --captures 'it'\''s mine'";
        assert_eq!(command(&typed(&words), &bench), all);
        bench.real = Some(Path::new("my dino"));
        assert_eq!(
            command(&typed(&words), &bench),
            format!("{all} --real 'my dino'")
        );
        let words = ["eclipse", "study", "real", "--real=x"];
        assert_eq!(
            command(&typed(&words), &bench),
            "eclipse study real --real=x"
        );
    }
}
