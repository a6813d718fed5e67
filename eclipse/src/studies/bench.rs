//! Where studies reconstruct: what they may use, and what was solved already.

use std::{
    cell::RefCell,
    collections::BTreeMap,
    path::{Path, PathBuf},
    rc::Rc,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use super::{
    Scale, StudyError,
    trial::{Solved, Trial, name_of},
};
use crate::{
    capture::{Capture, LoadOptions},
    control::Control,
    reconstruct,
    reconstruction::{Ended, Reconstruction},
    settings::Settings,
};

/// Seconds for a reconstruction of a capture that was given.
const SECONDS: [f64; 2] = [120.0, 600.0];
/// Seeds of the solver.
const SEEDS: [u64; 2] = [1, 3];

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
    /// Threads of a reconstruction.
    pub threads: usize,
    /// Seconds for each reconstruction, in place of the scale's own.
    pub time_limit: Option<f64>,
    /// Set by the caller to end everything.
    pub stop: &'a AtomicBool,
    /// Told what is being done.
    pub tell: &'a dyn Fn(&str),
    solved: RefCell<BTreeMap<String, Rc<Solved>>>,
    trials: RefCell<BTreeMap<PathBuf, Rc<Trial>>>,
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
            threads: Settings::default().threads,
            time_limit: None,
            stop,
            tell,
            solved: RefCell::default(),
            trials: RefCell::default(),
        }
    }

    /// One of two values, by the scale.
    pub fn pick<T>(&self, [quick, full]: [T; 2]) -> T {
        match self.scale {
            Scale::Quick => quick,
            Scale::Full => full,
        }
    }

    /// Seeds of the solver.
    pub fn seeds(&self) -> std::ops::Range<u64> {
        0..self.pick(SEEDS)
    }

    /// Seconds for a reconstruction of a capture that was given.
    pub fn seconds(&self) -> f64 {
        self.time_limit.unwrap_or(self.pick(SECONDS))
    }

    /// What a page says of seeds and time.
    pub fn conditions(&self) -> String {
        let seeds = self.seeds().end;
        let seeds = match seeds {
            1 => "one seed (--full: three)".to_owned(),
            n => format!("{n} seeds"),
        };
        let full = match self.scale {
            Scale::Quick => {
                "The paper's 256 images of 400 x 400 and its hours on eight graphics cards are not repeated here."
            }
            Scale::Full => {
                "The paper has 256 images of 400 x 400, batches of 2^16 pixels, 1024 rays a pixel, two renders, on eight graphics \
                 cards; the captures used are as large as they are."
            }
        };
        format!(
            "The fast preset, {} s for each reconstruction on {} threads, {seeds}. {full} Results depend on the machine's speed, as \
             time ends the work; on a busy machine they are worse.",
            self.seconds(),
            self.threads
        )
    }

    /// The captures of the folder that have a truth with light in it, by name.
    ///
    /// # Errors
    /// No such folder, nothing in it, or a capture that cannot be read.
    pub fn trials(&self) -> Result<Vec<Rc<Trial>>, StudyError> {
        let none = |source| StudyError::Captures {
            path: self.captures.to_owned(),
            source,
        };
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(self.captures).map_err(|error| none(Some(error)))? {
            let path = entry.map_err(|error| none(Some(error)))?.path();
            if path.join("truth/environment.exr").is_file() {
                folders.push(path);
            }
        }
        folders.sort();
        if folders.is_empty() {
            return Err(none(None));
        }
        folders.iter().map(|folder| self.trial(folder)).collect()
    }

    /// The photographs of the capture that was asked for or, without one, of all that have a truth; by name.
    ///
    /// # Errors
    /// As [`trials`](Self::trials).
    pub fn photographs(&self) -> Result<Vec<(String, Rc<Capture>)>, StudyError> {
        if let Some(folder) = self.capture {
            let capture = Capture::load(folder, &LoadOptions::default())?;
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

    fn trial(&self, folder: &Path) -> Result<Rc<Trial>, StudyError> {
        if let Some(trial) = self.trials.borrow().get(folder) {
            return Ok(Rc::clone(trial));
        }
        let trial = Rc::new(Trial::load(folder)?);
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
        let key = format!("{}, occluders {words}, seed {seed}", trial.name);
        if let Some(solved) = self.solved.borrow().get(&key) {
            return Ok(Rc::clone(solved));
        }
        let settings = Settings {
            time_limit: Some(self.seconds()),
            seed,
            occluders,
            ..self.settings(trial)
        };
        let solved = Rc::new(self.reconstructed(trial, &key, &settings)?);
        let mut all = self.solved.borrow_mut();
        all.insert(key, Rc::clone(&solved));
        Ok(solved)
    }

    /// What every reconstruction of a capture has in common: materials are told to be matt where they are.
    pub fn settings(&self, trial: &Trial) -> Settings {
        Settings {
            threads: self.threads,
            lambertian: trial.truth.specular.is_none(),
            ..Settings::default()
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
        let found = pool.install(|| reconstruct::run(capture, settings, &control))?;
        if found.ended == Ended::Interrupted {
            return Err(StudyError::Stopped);
        }
        Ok(found)
    }
}
