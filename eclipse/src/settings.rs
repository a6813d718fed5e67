//! Every option of a reconstruction, resolved: what a run needs to be repeated or continued.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Degree of the harmonics of a mask where no algorithm asks for another.
const DEGREE: usize = 16;
/// What 50 rows of a mask can express (Driscoll & Healy, 1994), as the paper has it.
const PAPER_DEGREE: usize = 24;

/// The options of one run, without defaults left to guess; written as `settings.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Which algorithm.
    pub preset: Preset,
    /// Wall-clock budget of the solve in seconds, reading and writing aside; `None` runs until `iterations` or convergence.
    pub time_limit: Option<f64>,
    /// Most iterations of the optimiser; `None` leaves it to the preset.
    pub iterations: Option<u64>,
    /// Seed of every random number.
    pub seed: u64,
    /// Threads used; results do not depend on it.
    pub threads: usize,
    /// Memory budget in bytes.
    pub memory: u64,
    /// Whether unseen occluders are modelled at all.
    pub occluders: bool,
    /// What is assumed about the occluders before the images are seen.
    pub occluder_prior: OccluderPrior,
    /// Lambertian materials: roughness and specularity are not fitted.
    pub lambertian: bool,
    /// Every K-th frame is kept out of the fit of environment and materials.
    pub hold_out: Option<usize>,
    /// Rows of the environment's and the masks' grid; columns are twice as many.
    pub grid_rows: usize,
    /// Degree of the spherical harmonics of an occluder's mask.
    pub harmonic_degree: usize,
    /// Mesh given in place of the capture's own.
    pub mesh: Option<PathBuf>,
    /// Folder of an earlier result that the `paper` preset starts from.
    #[serde(default)]
    pub from: Option<PathBuf>,
    /// Effects of the camera that are fitted jointly with all else, see [`crate::joint`].
    #[serde(default)]
    pub with: Vec<String>,
}

impl Settings {
    /// The options of a run of this algorithm where nothing else is asked for: 120 s, all threads.
    pub fn of(preset: Preset) -> Self {
        Self {
            preset,
            time_limit: Some(120.0),
            iterations: None,
            seed: 0,
            threads: std::thread::available_parallelism().map_or(1, |n| n.get()),
            memory: 4 << 30,
            occluders: true,
            occluder_prior: OccluderPrior::Operator,
            lambertian: false,
            hold_out: None,
            grid_rows: 50,
            harmonic_degree: match preset {
                Preset::Fast => DEGREE,
                Preset::Paper => PAPER_DEGREE,
            },
            mesh: None,
            from: None,
            with: Vec::new(),
        }
    }

    /// Whether this frame is kept out of the fit of environment and materials: the last of every K.
    pub fn holds_out(&self, frame: usize) -> bool {
        self.hold_out.is_some_and(|k| frame % k == k - 1)
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Preset::default())
    }
}

/// Which algorithm solves for light, materials and occluders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Second order on quadrature transport, then refinement: the best known.
    #[default]
    Fast,
    /// The paper's algorithm: Monte Carlo, the two-sample loss of Eq. 9, Adam at its rates.
    Paper,
}

impl Preset {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Paper => "paper",
        }
    }
}

/// What is assumed about the occluders before the images are seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OccluderPrior {
    /// An upright person behind each camera.
    #[default]
    Operator,
    /// Nothing: masks start transparent, as in the paper.
    None,
}

impl OccluderPrior {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Operator => "operator",
            Self::None => "none",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_differ_in_the_degree_of_masks_alone() {
        let (fast, paper) = (Settings::default(), Settings::of(Preset::Paper));
        assert_eq!((fast.preset, fast.harmonic_degree), (Preset::Fast, 16));
        assert_eq!(paper.harmonic_degree, 24);
        let alike = Settings {
            preset: Preset::Paper,
            harmonic_degree: 24,
            ..fast
        };
        assert_eq!(paper, alike);
    }
}
