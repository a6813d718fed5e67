//! S8 and S9: why masks are sought as waves, and light as a pyramid.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use render::{image::Image, sampler::SampleKey};
use serde_json::{Map, Value, json};

use super::{
    Bench, Evidence, Study, StudyError, Verdict,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone, but, listed},
    flatland::{Flatland, spread},
    spectrum::{fourier, magnitude, wave_row},
};
use crate::report::text::number;

/// Spectra 1/f^a.
const EXPONENTS: [f64; 3] = [0.1, 1.0, 10.0];
/// Rows that are shown, as in the paper.
const ROWS: [usize; 2] = [32, 64];
/// Elements this far from the diagonal count as around it.
const AROUND: usize = 8;
/// Seeds of the lights' phases.
const SEEDS: std::ops::Range<u64> = 0..3;
/// Samples of S9, where every entry is shown.
const SHOWN: usize = 128;
/// Numbers of observations of S9.
const OBSERVATIONS: [usize; 4] = [1, 2, 8, 32];

/// The study.
pub(super) struct Theory;

impl Study for Theory {
    fn name(&self) -> &'static str {
        "theory"
    }

    fn run(&self, _bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        Ok(evidence())
    }
}

/// How the constant part of a light is chosen, of which a spectrum says nothing; light cannot be negative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Contrast {
    /// Lifted until the darkest direction is black.
    Low,
    /// The exponential of twice the standardised signal: lamps and windows, as in photographs.
    High,
}

impl Contrast {
    fn name(self) -> &'static str {
        match self {
            Self::Low => "low_contrast",
            Self::High => "high_contrast",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Low => "low contrast",
            Self::High => "high contrast",
        }
    }
}

/// A light with amplitudes 1/f^a and random phases.
fn light(samples: usize, exponent: f64, seed: u64, contrast: Contrast) -> Vec<f64> {
    let mut stream = SampleKey {
        seed,
        ..SampleKey::default()
    }
    .stream();
    let mut signal = vec![0.0; samples];
    for frequency in 1..samples / 2 {
        let amplitude = (frequency as f64).powf(-exponent);
        let phase = TAU * f64::from(stream.uniform());
        for (j, value) in signal.iter_mut().enumerate() {
            *value +=
                amplitude * (TAU * (j * frequency % samples) as f64 / samples as f64 + phase).cos();
        }
    }
    match contrast {
        Contrast::Low => {
            let darkest = signal.iter().copied().fold(f64::INFINITY, f64::min);
            signal.iter().map(|v| v - darkest).collect()
        }
        Contrast::High => {
            let deviation = (signal.iter().map(|v| v * v).sum::<f64>() / samples as f64).sqrt();
            signal.iter().map(|v| (2.0 * v / deviation).exp()).collect()
        }
    }
}

/// B of S20 for occluders far away: the cosine's convolution times the light.
fn mask_operator(flatland: &Flatland, light: &[f64]) -> DMatrix<f64> {
    let n = flatland.samples;
    DMatrix::from_fn(n, n, |i, j| flatland.cosine((n + i - j) % n) * light[j])
}

/// What a row of FBFᴴ holds.
#[derive(Clone, Copy, Debug)]
struct RowShape {
    peak_on_diagonal: bool,
    /// Share of the energy on the diagonal.
    diagonal: f64,
    /// Share of the energy within [`AROUND`] of it.
    around: f64,
}

fn shape(row: &[f64], index: usize) -> RowShape {
    let n = row.len();
    let energy: f64 = row.iter().map(|v| v * v).sum();
    let near = (n + index - AROUND..=n + index + AROUND).map(|k| row[k % n].powi(2));
    RowShape {
        peak_on_diagonal: row.iter().all(|v| *v <= row[index]),
        diagonal: row[index].powi(2) / energy,
        around: near.sum::<f64>() / energy,
    }
}

/// The shapes for one kind of light, worst over rows and seeds.
struct Spectrum {
    exponent: f64,
    contrast: Contrast,
    peak_on_diagonal: bool,
    diagonal: [f64; 2],
    around: [f64; 2],
}

impl Spectrum {
    fn new(exponent: f64, contrast: Contrast) -> Self {
        let flatland = Flatland::PAPER;
        let mut shapes = Vec::new();
        for seed in SEEDS {
            let light = light(flatland.samples, exponent, seed, contrast);
            let operator = mask_operator(&flatland, &light);
            shapes.extend(ROWS.map(|i| shape(&wave_row(&operator, i), i)));
        }
        let range = |of: fn(&RowShape) -> f64| {
            shapes
                .iter()
                .map(of)
                .fold([f64::INFINITY, 0.0], |[low, high], v| {
                    [v.min(low), v.max(high)]
                })
        };
        Self {
            exponent,
            contrast,
            peak_on_diagonal: shapes.iter().all(|s| s.peak_on_diagonal),
            diagonal: range(|s| s.diagonal),
            around: range(|s| s.around),
        }
    }

    /// Whether most of every row's energy is around the diagonal.
    fn concentrated(&self) -> bool {
        self.around[0] > 0.5
    }

    /// What is to be said where it is not, and why: a row is the light's spectrum.
    fn elsewhere(&self) -> String {
        format!(
            "for a = {} at {} {} to {} lies around the diagonal, as the spectrum of such light has the rest at all other frequencies",
            self.exponent,
            self.contrast.words(),
            number(self.around[0]),
            number(self.around[1])
        )
    }

    fn numbers(&self) -> Value {
        json!({
            "peak_on_diagonal": self.peak_on_diagonal,
            "diagonal_share_least": self.diagonal[0],
            "diagonal_share_most": self.diagonal[1],
            "within_8_share_least": self.around[0],
            "within_8_share_most": self.around[1],
        })
    }
}

/// AᵀA for a number of observations.
fn gram(flatland: &Flatland, observations: usize) -> DMatrix<f64> {
    let operator = flatland.operator(&spread(observations));
    operator.transpose() * operator
}

/// ‖G − G shifted along the diagonal‖ / ‖G‖: nothing for a matrix made of blocks of this size.
fn shift_error(gram: &DMatrix<f64>, shift: usize) -> f64 {
    let n = gram.nrows();
    let shifted = DMatrix::from_fn(n, n, |i, j| gram[((i + shift) % n, (j + shift) % n)]);
    (gram - shifted).norm() / gram.norm()
}

/// The smallest shift along the diagonal that changes nothing: the size of the blocks.
fn block_size(gram: &DMatrix<f64>) -> usize {
    let n = gram.nrows();
    (1..=n)
        .find(|&shift| shift_error(gram, shift) < 1e-9)
        .unwrap_or(n)
}

/// Distance to the nearest circulant matrix, over the norm.
fn circulant_error(gram: &DMatrix<f64>) -> f64 {
    let n = gram.nrows();
    let mean: Vec<f64> = (0..n)
        .map(|d| (0..n).map(|i| gram[(i, (i + d) % n)]).sum::<f64>() / n as f64)
        .collect();
    let nearest = DMatrix::from_fn(n, n, |i, j| mean[(n + j - i) % n]);
    (gram - nearest).norm() / gram.norm()
}

fn evidence() -> Evidence {
    let spectra: Vec<Spectrum> = [Contrast::Low, Contrast::High]
        .into_iter()
        .flat_map(|contrast| EXPONENTS.map(|a| Spectrum::new(a, contrast)))
        .collect();
    let flatland = Flatland {
        samples: SHOWN,
        ..Flatland::PAPER
    };
    let grams: Vec<DMatrix<f64>> = OBSERVATIONS.iter().map(|&t| gram(&flatland, t)).collect();
    let blocks: Vec<usize> = grams.iter().map(block_size).collect();
    let circulant: Vec<f64> = grams.iter().map(circulant_error).collect();
    let mut parts = vec![
        (
            "blocks do not shrink as observations are added (why was not found)".to_owned(),
            blocks.windows(2).all(|w| w[1] < w[0]),
        ),
        (
            "AᵀA does not come near a circulant matrix (why was not found)".to_owned(),
            circulant.windows(2).all(|w| w[1] < w[0]) && circulant[circulant.len() - 1] < 0.02,
        ),
    ];
    parts.extend(spectra.iter().map(|s| (s.elsewhere(), s.concentrated())));
    let held: Vec<bool> = parts.iter().map(|(_, held)| *held).collect();
    let list = |values: Vec<String>| values.join(", ");
    let around = |contrast| {
        let of = spectra.iter().filter(|s| s.contrast == contrast);
        list(of.map(|s| number(s.around[0])).collect())
    };
    Evidence {
        name: "theory",
        title: "Masks as waves, light as a pyramid",
        source: "Verbin et al. 2024, S4.2 and S4.3, Fig. S8 and S9",
        claim: "In the Fourier basis the operator that takes masks to images has most of its energy around the diagonal, each row's \
                largest element on it, for natural light; AᵀA has blocks that shrink as observations are added, and \
                approaches a circulant matrix.",
        verdict: Verdict::of(&held),
        sentence: format!(
            "{} of a row's energy or more lies around the diagonal for 1/f^a spectra (a = {}) of low contrast, {} for those of high \
             contrast; AᵀA comes within {} of a circulant matrix at {} observations, from {} at {}.{}",
            listed(&EXPONENTS),
            around(Contrast::Low),
            around(Contrast::High),
            number(circulant[circulant.len() - 1]),
            OBSERVATIONS[OBSERVATIONS.len() - 1],
            number(circulant[0]),
            OBSERVATIONS[0],
            but(&parts)
        ),
        numbers: numbers(&spectra, &blocks, &circulant),
        figures: figures(&grams),
        details: vec![format!(
            "Shares are of rows 32 and 64, within {AROUND} of the diagonal. The blocks of AᵀA have {} of {SHOWN} samples \
             for {} observations.",
            list(blocks.iter().map(usize::to_string).collect()),
            list(OBSERVATIONS.iter().map(usize::to_string).collect()),
        )],
        notes: vec![
            "FBFᴴ has the elements ĉ(i) L̂(i − j): a row is the spectrum of the light, moved to the diagonal. Light is not negative, so \
             none of its Fourier coefficients exceeds its mean: that rows peak on the diagonal holds for every light, whatever its \
             spectrum, so that it is no part of what was tested. How much of the energy is there is a question of contrast, not of a alone: a spectrum leaves the mean open, and the \
             paper's figure shows spectra alone where its text speaks of natural light. Low contrast lifts the signal until its darkest \
             direction is black; high contrast is the exponential of twice the standardised signal: lamps and windows, as in photographs."
                .into(),
            "The paper prints FBFᵀ; with the plain transpose the peak of row i is at column n − i. Waves of sines and cosines, or the \
             conjugate transpose as here, put it on the diagonal. Rows of odd index above 1 vanish, as the cosine lobe has no odd \
             frequencies: the rows shown, 32 and 64, are among those that do not."
                .into(),
            "Occluders are far away in the first part (B of S20 is a convolution times the light) and at r = 10 in the second. A block's \
             size is the smallest shift along the diagonal that leaves AᵀA as it is. Three seeds of phases."
                .into(),
        ],
    }
}

fn numbers(spectra: &[Spectrum], blocks: &[usize], circulant: &[f64]) -> Value {
    let mut numbers = Map::new();
    for contrast in [Contrast::Low, Contrast::High] {
        let of = spectra.iter().filter(|s| s.contrast == contrast);
        let fields = of.map(|s| (format!("a_{}", s.exponent), s.numbers()));
        numbers.insert(contrast.name().into(), Value::Object(fields.collect()));
    }
    for (t, (block, error)) in OBSERVATIONS.iter().zip(blocks.iter().zip(circulant)) {
        let row = json!({"block": block, "distance_to_circulant": error});
        numbers.insert(format!("observations_{t}"), row);
    }
    Value::Object(numbers)
}

fn figures(grams: &[DMatrix<f64>]) -> Vec<Figure> {
    let flatland = Flatland::PAPER;
    let half = flatland.samples / 2;
    let lights = EXPONENTS.map(|a| light(flatland.samples, a, SEEDS.start, Contrast::Low));
    let spectra = EXPONENTS.iter().zip(&lights).map(|(&a, light)| {
        let spectrum = fourier(light);
        let points = (1..half).map(|k| [k as f64, magnitude(spectrum[k]) / magnitude(spectrum[1])]);
        Series::line(format!("a = {a}"), points.collect())
    });
    let mut figures = vec![Figure {
        name: "light-spectra".into(),
        caption: "Spectra of the light, each divided by its first frequency.".into(),
        content: Content::Chart(Chart {
            x: Axis::logarithmic("frequency", [1.0, half as f64]),
            y: Axis::logarithmic("magnitude", [1e-4, 2.0]),
            series: spectra.collect(),
        }),
    }];
    let all = [Contrast::Low, Contrast::High]
        .into_iter()
        .flat_map(|contrast| ROWS.map(|index| (contrast, index)));
    figures.extend(all.map(|(contrast, index)| rows(contrast, index)));
    let pictures = OBSERVATIONS.iter().zip(grams).map(|(t, gram)| {
        let (low, high) = (gram.min() as f32, gram.max() as f32);
        Picture {
            label: format!("T = {t}"),
            values: Image {
                width: gram.ncols(),
                height: gram.nrows(),
                channels: 1,
                // Symmetric: columns are rows.
                data: gram.iter().map(|v| *v as f32).collect(),
            },
            tone: Tone::Heat { low, high },
        }
    });
    figures.push(Figure {
        name: "gram".into(),
        caption: "AᵀA over the number T of observations; each from its smallest (blue) to its largest entry (red).".into(),
        content: Content::Pictures(pictures.collect()),
    });
    figures
}

/// A row of FBFᴴ for each spectrum.
fn rows(contrast: Contrast, index: usize) -> Figure {
    let flatland = Flatland::PAPER;
    let half = flatland.samples / 2;
    let rows = EXPONENTS.map(|a| {
        let light = light(flatland.samples, a, SEEDS.start, contrast);
        let row = wave_row(&mask_operator(&flatland, &light), index);
        let points = (0..half).map(|k| [k as f64, row[k] / row[index]]);
        Series::line(format!("a = {a}"), points.collect())
    });
    Figure {
        name: format!("row-{index}-{}", contrast.name().replace('_', "-")),
        caption: format!(
            "Magnitudes of row {index} of FBFᴴ, {}, divided by its diagonal element; first seed.",
            contrast.words()
        ),
        content: Content::Chart(Chart {
            x: Axis::linear("column", [0.0, half as f64]),
            y: Axis::logarithmic("magnitude / diagonal", [1e-5, 2.0]),
            series: rows.into(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_the_lights_spectrum_moved_to_the_diagonal() {
        let flatland = Flatland {
            samples: 64,
            ..Flatland::PAPER
        };
        let light = light(64, 1.0, 7, Contrast::High);
        let row = wave_row(&mask_operator(&flatland, &light), 6);
        let lobe: Vec<f64> = (0..64).map(|d| flatland.cosine(d)).collect();
        let (lobe, spectrum) = (fourier(&lobe), fourier(&light));
        for (k, value) in row.iter().enumerate() {
            let expected = magnitude(lobe[6]) * magnitude(spectrum[(64 + 6 - k) % 64]);
            assert!(
                (value - expected).abs() < 1e-9 * magnitude(spectrum[0]),
                "{k}"
            );
        }
    }

    #[test]
    fn light_that_could_be_negative_need_not_peak_on_the_diagonal() {
        let flatland = Flatland {
            samples: 64,
            ..Flatland::PAPER
        };
        let mut wave = light(64, 1.0, 7, Contrast::Low);
        assert!(shape(&wave_row(&mask_operator(&flatland, &wave), 6), 6).peak_on_diagonal);
        let mean = wave.iter().sum::<f64>() / 64.0;
        wave.iter_mut().for_each(|v| *v -= mean);
        let row = shape(&wave_row(&mask_operator(&flatland, &wave), 6), 6);
        assert!(!row.peak_on_diagonal && row.diagonal < 1e-12);
    }

    #[test]
    fn lights_have_the_spectrum_they_are_said_to_have() {
        let spectrum = fourier(&light(128, 1.0, 3, Contrast::Low));
        for k in 2..60 {
            let ratio = magnitude(spectrum[1]) / magnitude(spectrum[k]);
            assert!((ratio / k as f64 - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn blocks_shrink_with_observations_towards_a_circulant_matrix() {
        let flatland = Flatland {
            samples: 64,
            ..Flatland::PAPER
        };
        let of = |t| gram(&flatland, t);
        assert_eq!([1, 2, 8, 16].map(|t| block_size(&of(t))), [64, 32, 8, 4]);
        let errors = [1, 2, 8, 16].map(|t| circulant_error(&of(t)));
        assert!(errors.windows(2).all(|w| w[1] < 0.8 * w[0]), "{errors:?}");
        // Without occluders it is one.
        assert!(circulant_error(&of(0)) < 1e-12);
    }
}
