//! How far a reconstruction is from a known truth.
//!
//! Albedo and illumination share a free scale per channel, found here from the environment and undone in the albedo.

pub mod environment;
pub mod materials;
pub mod occluders;
mod read;
pub mod stanford_orb;

pub use read::{estimate, metrics, parse_metrics, parse_specular, truth};

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    capture::CaptureError,
    image_io::{EnvironmentIoError, ImageIoError},
    reconstruction::{Metrics, Photometric},
};

/// Every score, `null` in JSON where there is no truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// The environment map.
    pub environment: EnvironmentScore,
    /// The albedo through the cameras.
    pub albedo: AlbedoScore,
    /// Roughness and specularity through the cameras.
    pub materials: MaterialScore,
    /// The masks of the occluders.
    pub occluders: OccluderScore,
    /// Agreement with the photographs, as the run itself measured it.
    pub photometric: Photometric,
}

/// Errors of the environment map over texels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnvironmentScore {
    /// Each texel counts the same.
    #[serde(flatten)]
    pub texels: MapErrors,
    /// Each texel counts by its solid angle, the best scale included.
    pub solid_angle: MapErrors,
}

/// Errors of an estimated map L̂ against the true L, s being the best scale of each channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapErrors {
    /// RMS(L̂ − L), in units of radiance.
    pub rmse: Option<f64>,
    /// RMS(s·L̂ − L), in units of radiance.
    pub rmse_aligned: Option<f64>,
    /// RMS(s·L̂ − L) / RMS(L).
    pub relative_rmse_aligned: Option<f64>,
    /// ‖s·L̂ − L‖² / ‖L‖².
    pub relative_mse_aligned: Option<f64>,
}

/// Error of the albedo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AlbedoScore {
    /// Decibels against a peak of 1, on object pixels, after dividing by the environment's scale per channel.
    pub psnr_aligned: Option<f64>,
}

/// Errors of the specular parameters on object pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaterialScore {
    /// RMS error of α.
    pub alpha_rmse: Option<f64>,
    /// RMS error of κ.
    pub kappa_rmse: Option<f64>,
}

/// Errors of the masks M̂, pooled over frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OccluderScore {
    /// Σ L|M̂ − M| dω / Σ L(1 − M) dω: 0 is perfect, 1 is what no mask at all scores.
    pub energy_weighted_error: Option<f64>,
    /// Intersection over union of the regions blocked by at least half, weighted by L dω.
    pub iou: Option<f64>,
}

/// Compares the outputs in `folder` with the truth in `truth` (a capture's `truth` folder).
///
/// # Errors
/// A file of `folder` that is missing or unreadable, or whose size does not fit the truth. Absent truth is no error.
pub fn evaluate(folder: &Path, truth: &Path) -> Result<Evaluation, EvaluateError> {
    let estimate = read::estimate(folder)?;
    score(&estimate, &read::truth(truth)?)
}

/// Compares what is in memory.
///
/// # Errors
/// Counts or sizes that do not fit the truth. Absent truth is no error.
pub fn score(estimate: &Estimate, truth: &Truth) -> Result<Evaluation, EvaluateError> {
    let mut evaluation = Evaluation {
        photometric: estimate.metrics.photometric,
        ..Default::default()
    };
    if let Some(environment) = &truth.environment {
        let aligned = environment::compare(&estimate.environment, environment);
        evaluation.environment = aligned.score;
        if let Some(masks) = &truth.occluders {
            evaluation.occluders = occluders::compare(&estimate.occluders, masks, environment)?;
        }
        if !truth.albedo.is_empty() {
            let scale = aligned.scale;
            evaluation.albedo = materials::albedo(&estimate.materials, &truth.albedo, scale)?;
        }
    }
    if let Some(specular) = truth.specular {
        evaluation.materials = materials::specular(&estimate.materials, &truth.albedo, specular)?;
    }
    Ok(evaluation)
}

/// Why a comparison failed.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// An image could not be read.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// A map of light could not be read, or is none.
    #[error(transparent)]
    Environment(#[from] EnvironmentIoError),
    /// What describes the truth's capture could not be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A text file could not be read.
    #[error("cannot read {}: {source}; check that it exists and may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A JSON file does not hold what it should.
    #[error("{} is not as expected: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong where.
        source: serde_json::Error,
    },
    /// Neither folder nor truth.
    #[error("{} holds no truth (environment.exr, occluders.exr, albedo_NNN.exr or truth.json): name a capture's truth folder", path.display())]
    NoTruth {
        /// The folder.
        path: PathBuf,
    },
    /// As many files are needed on both sides.
    #[error(
        "{found} {what} were reconstructed but the truth has {expected}: evaluate against the truth of the capture that was used"
    )]
    Count {
        /// What was counted.
        what: &'static str,
        /// In the truth.
        expected: usize,
        /// In the reconstruction.
        found: usize,
    },
    /// Images that should be compared differ in size.
    #[error(
        "{what} {index:03}: {found} were reconstructed but the truth has {expected}: evaluate against the truth of the capture that was used"
    )]
    Size {
        /// What was compared.
        what: &'static str,
        /// Which frame.
        index: usize,
        /// Width × height × channels in the truth.
        expected: String,
        /// Width × height × channels in the reconstruction.
        found: String,
    },
}

/// What is compared: read from a run's folder, or fresh from the solver. Its parts are plain images.
pub struct Estimate {
    /// Linear radiance.
    pub environment: render::image::Image,
    /// Transmittance of each frame's occluder; none when not modelled.
    pub occluders: Vec<render::image::Image>,
    /// Materials through each camera: R, G, B, alpha, kappa.
    pub materials: Vec<render::image::Image>,
    /// Numbers of the run.
    pub metrics: Metrics,
}

/// The truth of a capture, each part where there is one.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Linear radiance.
    pub environment: Option<render::image::Image>,
    /// Transmittance of each frame's occluder; none where nobody stood in the light.
    pub occluders: Option<Vec<render::image::Image>>,
    /// Albedo through each camera.
    pub albedo: Vec<materials::TrueAlbedo>,
    /// The specular lobe; none for matt materials.
    pub specular: Option<materials::Specular>,
}
