//! What a solve leaves behind, in memory.

use std::collections::BTreeMap;

use render::image::Image;
use serde::{Deserialize, Serialize};

use crate::settings::Settings;

/// Light, materials and occluders recovered from a capture, with everything the outputs need.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Linear radiance on the grid, `rows × 2·rows × 3`, z up, centre column +x.
    pub environment: Image,
    /// Transmittance of each frame's occluder on the same grid, one channel, 1 where light passes; empty when not modelled.
    pub occluders: Vec<Image>,
    /// Materials through each camera: channels R, G, B (albedo), alpha, kappa; 0 off the object; free of NaN.
    pub materials: Vec<Image>,
    /// Material at each vertex of the capture's mesh.
    pub vertex_materials: Vec<VertexMaterial>,
    /// The material network or whatever stands for it, in its own format.
    pub network: Option<Network>,
    /// The photographs as the model renders them, linear RGB, one a frame.
    pub renders: Vec<Image>,
    /// Loss over time.
    pub curve: Vec<CurvePoint>,
    /// Numbers worth keeping.
    pub metrics: Metrics,
    /// How far off all of it may be; `None` where that was not computed.
    pub uncertainty: Option<Uncertainty>,
    /// The noise the residuals are measured in, where it is known or was estimated.
    pub noise: Option<Noise>,
    /// The options of the run.
    pub settings: Settings,
    /// Remarks for people, such as "frame 012: its mask ended empty".
    pub notes: Vec<String>,
    /// Why the solve ended.
    pub ended: Ended,
}

/// Standard deviations around a result, were everything normal near it (Laplace's approximation).
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Of the radiance, as [`Reconstruction::environment`].
    pub environment: Image,
    /// Of each transmittance, as [`Reconstruction::occluders`].
    pub occluders: Vec<Image>,
    /// Of the albedo through each camera: R, G, B; 0 off the object.
    pub albedo: Vec<Image>,
    /// Of the albedo at each vertex.
    pub vertex_albedo: Vec<[f32; 3]>,
    /// In a few numbers.
    pub summary: UncertaintySummary,
}

impl Reconstruction {
    /// Seconds that the run took: as its metrics tell, else until its last step.
    pub fn seconds(&self) -> f64 {
        let told = self
            .metrics
            .extra
            .get("seconds")
            .and_then(serde_json::Value::as_f64);
        let last = self.curve.last();
        told.unwrap_or_else(|| last.map_or(0.0, |last| last.seconds))
    }
}

impl Default for Uncertainty {
    fn default() -> Self {
        Self {
            environment: Image::filled(0, 0, 3, 0.0),
            occluders: Vec::new(),
            albedo: Vec::new(),
            vertex_albedo: Vec::new(),
            summary: UncertaintySummary::default(),
        }
    }
}

/// What is expected of the errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UncertaintySummary {
    /// Relative RMSE of the environment.
    pub environment: f64,
    /// RMSE of the albedo over the object's pixels.
    pub albedo: f64,
    /// RMSE of each frame's mask, directions weighted by the light from them; `None` for frames that were held out.
    pub occluders: Vec<Option<f64>>,
    /// How many numbers are known from the photographs rather than from what is assumed.
    pub known: f64,
    /// At most so many are: a run that was short has found but a part, and then its deviations are too large.
    pub known_at_most: f64,
    /// RMS of what is left of the data, in units of what was expected: standard deviations are that much larger.
    pub misfit: f64,
    /// What it took.
    pub seconds: f64,
}

/// Material of one vertex, the parameters of the BRDF of S1–S7.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VertexMaterial {
    /// Diffuse albedo, linear RGB in [0, 1].
    pub albedo: [f32; 3],
    /// Width of the GGX lobe (glTF roughness is its square root).
    pub alpha: f32,
    /// Reflectance at normal incidence.
    pub kappa: f32,
}

/// Bytes of `materials.<extension>`.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// File extension without the dot.
    pub extension: String,
    /// The file's contents.
    pub bytes: Vec<u8>,
}

/// One point of the loss curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Iterations done.
    pub iteration: u64,
    /// Seconds of solving.
    pub seconds: f64,
    /// Loss after the iteration.
    pub loss: f64,
    /// Shaded samples per second.
    pub samples_per_second: f64,
}

/// `metrics.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// How well photographs are explained.
    pub photometric: Photometric,
    /// Further named numbers (`iterations`, `seconds`, `peak_memory_bytes`, …).
    #[serde(flatten)]
    pub extra: BTreeMap<String, serde_json::Value>,
}

/// Agreement of renders and photographs on object pixels, in decibels against a peak of 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Photometric {
    /// On the pixels that were fitted.
    pub psnr: Option<f64>,
    /// On pixels that were held out; `None` without `--hold-out`.
    pub psnr_held_out: Option<f64>,
}

/// Variance of a photograph's value I: `read² + shot²·I + (relative·I)²`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Standard deviation in the dark.
    pub read: f64,
    /// Photon noise: standard deviation at I = 1.
    pub shot: f64,
    /// Part proportional to the signal.
    pub relative: f64,
}

impl Noise {
    /// The standard deviation at the value `value`.
    pub fn sigma(&self, value: f64) -> f64 {
        let value = value.max(0.0);
        (self.read.powi(2) + self.shot.powi(2) * value + (self.relative * value).powi(2)).sqrt()
    }
}

/// Why a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// Nothing left to gain.
    Converged,
    /// As many iterations as asked for.
    Iterations,
    /// The time limit.
    TimeLimit,
    /// The caller's stop flag.
    Interrupted,
}
