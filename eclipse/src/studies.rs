//! The paper's evidence, made anew and extended: each study repeats one of its experiments or asks what it leaves open, says whether the
//! claim held, and leaves the data.
//!
//! One study is one file and one entry of [`all`]. A study returns its [`Evidence`]; [`page::write`] alone knows of files.

mod ambiguity;
pub mod bench;
mod conditioning;
pub mod evidence;
pub mod flatland;
mod lambertian;
mod limit;
mod masks;
pub mod page;
mod parametrisation;
mod plot;
mod ranks;
mod real;
mod recovery;
mod relighting;
mod shiny;
pub mod small;
pub mod spectrum;
mod sphere;
mod sweeps;
mod theory;
mod time;
pub mod trial;
mod uncertainty;

use std::path::PathBuf;

use rayon::ThreadPoolBuildError;

use crate::{
    capture::CaptureError, evaluate::EvaluateError, files::lock::LockError, image_io::ImageIoError,
    reconstruct::ReconstructError, synthesize::SynthesizeError,
};

pub use bench::Bench;
pub use evidence::{Evidence, Verdict};

/// How much a study computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Whether everything runs, in seconds: one seed, tiny captures, a step or two. No claim is judged by it.
    Glance,
    /// What settles the claim in minutes on two cores.
    #[default]
    Quick,
    /// The paper's numbers where they take minutes; what they would take elsewhere, every page says.
    Full,
}

/// Runs a study; its sentence then also says what it had to do without: captures that could not be used, and whatever the
/// caller's stop kept it from.
///
/// # Errors
/// As [`Study::run`].
pub fn run(study: &dyn Study, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
    bench.take_lacks();
    let mut evidence = study.run(bench)?;
    let lacks = bench.take_lacks();
    if !lacks.unusable.is_empty() {
        evidence.sentence += &format!(" Left out: {}.", lacks.unusable.join("; "));
    }
    if lacks.cut {
        evidence.sentence += " Interrupted: what had not been computed by then is missing.";
        // What is missing might have failed.
        if evidence.verdict == Verdict::Held {
            evidence.verdict = Verdict::HeldInPart;
        }
    }
    if bench.scale == Scale::Glance && evidence.verdict != Verdict::NotTested {
        evidence.sentence += " Computed at a glance, which settles nothing.";
        evidence.verdict = Verdict::NotTested;
    }
    if bench.scale == Scale::Full {
        evidence.notes.push(PAPERS_SCALE.to_owned());
    }
    Ok(evidence)
}

/// Where captures with their truth lie in this project, which is looked for where none are named.
pub const CAPTURES: &str = "tests/captures";

/// What the paper's own scale is and would take, by rates of `render`'s example `rates` on two cores of a server.
const PAPERS_SCALE: &str = "The paper's scale is 256 images of 400 x 400, batches of 2^16 pixels and 1024 rays from each in two renders, on \
    eight graphics cards: 1.3e8 rays an iteration. On two cores this program draws 4 to 5 million rays a second where they are cast and 9 to \
    11 million where visibility is cached, 12 to 34 seconds an iteration, so that ten thousand take one and a half to four days; the images \
    alone take 0.7 GB. Reconstructions are given ten minutes each instead, of captures as large as they are.";

/// One experiment.
pub trait Study: Sync {
    /// How it is called on the command line.
    fn name(&self) -> &'static str;

    /// Computes everything; the same for the same scale on any day, but for reconstructions, which a time limit ends. After the
    /// caller's stop it is what was found until then. Call it by [`run`], which says so.
    ///
    /// # Errors
    /// A computation that does not converge, no capture that can be read, or the caller's stop before anything was found.
    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError>;
}

/// Every study: those that reconstruct nothing, those that make small captures of their own, those of captures that are given.
pub fn all() -> &'static [&'static dyn Study] {
    &[
        &ambiguity::Ambiguity,
        &conditioning::Conditioning,
        &theory::Theory,
        &limit::InformationLimit,
        &uncertainty::Uncertain,
        &parametrisation::Parametrisation,
        &shiny::Shiny,
        &sweeps::Sweeps,
        &recovery::Recovery,
        &lambertian::Lambertian,
        &masks::Masks,
        &relighting::Relighting,
        &time::Time,
        &real::Real,
    ]
}

/// The study of this name.
pub fn by_name(name: &str) -> Option<&'static dyn Study> {
    all().iter().copied().find(|study| study.name() == name)
}

impl StudyError {
    /// Whether the captures are to blame and not the work.
    pub fn is_of_the_input(&self) -> bool {
        match self {
            Self::Captures { .. }
            | Self::Nothing(_)
            | Self::NoLight(_)
            | Self::Capture(_)
            | Self::Mesh(_)
            | Self::Evaluate(_) => true,
            Self::Reconstruct(error) => error.is_of_the_input(),
            _ => false,
        }
    }
}

/// Why a study has no result.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The iteration that finds singular values.
    #[error(
        "the singular values of a {rows} x {columns} matrix did not converge; its entries may not be finite"
    )]
    Singular {
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// The folder of captures.
    #[error(
        "no captures with truth/environment.exr in {}{}{hint}",
        path.display(),
        source.as_ref().map_or_else(String::new, |error| format!(" ({error})"))
    )]
    Captures {
        /// The folder.
        path: PathBuf,
        /// What to do.
        hint: String,
        /// Why it could not be listed, if so.
        source: Option<std::io::Error>,
    },
    /// Captures, but none that the study is about.
    #[error("the folder of captures holds none that this study needs: {0}")]
    Nothing(&'static str),
    /// A truth without light.
    #[error("the truth of {0} has no environment.exr")]
    NoLight(String),
    /// A capture that cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A mesh that cannot be traced.
    #[error(transparent)]
    Mesh(#[from] render::mesh::MeshError),
    /// A scene that cannot be photographed.
    #[error(transparent)]
    Synthesize(#[from] SynthesizeError),
    /// A capture that cannot be reconstructed.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// Another run writes to the study's folder.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A truth that does not fit.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// Threads.
    #[error("cannot start threads: {0}")]
    Threads(#[from] ThreadPoolBuildError),
    /// The caller asked for the end.
    #[error("interrupted; what had been found is written")]
    Stopped,
    /// A plot.
    #[error("cannot draw {name}: {reason}")]
    Plot {
        /// Which.
        name: String,
        /// Why.
        reason: String,
    },
    /// A folder or file of the results.
    #[error(
        "cannot write the study: {0}; check that the folder may be written and the disk is not full"
    )]
    Write(#[from] std::io::Error),
    /// An image.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// A summary that JSON cannot hold.
    #[error("cannot write the summary: {0}")]
    Json(#[from] serde_json::Error),
}
