//! Scores of the Stanford-ORB benchmark (Kuang et al., NeurIPS 2023), as its scripts compute them.
//!
//! Photographs are high dynamic range, 512 × 512 after area averaging; predictions must have that size. Masks are averaged with
//! them, cut at ½ and shrunk by two pixels. A prediction is scaled by the best factor of each channel, everything outside the
//! mask is black and counts. PSNR-H compares linear values up to 4 after both are brightened as the photograph would be by the
//! sRGB curve on average; PSNR-L compares sRGB-encoded values up to 1; SSIM takes the images of PSNR-L. A prediction never scores
//! less than even grey. LPIPS, which needs a trained network, is left out.

mod layout;
mod similarity;
mod ssim;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::{capture::CaptureError, image_io::ImageIoError};

pub use layout::{Split, View, views};
pub use similarity::{RESOLUTION, Scale, similarity};

/// Scores of one view, or their mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Similarity {
    /// PSNR of linear values, in decibels; infinite for a perfect prediction.
    pub psnr_h: f64,
    /// PSNR of sRGB-encoded values, in decibels.
    pub psnr_l: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
}

/// Scores of all views of a split.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StanfordOrbScore {
    /// The mean over views: what the benchmark's tables hold.
    pub mean: Similarity,
    /// Each view, by its name.
    pub views: Vec<(String, Similarity)>,
}

/// Scores the predictions in `folder` against the photographs of `split` in the benchmark's folder `scene`.
///
/// A prediction has the name of its view (`0003.exr`, linear, or `0003.png`, sRGB); where the split spans several scenes those of
/// each lie in a folder of its name.
///
/// # Errors
/// [`StanfordOrbError`]: a prediction that is missing, of another size, or holds values that are no radiance; a scene that lacks
/// what the layout promises.
pub fn score(
    folder: &Path,
    scene: &Path,
    split: Split,
    scale: Scale,
) -> Result<StanfordOrbScore, StanfordOrbError> {
    let mut scored = Vec::new();
    for view in views(scene, split)? {
        let prediction = layout::prediction(folder, &view)?;
        let (photograph, mask) = layout::photograph(&view)?;
        let similarity = similarity(&prediction, &photograph, &mask, scale);
        scored.push((view.name, similarity));
    }
    let mean = |value: fn(&Similarity) -> f64| {
        scored.iter().map(|(_, s)| value(s)).sum::<f64>() / scored.len() as f64
    };
    Ok(StanfordOrbScore {
        mean: Similarity {
            psnr_h: mean(|s| s.psnr_h),
            psnr_l: mean(|s| s.psnr_l),
            ssim: mean(|s| s.ssim),
        },
        views: scored,
    })
}

/// Why predictions could not be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StanfordOrbError {
    /// The scene's description cannot be read.
    #[error(transparent)]
    Scene(#[from] CaptureError),
    /// The scene has no views of that split.
    #[error("{} has no frames of {wanted}: name another split, or another scene", path.display())]
    NoViews {
        /// The file that lists the frames.
        path: PathBuf,
        /// What was asked for.
        wanted: String,
    },
    /// A name that leads out of the benchmark's folder, or to nothing.
    #[error(
        "{}: `{field}` is {name:?}; expected a path of folders' and files' own names that stays in the benchmark's folder, such as \
         test/0003 or cup_scene002: correct it, or take the benchmark's own file", path.display()
    )]
    Outside {
        /// The file that lists the frames.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// What it holds.
        name: String,
    },
    /// A file that the layout promises is not there.
    #[error("{what} of view {view:?} is missing: expected {}; {remedy}", path.display())]
    Missing {
        /// Which file.
        what: &'static str,
        /// Of which view.
        view: String,
        /// Where it should be.
        path: PathBuf,
        /// What to do.
        remedy: &'static str,
    },
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// An image of a size that the benchmark does not allow.
    #[error("{} is {width} × {height}; expected {expected}: {remedy}", path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// The size expected.
        expected: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A value that is no radiance.
    #[error("{}: the pixel in column {x} of row {y} is {value}; radiance must be finite and not negative: clamp it", path.display())]
    Radiance {
        /// The file.
        path: PathBuf,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// The value.
        value: f32,
    },
}
