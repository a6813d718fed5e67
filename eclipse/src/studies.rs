//! The paper's evidence, made anew: each study repeats one of its experiments, says whether the claim held, and leaves the data.
//!
//! One study is one file and one entry of [`all`]. A study returns its [`Evidence`]; [`page::write`] alone knows of files.

mod ambiguity;
mod conditioning;
pub mod evidence;
pub mod flatland;
pub mod page;
mod plot;
pub mod spectrum;
mod sphere;
mod theory;

use crate::image_io::ImageIoError;

pub use evidence::{Evidence, Verdict};

/// How much a study computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// What settles the claim in minutes on two cores.
    #[default]
    Quick,
    /// The paper's numbers.
    Full,
}

/// One experiment.
pub trait Study: Sync {
    /// How it is called on the command line.
    fn name(&self) -> &'static str;

    /// Computes everything; the same for the same scale on any day.
    ///
    /// # Errors
    /// A computation that does not converge, or a file that cannot be read.
    fn run(&self, scale: Scale) -> Result<Evidence, StudyError>;
}

/// Every study that needs no other input, in the paper's order.
pub fn all() -> &'static [&'static dyn Study] {
    &[
        &ambiguity::Ambiguity,
        &conditioning::Conditioning,
        &theory::Theory,
    ]
}

/// The study of this name.
pub fn by_name(name: &str) -> Option<&'static dyn Study> {
    all().iter().copied().find(|study| study.name() == name)
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
