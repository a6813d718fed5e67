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
    /// How the capture's files are read.
    #[serde(default)]
    pub reading: Reading,
    /// Folder of an earlier result that the `paper` preset starts from.
    #[serde(default)]
    pub from: Option<PathBuf>,
    /// Effects of the camera that are fitted jointly with all else, see [`crate::joint`].
    #[serde(default)]
    pub with: Vec<String>,
    /// What the `paper` preset expresses light and occluders in.
    #[serde(default)]
    pub parametrisation: Parametrisation,
    /// The size of an iteration of the `paper` preset; `None` suits time and memory.
    #[serde(default)]
    pub batch: Option<Batch>,
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
            reading: Reading::default(),
            from: None,
            with: Vec::new(),
            parametrisation: Parametrisation::default(),
            batch: None,
        }
    }

    /// Refuses what no run can be made with.
    ///
    /// # Errors
    /// [`SettingsError`], which names the option.
    pub fn check(&self) -> Result<(), SettingsError> {
        let chosen = self.parametrisation != Parametrisation::default();
        if self.preset == Preset::Fast && (chosen || self.batch.is_some()) {
            return Err(SettingsError::OnlyPaper {
                option: if chosen { "parametrisation" } else { "batch" },
            });
        }
        self.parametrisation.check()?;
        self.batch.map_or(Ok(()), Batch::check)
    }

    /// Refuses what no run of so many frames can be made with.
    ///
    /// # Errors
    /// [`SettingsError::HoldsNothing`].
    pub fn check_frames(&self, frames: usize) -> Result<(), SettingsError> {
        match self.hold_out {
            Some(every) if every > frames => Err(SettingsError::HoldsNothing { every, frames }),
            _ => Ok(()),
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

/// How the files of a capture are read, in the words of the command line; `None` where nothing was said.
///
/// No solver looks at it: it is for those who read the same capture again. That files outside of the capture may be read is no part of
/// it: whoever trusts a capture says so each time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reading {
    /// How photographs store colours.
    pub color: Option<String>,
    /// Which axis of the capture's own world points up.
    pub up: Option<String>,
    /// Longest side of photographs, in pixels.
    pub max_size: Option<u32>,
    /// Where the photographs of a COLMAP model lie, in place of its own `images`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub images: Option<PathBuf>,
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

/// What the `paper` preset solves for; the paper's choice unless told otherwise, others to compare with it (Table 1, Fig. 10).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parametrisation {
    /// What the logarithm of the light is expressed in.
    pub light: LightForm,
    /// The ratio a between the weights of consecutive levels of light, from coarse to fine (Eq. 7).
    pub level_ratio: f64,
    /// What the logits of the masks are expressed in.
    pub masks: MaskForm,
    /// The logit of every mask's transmittance at the start. The paper's 100 has no gradient in single precision.
    pub mask_logit: f64,
}

impl Parametrisation {
    fn check(&self) -> Result<(), SettingsError> {
        let [low, high] = LEVEL_RATIOS;
        let refuse = |option, value, [low, high]: [f64; 2]| SettingsError::Range {
            option,
            value,
            low,
            high,
        };
        if !(low..=high).contains(&self.level_ratio) {
            return Err(refuse("level_ratio", self.level_ratio, LEVEL_RATIOS));
        }
        let [low, high] = MASK_LOGITS;
        match (low..=high).contains(&self.mask_logit) {
            true => Ok(()),
            false => Err(refuse("mask_logit", self.mask_logit, MASK_LOGITS)),
        }
    }
}

impl Default for Parametrisation {
    fn default() -> Self {
        Self {
            light: LightForm::Pyramid,
            level_ratio: 2.0,
            masks: MaskForm::Harmonics,
            mask_logit: 5.0,
        }
    }
}

/// Ratios of levels whose powers single precision can hold.
const LEVEL_RATIOS: [f64; 2] = [0.01, 100.0];
/// Logits beyond these differ from them in nothing.
const MASK_LOGITS: [f64; 2] = [-1000.0, 1000.0];

/// What light is expressed in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightForm {
    /// A sum of levels from coarse to fine (Eq. 7).
    #[default]
    Pyramid,
    /// A free value for every texel: the finest level alone, of the weight that it has in the pyramid, so that steps are as long
    /// as there. With a `level_ratio` of 1 they are as long as the learning rate.
    Texels,
}

/// What masks are expressed in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskForm {
    /// Spherical harmonics of `harmonic_degree` (Eq. 6).
    #[default]
    Harmonics,
    /// A free value for every texel and frame.
    Texels,
}

/// The size of an iteration of the `paper` preset. Shadow rays are then cast: how finely a cache holds what the surface sees would
/// follow from these numbers, and more than the samples' noise would depend on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Batch {
    /// Pixels, each rendered twice.
    pub pixels: u64,
    /// Rays from each pixel's surface point: half towards the light, half by the material.
    pub rays: u64,
}

impl Batch {
    /// As large as any number of it may be; memory ends far below.
    pub const MOST: u64 = 1 << 20;

    fn check(self) -> Result<(), SettingsError> {
        let most = Self::MOST;
        for (option, value, least) in [
            ("batch.pixels", self.pixels, 1),
            ("batch.rays", self.rays, 2),
        ] {
            if !(least..=most).contains(&value) {
                return Err(SettingsError::Range {
                    option,
                    value: value as f64,
                    low: least as f64,
                    high: most as f64,
                });
            }
        }
        Ok(())
    }
}

/// Options that no run can be made with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A choice that the fast preset does not have.
    #[error(
        "`{option}` can be chosen for the paper preset alone: use that, or leave `{option}` as it is"
    )]
    OnlyPaper {
        /// Which.
        option: &'static str,
    },
    /// Nothing to judge by.
    #[error(
        "--hold-out {every} keeps the last of every {every} frames out of the fit, and the capture has only {frames}, so that none would \
         be; give a number from 2 to {frames}, such as 8, or leave --hold-out away (in the library: `Settings::hold_out`)"
    )]
    HoldsNothing {
        /// One of so many.
        every: usize,
        /// How many there are.
        frames: usize,
    },
    /// A number that cannot be worked with.
    #[error("`{option}` is {value}; expected a number from {low} to {high}")]
    Range {
        /// Which.
        option: &'static str,
        /// What it is.
        value: f64,
        /// The least that it may be.
        low: f64,
        /// The most.
        high: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_written_before_there_was_a_choice_are_the_papers() {
        let mut value = serde_json::to_value(Settings::of(Preset::Paper)).unwrap();
        let fields = value.as_object_mut().unwrap();
        for name in ["parametrisation", "batch", "reading"] {
            assert!(fields.remove(name).is_some(), "{name}");
        }
        let read: Settings = serde_json::from_value(value).unwrap();
        assert_eq!(read, Settings::of(Preset::Paper));
    }

    #[test]
    fn choices_are_the_paper_presets_and_within_reason() {
        Settings::default().check().unwrap();
        let chosen = Settings {
            parametrisation: Parametrisation {
                masks: MaskForm::Texels,
                ..Parametrisation::default()
            },
            batch: Some(Batch {
                pixels: 512,
                rays: 2,
            }),
            ..Settings::of(Preset::Paper)
        };
        chosen.check().unwrap();
        let refused = |settings: Settings| settings.check().unwrap_err().to_string();
        let fast = refused(Settings {
            preset: Preset::Fast,
            ..chosen.clone()
        });
        assert!(fast.contains("`parametrisation`"), "{fast}");
        let broken = |change: fn(&mut Settings)| {
            let mut settings = chosen.clone();
            change(&mut settings);
            refused(settings)
        };
        for (message, option) in [
            (
                broken(|s| s.parametrisation.level_ratio = f64::NAN),
                "level_ratio",
            ),
            (
                broken(|s| s.parametrisation.level_ratio = 0.0),
                "level_ratio",
            ),
            (
                broken(|s| s.parametrisation.mask_logit = f64::INFINITY),
                "mask_logit",
            ),
            (
                broken(|s| s.batch = Some(Batch { pixels: 0, rays: 8 })),
                "batch.pixels",
            ),
            (
                broken(|s| s.batch = Some(Batch { pixels: 8, rays: 1 })),
                "batch.rays",
            ),
            (
                broken(|s| {
                    s.batch = Some(Batch {
                        pixels: u64::MAX,
                        rays: 8,
                    });
                }),
                "batch.pixels",
            ),
        ] {
            assert!(message.contains(option), "{message}");
        }
    }

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
