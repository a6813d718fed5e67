//! What a diagnosis says.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{axes::Axis, locate::HotSpot};
use crate::evaluate::OccluderScore;

/// The outcome in a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// An effect was found that explains the mismatch on sealed data.
    Explained,
    /// One of several effects explains it; the data do not tell which.
    Ambiguous,
    /// Something may be there, but the data are too few to say.
    Underpowered,
    /// Simulation and recording agree.
    NothingMissing,
    /// Something is missing, and no effect that is known explains it.
    Unexplained,
}

/// An effect that was added to the model.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// The effect.
    pub id: &'static str,
    /// Its numbers by name.
    pub parameters: BTreeMap<String, f64>,
    /// Their standard errors at the last model: by noise while light and texture follow, or by leaving out parts of the surface,
    /// whichever is larger.
    pub standard_errors: BTreeMap<String, f64>,
    /// Gain on sealed pixels in units of the noise's variance.
    pub sealed_gain: f64,
    /// Its standard error.
    pub sealed_gain_se: f64,
    /// Probability of the screening gain by chance, corrected for all effects that were tried (Holm).
    pub p_holm: f64,
    /// Share of the signal that light and material cannot imitate.
    pub survival: f64,
    /// Relative size in the image (RMS).
    pub size: f64,
    /// Its standard error by those of the numbers, taken as independent.
    pub size_se: f64,
    /// Relative size that would have been found: its gain on held-out patches is expected to be three standard errors.
    pub minimum_detectable: f64,
    /// Effects that explain the data as well.
    pub ambiguous_with: Vec<&'static str>,
    /// Effects that it is easily taken for in general.
    pub confused_with: Vec<&'static str>,
    /// Where it acts most.
    #[serde(rename = "where")]
    pub place: BTreeMap<String, serde_json::Value>,
}

#[cfg(test)]
impl Finding {
    /// One whose numbers do not matter, for tests of what is told.
    pub(crate) fn example(id: &'static str, ambiguous_with: Vec<&'static str>) -> Self {
        Self {
            id,
            parameters: BTreeMap::new(),
            standard_errors: BTreeMap::new(),
            sealed_gain: 100.0,
            sealed_gain_se: 10.0,
            p_holm: 1e-6,
            survival: 0.5,
            size: 0.02,
            size_se: 0.001,
            minimum_detectable: 0.001,
            ambiguous_with,
            confused_with: Vec::new(),
            place: BTreeMap::new(),
        }
    }
}

/// A candidate of the first screening.
#[derive(Clone, Debug, Serialize)]
pub struct Ranked {
    /// The effect.
    pub id: &'static str,
    /// Gain on held-out patches of the development data.
    pub gain: f64,
    /// Its standard error.
    pub gain_se: f64,
    /// Its probability by chance.
    pub p: f64,
    /// Relative size in the image.
    pub size: f64,
    /// Its standard error by those of the numbers, taken as independent.
    pub size_se: f64,
    /// Share of its signal that survives.
    pub survival: f64,
    /// Size that would be found, as in [`Finding::minimum_detectable`].
    pub minimum_detectable: f64,
    /// Whether it is capacity rather than physics.
    pub capacity: bool,
    /// Effects that it is easily taken for in general.
    pub confused_with: Vec<&'static str>,
    /// Evidence of its refit in the first round, which decides its place in the ranking; absent where there was none.
    pub evidence: Option<f64>,
}

/// A refit with one effect more.
#[derive(Clone, Debug, Serialize)]
pub struct Refitted {
    /// How many effects were in the model before it.
    pub after: usize,
    /// The effect.
    pub id: &'static str,
    /// What it gains on the development data beyond what its numbers cost, in units of χ²; not above zero: nothing.
    pub evidence: f64,
    /// Gain on sealed data, and whether these let it stand; absent where they were not asked.
    pub sealed: Option<Judged>,
}

/// What sealed data say of a refit.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Judged {
    /// Reduction of the squared error in units of the noise.
    pub gain: f64,
    /// Its standard error.
    pub gain_se: f64,
    /// Its probability by chance.
    pub p: f64,
    /// Whether the effect stands.
    pub confirmed: bool,
}

/// Errors on sealed data before and after: sealed frames are among it where no effect in the model has numbers of single frames.
/// Outliers of either model (over three standard deviations of its residuals) are trusted less in both, by Huber's rule.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Sealed {
    /// χ² a value before.
    pub chi2_before: f64,
    /// χ² a value after.
    pub chi2_after: f64,
    /// Root mean square difference before.
    pub rmse_before: f64,
    /// Root mean square difference after.
    pub rmse_after: f64,
}

/// χ² a sealed value from which on there is more than noise to speak of: its own noise is a few hundredths.
const ABOVE_NOISE: f64 = 1.1;

impl Sealed {
    /// The share of what noise does not explain on sealed values that the effects do, 0 to 1; absent where there is none to speak of,
    /// or where none is left: χ² trusts outliers less, so that it says where noise begins, not that nothing is to be seen.
    pub fn explained(&self) -> Option<f64> {
        let (before, after) = (self.chi2_before, self.chi2_after);
        let told = before > ABOVE_NOISE && after > 1.0;
        told.then(|| ((before - after) / (before - 1.0)).max(0.0))
    }
}

/// Whose model drew the occluders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Drawn {
    /// The diagnosis': broad parts of the sky around the camera.
    #[default]
    Diagnosis,
    /// A reconstruction's with what was found: an outline.
    Reconstruction,
}

/// The occluders of the last model.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Occluders {
    /// Whose they are.
    pub by: Drawn,
    /// The share of the fitted light that is blocked in each frame.
    pub blocked: Vec<f64>,
    /// How far they are from the capture's `truth/occluders.exr`, as `evaluate` measures it; nothing without a truth.
    #[serde(flatten)]
    pub score: OccluderScore,
    /// Why a truth that is there could not be compared with.
    pub problem: Option<String>,
}

/// `diagnosis.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    /// The outcome in a word.
    pub verdict: Verdict,
    /// What was added to the model, in order.
    pub effects: Vec<Finding>,
    /// Effects in the last model that have no name here, since the verdict is that they explain too little: all that is said of `after`,
    /// and `unexplained_fraction`, includes what they do.
    pub unnamed: usize,
    /// Further photographs that would tell apart effects that explain the data equally well, a line an effect; empty where none are.
    pub separate_by: Vec<String>,
    /// What is known of the effects' sizes only together, in a sentence.
    pub shared_exponent: Option<String>,
    /// The occluders of the last model, if it has any; a map of each frame is in `occluders.exr`.
    pub occluders: Option<Occluders>,
    /// A stand-in for physics that has no name here and does better than all that has one, or than all that could be added to what was
    /// found; else the last of `finer`, where no effect was found behind it.
    pub looks_like: Option<&'static str>,
    /// Capacity candidates that did better than all physics, in order: they joined the model before effects were compared anew.
    pub finer: Vec<&'static str>,
    /// The first screening: what was refitted, in the order of its refits' evidence, then the others by their gain.
    pub ranking: Vec<Ranked>,
    /// Errors on sealed data.
    pub sealed: Sealed,
    /// Share of the structured mismatch that the last model leaves.
    pub unexplained_fraction: f64,
    /// Where the first model is off.
    pub hot_spots: Vec<HotSpot>,
    /// Where the last model is off.
    pub hot_spots_after: Vec<HotSpot>,
    /// The outcome in a sentence.
    pub sentence: String,
    /// All refits, in order.
    pub refits: Vec<Refitted>,
    /// Screenings under other baselines, by what was in the model, `with sparse occluders`, `with full occluders` and, where the
    /// simulation has some, `without the simulation's occluders` among them: gains of each effect.
    pub baselines: BTreeMap<String, Vec<Ranked>>,
    /// How far albedo and light moved from the first model to the last (relative RMS).
    pub moved: BTreeMap<String, f64>,
    /// The command that reconstructs with what was found.
    pub command: Option<String>,
    /// What was taken for granted, for people.
    pub assumptions: Vec<String>,
    /// Structured mismatch in units of the noise's variance, before and after.
    pub structured: [f64; 2],
    /// The part of it that is in the background.
    pub background: [f64; 2],
    /// That of the surface in frames that no fit has seen, before and after; absent where none is sealed, or where what was found has
    /// numbers of single frames, which are unknown there.
    pub structured_sealed: Option<[f64; 2]>,
    /// Mean residuals along axes.
    pub axes: Vec<Axis>,
    /// Seconds each part took: `all` of the diagnosis proper, its parts among it (`baseline`, `screen 1`, `refits 1`, …). The command
    /// adds `reconstruction`, that of the simulation (0 where there was nothing to reconstruct, or a reconstruction was given),
    /// `outline` where there is one, and `total`, from its beginning until files are written.
    pub seconds: BTreeMap<String, f64>,
}

#[cfg(test)]
impl Diagnosis {
    /// One with this outcome, for tests of what is told.
    pub(crate) fn example(verdict: Verdict, effects: Vec<Finding>) -> Self {
        Self {
            verdict,
            effects,
            unnamed: 0,
            separate_by: Vec::new(),
            shared_exponent: None,
            occluders: None,
            looks_like: None,
            finer: Vec::new(),
            ranking: Vec::new(),
            sealed: Sealed {
                chi2_before: 3.0,
                chi2_after: 1.1,
                rmse_before: 0.03,
                rmse_after: 0.01,
            },
            unexplained_fraction: 0.05,
            hot_spots: Vec::new(),
            hot_spots_after: Vec::new(),
            sentence: String::new(),
            refits: Vec::new(),
            baselines: BTreeMap::new(),
            moved: BTreeMap::new(),
            command: None,
            assumptions: Vec::new(),
            structured: [2.0, 0.1],
            background: [0.0; 2],
            structured_sealed: None,
            axes: Vec::new(),
            seconds: BTreeMap::new(),
        }
    }
}

#[cfg(test)]
impl Ranked {
    /// One whose numbers do not matter, for tests of what is told.
    pub(crate) fn example(id: &'static str) -> Self {
        Self {
            id,
            gain: 50.0,
            gain_se: 10.0,
            p: 1e-4,
            size: 0.01,
            size_se: 0.002,
            survival: 0.5,
            minimum_detectable: 0.006,
            capacity: false,
            confused_with: Vec::new(),
            evidence: None,
        }
    }
}
