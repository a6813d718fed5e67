//! Where studies reconstruct: what they may use, what was solved already, and what they had to do without.

mod budget;

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    rc::Rc,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use self::budget::Budget;
use super::{
    Scale, StudyError,
    evidence::seeds,
    trial::{Solved, Trial, name_of},
};
use crate::{
    capture::{Capture, LoadOptions},
    control::Control,
    reconstruct::{self, ReconstructError},
    reconstruction::{Ended, Reconstruction},
    report::text::number,
    settings::{OccluderPrior, Preset, Settings},
    synthesize::Seen,
};

/// Seeds of the solver: a claim that holds for one may be luck.
const SEEDS: u64 = 3;
/// What a study computes with. Studies that run after one another share what they have solved.
pub struct Bench<'a> {
    /// How much to compute.
    pub scale: Scale,
    /// Folder of captures with their truth.
    pub captures: &'a Path,
    /// One capture that was asked for, with or without a truth.
    pub capture: Option<&'a Path>,
    /// Folder of a capture of real photographs.
    pub real: Option<&'a Path>,
    /// How these two are read; captures with a truth are ours, and say it themselves.
    pub reading: LoadOptions,
    /// Threads of a reconstruction.
    pub threads: usize,
    /// Seconds for each reconstruction, in place of the scale's own.
    pub time_limit: Option<f64>,
    /// Set by the caller to end everything.
    pub stop: &'a AtomicBool,
    /// Told what is being done.
    pub tell: &'a dyn Fn(&str),
    /// What the cameras of the last capture of our own see of its object: the next one often has the same.
    pub(super) seen: RefCell<Seen>,
    budget: Budget,
    solved: RefCell<BTreeMap<String, Rc<Solved>>>,
    trials: RefCell<BTreeMap<PathBuf, Rc<Trial>>>,
    lacks: RefCell<Lacks>,
    /// Everything that any study has left out.
    unusable: RefCell<BTreeSet<String>>,
}

/// What a study had to do without.
#[derive(Debug, Default)]
pub(super) struct Lacks {
    /// Captures that could not be used, each with the reason.
    pub unusable: Vec<String>,
    /// Whether the caller's stop kept it from a part of its work.
    pub cut: bool,
}

/// Whether a folder is a capture that can be scored.
fn has_truth(folder: &Path) -> bool {
    folder.join("truth/environment.exr").is_file()
}

/// The folder that a folder lies in, also where it is `.`.
fn parent(folder: &Path) -> PathBuf {
    match folder.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        // A name alone lies here; `.` and `..` have none.
        Some(_) if folder.file_name().is_some() => PathBuf::from("."),
        _ => folder.join(".."),
    }
}

impl<'a> Bench<'a> {
    /// A bench on which nothing has been solved.
    pub fn new(
        scale: Scale,
        captures: &'a Path,
        stop: &'a AtomicBool,
        tell: &'a dyn Fn(&str),
    ) -> Self {
        Self {
            scale,
            captures,
            capture: None,
            real: None,
            reading: LoadOptions::default(),
            threads: Settings::default().threads,
            time_limit: None,
            stop,
            tell,
            seen: RefCell::default(),
            budget: Budget::start(),
            solved: RefCell::default(),
            trials: RefCell::default(),
            lacks: RefCell::default(),
            unusable: RefCell::default(),
        }
    }

    /// One of two values, by the scale, where a glance costs no less than a quick look.
    pub fn pick<T>(&self, [quick, full]: [T; 2]) -> T {
        match self.scale {
            Scale::Glance | Scale::Quick => quick,
            Scale::Full => full,
        }
    }

    /// One of three values, by the scale.
    pub fn of_scale<T>(&self, [glance, quick, full]: [T; 3]) -> T {
        match self.scale {
            Scale::Glance => glance,
            Scale::Quick => quick,
            Scale::Full => full,
        }
    }

    /// Seeds of the solver.
    pub fn seeds(&self) -> std::ops::Range<u64> {
        0..self.of_scale([1, SEEDS, SEEDS])
    }

    /// Seconds for a reconstruction of a capture that was given. Quick ones share an hour or so among them.
    pub fn seconds(&self) -> f64 {
        let limits = || {
            let captures = self.folders().map_or(0, |folders| folders.len());
            budget::limits(captures, self.real.is_some(), SEEDS)
        };
        let usual = || self.budget.seconds(self.scale, limits);
        self.time_limit.unwrap_or_else(usual)
    }

    /// What a page says of seeds and time.
    pub fn conditions(&self) -> String {
        let seeds = seeds(self.seeds().end);
        let full = match self.scale {
            Scale::Glance | Scale::Quick => {
                "The paper's 256 images of 400 x 400 and its hours on eight graphics cards are not repeated here."
            }
            Scale::Full => "The captures used are as large as they are.",
        };
        format!(
            "The fast preset, {} s for each reconstruction on {} threads, {seeds} of the solver with the same photographs. {full} Results depend on the machine's speed, as \
             time ends the work; on a busy machine they are worse.",
            number(self.seconds()),
            self.threads
        )
    }

    /// The folders of captures with light in their truth, by name.
    fn folders(&self) -> Result<Vec<PathBuf>, StudyError> {
        let none = |source| StudyError::Captures {
            path: self.captures.to_owned(),
            hint: match has_truth(self.captures) {
                true => format!(
                    ": it is a capture itself, and --captures takes the folder that it lies in, {}",
                    parent(self.captures).display()
                ),
                false => "; name their folder with --captures".to_owned(),
            },
            source,
        };
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(self.captures).map_err(|error| none(Some(error)))? {
            let path = entry.map_err(|error| none(Some(error)))?.path();
            if has_truth(&path) {
                folders.push(path);
            }
        }
        folders.sort();
        match folders.is_empty() {
            true => Err(none(None)),
            false => Ok(folders),
        }
    }

    /// The captures of the folder that have a truth with light in it, by name. Those that cannot be used are left out and told.
    ///
    /// # Errors
    /// No such folder, nothing in it, or no capture that can be used.
    pub fn trials(&self) -> Result<Vec<Rc<Trial>>, StudyError> {
        let (mut trials, mut problem) = (Vec::new(), None);
        for folder in self.folders()? {
            match self.trial(&folder) {
                Ok(trial) => trials.push(trial),
                Err(error) => {
                    self.leave_out(&name_of(&folder), &error);
                    problem.get_or_insert(error);
                }
            }
        }
        match problem {
            Some(error) if trials.is_empty() => Err(error),
            _ => Ok(trials),
        }
    }

    /// The photographs of the capture that was asked for or, without one, of all that have a truth; by name.
    ///
    /// # Errors
    /// As [`trials`](Self::trials); of the capture that was asked for also known lamps, which leave no light to recover.
    pub fn photographs(&self) -> Result<Vec<(String, Rc<Capture>)>, StudyError> {
        if let Some(folder) = self.capture {
            let capture = Capture::load(folder, &self.reading)?;
            reconstruct::check_light(&capture)?;
            return Ok(vec![(name_of(folder), Rc::new(capture))]);
        }
        let trials = self.trials()?;
        let photographs = trials.iter();
        Ok(photographs
            .map(|trial| (trial.name.clone(), Rc::clone(&trial.capture)))
            .collect())
    }

    /// Whether the caller asked for the end.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// What `work` makes of one after the other. After the caller's stop it is what was made until then.
    ///
    /// # Errors
    /// Whatever `work` fails with, and the stop where nothing was made.
    pub fn each<T, R>(
        &self,
        of: impl IntoIterator<Item = T>,
        mut work: impl FnMut(T) -> Result<R, StudyError>,
    ) -> Result<Vec<R>, StudyError> {
        let mut made = Vec::new();
        for one in of {
            let result = match self.stopped() {
                true => Err(StudyError::Stopped),
                false => work(one),
            };
            match result {
                Ok(result) => made.push(result),
                Err(StudyError::Stopped) if !made.is_empty() => {
                    self.lacks.borrow_mut().cut = true;
                    break;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(made)
    }

    /// The same of captures; those that turn out to be of no use are left out and told.
    ///
    /// # Errors
    /// As [`each`](Self::each), but for what is to blame on a capture.
    pub fn each_trial<R>(
        &self,
        trials: &[Rc<Trial>],
        work: impl FnMut(&Rc<Trial>) -> Result<R, StudyError>,
    ) -> Result<Vec<R>, StudyError> {
        self.each_capture(trials, |trial| &trial.name, work)
    }

    /// The same of captures in whatever form that has a name.
    ///
    /// # Errors
    /// As [`each_trial`](Self::each_trial).
    pub fn each_capture<T, R>(
        &self,
        captures: &[T],
        name: impl Fn(&T) -> &str,
        mut work: impl FnMut(&T) -> Result<R, StudyError>,
    ) -> Result<Vec<R>, StudyError> {
        let made = self.each(captures, |capture| match work(capture) {
            Err(error) if error.is_of_the_input() => {
                self.leave_out(name(capture), &error);
                Ok(None)
            }
            result => result.map(Some),
        })?;
        Ok(made.into_iter().flatten().collect())
    }

    /// Why a study has nothing to say: the caller's stop where there was one, else that nothing is there of what it `needs`.
    pub fn nothing(&self, needs: &'static str) -> StudyError {
        match self.stopped() {
            true => StudyError::Stopped,
            false => StudyError::Nothing(needs),
        }
    }

    /// Captures that could not be used until now, each with the reason.
    pub fn unusable(&self) -> Vec<String> {
        self.unusable.borrow().iter().cloned().collect()
    }

    /// Notes that the caller's stop kept a study from a part of its work.
    pub(super) fn note_cut(&self) {
        self.lacks.borrow_mut().cut = true;
    }

    /// What was lacking since the last call.
    pub(super) fn take_lacks(&self) -> Lacks {
        self.lacks.take()
    }

    fn leave_out(&self, name: &str, error: &StudyError) {
        let line = format!("{name}, which cannot be used ({error})");
        if self.unusable.borrow_mut().insert(line.clone()) {
            (self.tell)(&format!("left out: {line}"));
        }
        self.lacks.borrow_mut().unusable.push(line);
    }

    fn trial(&self, folder: &Path) -> Result<Rc<Trial>, StudyError> {
        if let Some(trial) = self.trials.borrow().get(folder) {
            return Ok(Rc::clone(trial));
        }
        let trial = Rc::new(Trial::load(folder)?);
        reconstruct::check_light(&trial.capture)?;
        let mut trials = self.trials.borrow_mut();
        trials.insert(folder.to_owned(), Rc::clone(&trial));
        Ok(trial)
    }

    /// The reconstruction of a capture with or without occluders in the model; materials are told to be matt where they are.
    ///
    /// # Errors
    /// A capture that cannot be reconstructed, or the caller's stop.
    pub fn solve(
        &self,
        trial: &Trial,
        occluders: bool,
        seed: u64,
    ) -> Result<Rc<Solved>, StudyError> {
        let words = if occluders {
            "modelled"
        } else {
            "not modelled"
        };
        self.shared(trial, words, seed, |usual| Settings { occluders, ..usual })
    }

    /// The same with nothing assumed of occluders: masks are free in every direction.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn solve_anywhere(&self, trial: &Trial, seed: u64) -> Result<Rc<Solved>, StudyError> {
        self.shared(trial, "anywhere", seed, |usual| Settings {
            occluder_prior: OccluderPrior::None,
            ..usual
        })
    }

    /// A reconstruction in the usual time that is made once for all studies; `words` tell which of a capture's it is.
    fn shared(
        &self,
        trial: &Trial,
        words: &str,
        seed: u64,
        with: impl FnOnce(Settings) -> Settings,
    ) -> Result<Rc<Solved>, StudyError> {
        let key = format!("{}, occluders {words}, seed {seed}", trial.name);
        if let Some(solved) = self.solved.borrow().get(&key) {
            return Ok(Rc::clone(solved));
        }
        let settings = with(Settings {
            time_limit: Some(self.seconds()),
            seed,
            ..self.settings(trial)
        });
        let solved = Rc::new(self.reconstructed(trial, &key, &settings)?);
        let mut all = self.solved.borrow_mut();
        all.insert(key, Rc::clone(&solved));
        Ok(solved)
    }

    /// What every reconstruction of a capture has in common: materials are told to be matt where they are.
    pub fn settings(&self, trial: &Trial) -> Settings {
        self.settings_of(Preset::Fast, trial)
    }

    /// The same of an algorithm.
    pub fn settings_of(&self, preset: Preset, trial: &Trial) -> Settings {
        Settings {
            threads: self.threads,
            lambertian: trial.truth.specular.is_none(),
            ..Settings::of(preset)
        }
    }

    /// A capture's reconstruction with these settings; `words` tell which it is.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn reconstructed(
        &self,
        trial: &Trial,
        words: &str,
        settings: &Settings,
    ) -> Result<Solved, StudyError> {
        let began = Instant::now();
        let solved = Solved::new(self.run(&trial.capture, settings)?, trial)?;
        (self.tell)(&format!(
            "{words}: environment {:.3}, {:.0} s",
            solved.environment_error(),
            began.elapsed().as_secs_f64(),
        ));
        Ok(solved)
    }

    /// The reconstruction of photographs without a truth.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn run(
        &self,
        capture: &Capture,
        settings: &Settings,
    ) -> Result<Reconstruction, StudyError> {
        let control = Control {
            stop: self.stop,
            ..Control::detached()
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(settings.threads)
            .build()?;
        match pool.install(|| reconstruct::run(capture, settings, &control)) {
            Err(ReconstructError::Interrupted) => Err(StudyError::Stopped),
            Ok(found) if found.ended == Ended::Interrupted => Err(StudyError::Stopped),
            found => Ok(found?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bench of this scale over a folder of so many captures, as far as their number goes.
    fn with_bench(scale: Scale, captures: usize, test: impl FnOnce(Bench<'_>)) {
        let folder = tempfile::tempdir().unwrap();
        for index in 0..captures {
            let truth = folder.path().join(format!("{index}/truth"));
            std::fs::create_dir_all(&truth).unwrap();
            std::fs::write(truth.join("environment.exr"), "no image").unwrap();
        }
        let stop = AtomicBool::new(false);
        test(Bench::new(scale, folder.path(), &stop, &|_| ()));
    }

    #[test]
    fn quick_solves_share_their_time_and_no_other_does() {
        with_bench(Scale::Quick, 1, |mut bench| {
            assert_eq!(bench.seconds(), 120.0);
            bench.time_limit = Some(7.0);
            assert_eq!(bench.seconds(), 7.0);
        });
        with_bench(Scale::Quick, 4, |bench| {
            let alone = bench.seconds();
            assert!((98.0..102.0).contains(&alone), "{alone}");
            // Solves are shared: what the first was given, all are.
            assert_eq!(bench.seconds(), alone);
        });
        with_bench(Scale::Quick, 4, |mut bench| {
            bench.real = Some(Path::new("real"));
            let with_real = bench.seconds();
            assert!((78.0..82.0).contains(&with_real), "{with_real}");
        });
        with_bench(Scale::Full, 40, |bench| assert_eq!(bench.seconds(), 600.0));
    }

    #[test]
    fn a_stop_keeps_what_was_made() {
        with_bench(Scale::Quick, 0, |bench| {
            let made = bench.each(0..5, |k| match k {
                3 => Err(StudyError::Stopped),
                _ => Ok(k),
            });
            assert_eq!(made.unwrap(), [0, 1, 2]);
            assert!(bench.take_lacks().cut && !bench.take_lacks().cut);
            let nothing: Result<Vec<u8>, _> = bench.each(0..5, |_| Err(StudyError::Stopped));
            assert!(matches!(nothing, Err(StudyError::Stopped)));
            assert!(!bench.take_lacks().cut);
        });
    }

    #[test]
    fn captures_that_cannot_be_read_are_told_once_and_noted_for_every_study() {
        with_bench(Scale::Quick, 2, |bench| {
            for _ in 0..2 {
                let error = bench.trials().err().unwrap();
                assert!(error.is_of_the_input(), "{error}");
                assert_eq!(bench.take_lacks().unusable.len(), 2);
            }
            let told = bench.unusable();
            assert_eq!(told.len(), 2);
            assert!(told[0].starts_with("0, which cannot be used ("), "{told:?}");
        });
    }
}
