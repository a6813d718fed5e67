//! `eclipse study nulls`: how often a diagnosis gives a name to what has none.

use std::{
    collections::{BTreeMap, BTreeSet},
    io::Write,
    path::{Path, PathBuf},
};

use clap::Args;
use serde::Serialize;

use super::{
    Failure, Outcome,
    cases::{CaseArguments, Ended},
    diagnose, shown, stop_on_interrupt, taken, units,
};
use crate::{
    capture::{Capture, LoadOptions},
    criticism::{
        nulls::{self, Kind},
        study_scores::{Case, OUTSIDE},
    },
    files::lock::Lock,
    progress::Style,
    synthesize,
};

#[derive(Args, Debug)]
pub(super) struct NullsArguments {
    /// Captures in which no effect is missing [default: synthesised ones].
    pub captures: Vec<PathBuf>,
    /// How many bases to synthesise where no capture is given: other bodies, light and materials for each.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub scenes: u64,
    /// Seed of the first synthesised base.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true, value_parser = units::at_least::<0>)]
    pub seed: u64,
    /// What to derive from each base [default: all of plain, more_noise, fine_texture, coarse_mesh; banding, flash, ghost, lens_distortion, stain].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub structures: Vec<String>,
    /// Folder for the captures, a page for each and scores.json.
    #[arg(long, value_name = "DIR", default_value = "out/nulls")]
    pub out: PathBuf,
    #[command(flatten)]
    pub cases: CaseArguments,
}

/// What the study found.
#[derive(Serialize)]
struct Found {
    /// Share of plain nulls (and noisier ones) in which physics was named; absent without any.
    false_alarm_rate_plain: Option<f64>,
    /// The same of nulls with structure finer than the model.
    false_alarm_rate_structured: Option<f64>,
    /// Share of plain nulls (and noisier ones) with any verdict but *nothing missing* and *underpowered*: something is said to be missing,
    /// be it named or not.
    any_alarm_rate_plain: Option<f64>,
    /// The same of nulls with structure finer than the model.
    any_alarm_rate_structured: Option<f64>,
    /// Share of captures with physics outside the table in which no effect was named.
    abstains: Option<f64>,
    /// By what was derived: named, of how many.
    by_structure: BTreeMap<&'static str, [usize; 2]>,
    /// By what was derived: said to lack something, be it named or not, of how many.
    any_alarm_by_structure: BTreeMap<&'static str, [usize; 2]>,
    cases: Vec<Case>,
}

pub(super) fn run(
    arguments: &NullsArguments,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let structures = chosen(&arguments.structures)?;
    let names: Vec<String> = arguments.captures.iter().map(|base| name(base)).collect();
    distinct(&names)?;
    let stop = stop_on_interrupt()?;
    let _lock = taken(&arguments.out)?;
    let style = arguments.cases.progress.style(false);
    let (mut cases, mut counts) = (Vec::new(), Counts::default());
    let mut ended = Ended::default();
    let Some(bases) = bases(arguments, stop)? else {
        return Ok(Outcome::Interrupted);
    };
    'all: for base in &bases {
        for structure in &structures {
            let name = format!("{}-{}", name(base), structure.id());
            let folder = arguments.out.join("captures").join(&name);
            let page = arguments.out.join(&name);
            let job = arguments.cases.job(&folder, None, Some(&page));
            let diagnosed = derive(base, *structure, &folder)
                .and_then(|()| diagnose::diagnose(&job, stop, &mut |_| Ok(())));
            let diagnosis = match diagnosed {
                Ok(Some(diagnosis)) => diagnosis,
                Ok(None) => {
                    ended.interrupted = true;
                    break 'all;
                }
                Err(failure) => {
                    ended.fail(&name, failure, style, err);
                    continue;
                }
            };
            let truth: Vec<String> = match structure.kind() {
                Kind::Outside => vec![OUTSIDE.to_owned()],
                Kind::Plain | Kind::Structured => Vec::new(),
            };
            let case = Case::new(&name, &truth, &diagnosis, None);
            if style == Style::Bar {
                let _ = writeln!(err, "{}", case.line());
            }
            counts.add(structure.id(), &case);
            cases.push(case);
            ended.diagnosed += 1;
        }
    }
    let found = Found::new(counts, cases);
    let folder = Some(arguments.out.as_path());
    arguments.cases.end(out, folder, &found, Found::text, ended)
}

/// What is derived from a base is called by its folder's name.
fn name(base: &Path) -> String {
    // A path such as `..` has none of its own.
    let whole = match base.file_name() {
        Some(_) => base.to_owned(),
        None => base.canonicalize().unwrap_or_else(|_| base.to_owned()),
    };
    let name = whole.file_name().unwrap_or("base".as_ref());
    name.to_string_lossy().into_owned()
}

/// Refuses bases of one name: what is derived from them would have one place.
fn distinct(names: &[String]) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    match names.iter().find(|name| !seen.insert(*name)) {
        None => Ok(()),
        Some(name) => Err(Failure::bad_input(format!(
            "two of the captures are called {name:?}; give each another name, or run the study on them apart"
        ))),
    }
}

/// Leaves in `folder` what `structure` makes of the capture `base`.
fn derive(base: &Path, structure: &dyn nulls::Structure, folder: &Path) -> Result<(), Failure> {
    let base = Capture::load(base, &LoadOptions::default()).map_err(Failure::bad_input)?;
    let _lock = Lock::beside(folder).map_err(Failure::failed)?;
    nulls::derive_into(folder, base, structure).map_err(Failure::failed)
}

fn chosen(names: &[String]) -> Result<Vec<&'static dyn nulls::Structure>, Failure> {
    let all = nulls::all();
    if let Some(name) = names.iter().find(|n| !all.iter().any(|s| s.id() == **n)) {
        let known: Vec<&str> = all.iter().map(|s| s.id()).collect();
        return Err(Failure::bad_input(format!(
            "there is no null called `{name}`; expected {}",
            known.join(", ")
        )));
    }
    let wanted = |id: &str| names.is_empty() || names.iter().any(|n| n == id);
    Ok(all.into_iter().filter(|s| wanted(s.id())).collect())
}

/// The captures to derive from, synthesised where none is given; nothing when interrupted.
fn bases(
    arguments: &NullsArguments,
    stop: &std::sync::atomic::AtomicBool,
) -> Result<Option<Vec<PathBuf>>, Failure> {
    if !arguments.captures.is_empty() {
        return Ok(Some(arguments.captures.clone()));
    }
    let mut made = Vec::new();
    for seed in arguments.seed..arguments.seed.saturating_add(arguments.scenes) {
        let folder: PathBuf = arguments.out.join("bases").join(format!("scene-{seed}"));
        if !is_filled(&folder) {
            let _lock = Lock::beside(&folder).map_err(Failure::failed)?;
            shown::tell(arguments.cases.progress.style(false))(&format!("rendering scene {seed}"));
            let (scene, shooting) = nulls::scenes::scene(seed);
            let go_on = |_| !stop.load(std::sync::atomic::Ordering::Relaxed);
            let photographs = match synthesize::synthesize(&scene, &shooting, go_on) {
                Ok(photographs) => photographs,
                Err(synthesize::SynthesizeError::Stopped) => return Ok(None),
                Err(error) => return Err(Failure::failed(error)),
            };
            synthesize::write(&folder, &scene, &photographs).map_err(Failure::failed)?;
        }
        made.push(folder);
    }
    Ok(Some(made))
}

fn is_filled(folder: &Path) -> bool {
    folder.join("transforms.json").is_file()
}

/// How many of all that was derived alike.
#[derive(Default)]
struct Counts {
    named: BTreeMap<&'static str, [usize; 2]>,
    alarms: BTreeMap<&'static str, [usize; 2]>,
}

impl Counts {
    fn add(&mut self, structure: &'static str, case: &Case) {
        let of_both = [
            (&mut self.named, !case.found.is_empty()),
            (&mut self.alarms, case.alarms()),
        ];
        for (counts, hit) in of_both {
            let [hits, all] = counts.entry(structure).or_insert([0, 0]);
            *hits += usize::from(hit);
            *all += 1;
        }
    }
}

impl Found {
    fn new(counts: Counts, cases: Vec<Case>) -> Self {
        let rate = |counts: &BTreeMap<&'static str, [usize; 2]>, kind: Kind| {
            let is = |id: &str| {
                nulls::all()
                    .iter()
                    .any(|s| s.id() == id && s.kind() == kind)
            };
            let own = counts.iter().filter(|(id, _)| is(id));
            let [hits, all] = own.fold([0, 0], |sum, (_, n)| [sum[0] + n[0], sum[1] + n[1]]);
            (all > 0).then(|| hits as f64 / all as f64)
        };
        Self {
            false_alarm_rate_plain: rate(&counts.named, Kind::Plain),
            false_alarm_rate_structured: rate(&counts.named, Kind::Structured),
            any_alarm_rate_plain: rate(&counts.alarms, Kind::Plain),
            any_alarm_rate_structured: rate(&counts.alarms, Kind::Structured),
            abstains: rate(&counts.named, Kind::Outside).map(|named| 1.0 - named),
            by_structure: counts.named,
            any_alarm_by_structure: counts.alarms,
            cases,
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        for (id, [named, all]) in &self.by_structure {
            text += &format!("{id:15} an effect named in {named} of {all}\n");
        }
        for (what, rate) in [
            ("false alarms on plain nulls", self.false_alarm_rate_plain),
            (
                "false alarms on structured nulls",
                self.false_alarm_rate_structured,
            ),
            (
                "plain nulls said to lack something, named or not",
                self.any_alarm_rate_plain,
            ),
            (
                "structured nulls said to lack something, named or not",
                self.any_alarm_rate_structured,
            ),
            ("abstains outside the table", self.abstains),
        ] {
            if let Some(rate) = rate {
                text += &format!("{what}: {:.0} %\n", 100.0 * rate);
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::criticism::{Diagnosis, Verdict};

    #[test]
    fn what_is_said_to_lack_something_counts_whether_it_is_named_or_not() {
        let case = |verdict| Case::new("some", &[], &Diagnosis::example(verdict, Vec::new()), None);
        let mut counts = Counts::default();
        counts.add("plain", &case(Verdict::NothingMissing));
        counts.add("plain", &case(Verdict::Unexplained));
        counts.add("fine_texture", &case(Verdict::Underpowered));
        let found = Found::new(counts, Vec::new());
        assert_eq!(found.false_alarm_rate_plain, Some(0.0));
        assert_eq!(found.any_alarm_rate_plain, Some(0.5));
        assert_eq!(found.any_alarm_rate_structured, Some(0.0));
        assert_eq!(found.any_alarm_by_structure["plain"], [1, 2]);
        assert_eq!(found.abstains, None);
        assert!(
            found
                .text()
                .contains("plain nulls said to lack something, named or not: 50 %")
        );
    }
}
