//! Fig. 3 and S16–S19: occluders make it possible to tell light apart that a matt surface blurs away.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use render::sampler::SampleKey;
use serde_json::json;

use super::{
    Bench, Evidence, Study, StudyError, Verdict,
    evidence::{Axis, Chart, Content, Figure, Series, but, mean},
    flatland::{Flatland, Occluder, spread},
    spectrum::singular_values,
};
use crate::report::text::number;

/// Numbers of observations with an occluder; 0 is one observation without.
const OBSERVATIONS: [usize; 6] = [0, 1, 2, 8, 16, 32];
/// Singular values above these shares of the largest are counted.
const FLOORS: [f64; 2] = [1e-2, 1e-3];
/// Singular values below this share of the largest are round-off, and zero.
const ZERO: f64 = 1e-12;
/// Low frequencies, of which one occluder is looked at; the first two are seen without any.
const LOW: std::ops::Range<usize> = 2..21;
/// Noise at which frequencies are told to be recovered: that of good photographs, as a share of the largest singular value.
const NOISE: f64 = 3e-3;
/// Seeds of occluders that do not stand evenly spread.
const SEEDS: std::ops::Range<u64> = 0..3;

/// The study.
pub(super) struct Conditioning;

impl Study for Conditioning {
    fn name(&self) -> &'static str {
        "conditioning"
    }

    // The paper's own numbers take seconds: there is nothing to reduce.
    fn run(&self, _bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        evidence(Flatland::PAPER)
    }
}

/// One operator's spectrum.
struct Row {
    observations: usize,
    /// Normalised to the largest.
    values: Vec<f64>,
    /// `[frequency]`: the share of a wave's variance that is recovered.
    recovered: Vec<f64>,
}

impl Row {
    fn new(flatland: &Flatland, observations: usize) -> Result<Self, StudyError> {
        let operator = flatland.operator(&spread(observations));
        let mut values = singular_values(&operator)?;
        let largest = values[0];
        values.iter_mut().for_each(|v| *v /= largest);
        Ok(Self {
            observations,
            values,
            recovered: recovered(&operator, NOISE * largest),
        })
    }

    fn label(&self) -> String {
        match self.observations {
            0 => "no occlusions".into(),
            1 => "1 observation".into(),
            n => format!("{n} observations"),
        }
    }

    fn above(&self, floor: f64) -> usize {
        above(&self.values, floor)
    }

    fn smallest(&self) -> f64 {
        self.values[self.values.len() - 1]
    }

    /// The share that is recovered of the frequencies from `from` to `to`, in parts of all.
    fn share(&self, from: f64, to: f64) -> f64 {
        let place = |part: f64| (part * self.recovered.len() as f64) as usize;
        mean(&self.recovered[place(from)..place(to)])
    }

    /// The same of low frequencies that are even or, `odd`, of the others: these alone are lost without occluders.
    fn low(&self, odd: bool) -> f64 {
        let band = LOW.filter(|k| (k % 2 == 1) == odd);
        let band: Vec<f64> = band.map(|k| self.recovered[k]).collect();
        mean(&band)
    }

    /// Of the highest quarter.
    fn highest(&self) -> f64 {
        self.share(0.75, 1.0)
    }

    fn numbers(&self) -> serde_json::Value {
        let resolved = self.recovered.iter().filter(|&&r| r > 0.5).count();
        json!({
            "above_1e-2": self.above(FLOORS[0]),
            "above_1e-3": self.above(FLOORS[1]),
            "middle": self.values[self.values.len() / 2],
            "smallest": self.smallest(),
            "frequencies_recovered": resolved,
        })
    }
}

fn above(values: &[f64], floor: f64) -> usize {
    values.iter().filter(|&&v| v > floor * values[0]).count()
}

/// For every frequency of light, the share of its variance that the best linear estimate recovers when all directions have a
/// variance of 1 and observations noise of this standard deviation: 1 − wᵀ(AᵀA/σ² + 1)⁻¹w, the mean of its sine and cosine.
fn recovered(operator: &DMatrix<f64>, noise: f64) -> Vec<f64> {
    let n = operator.ncols();
    let mut precision = operator.transpose() * operator;
    precision /= noise * noise;
    for i in 0..n {
        precision[(i, i)] += 1.0;
    }
    let waves = DMatrix::from_fn(n, n, |j, k| {
        let phase = TAU * (j * (k / 2) % n) as f64 / n as f64;
        if k % 2 == 0 { phase.cos() } else { phase.sin() }
    });
    let Some(factor) = precision.cholesky() else {
        unreachable!("AᵀA/σ² + 1 is positive definite");
    };
    let spread = factor.solve(&waves);
    (0..n / 2)
        .map(|frequency| {
            let (mut left, mut all) = (0.0, 0.0);
            for k in [2 * frequency, 2 * frequency + 1] {
                left += waves.column(k).dot(&spread.column(k));
                all += waves.column(k).norm_squared();
            }
            1.0 - left / all
        })
        .collect()
}

fn evidence(flatland: Flatland) -> Result<Evidence, StudyError> {
    let rows = |occluder| -> Result<Vec<Row>, StudyError> {
        let flatland = Flatland {
            occluder,
            ..flatland
        };
        OBSERVATIONS
            .iter()
            .map(|&n| Row::new(&flatland, n))
            .collect()
    };
    let (blocker, window) = (rows(Occluder::Blocker)?, rows(Occluder::Window)?);
    let n = flatland.samples;
    let random = random_places(&flatland)?;
    let [none, one, .., many] = &blocker[..] else {
        unreachable!("as many rows as numbers of observations");
    };
    let grows =
        |count: &dyn Fn(&Row) -> f64| blocker.windows(2).all(|w| count(&w[1]) > count(&w[0]));
    // By what factor many occluders raise singular values beyond one: most at the end, as Fig. 3 has it.
    let places = [n / 4, n / 2, 7 * n / 8];
    let factors = places.map(|at| many.values[at] / one.values[at].max(ZERO));
    let most_at_the_end = factors.windows(2).all(|pair| pair[1] > pair[0]);
    let raised: Vec<String> = places
        .iter()
        .zip(factors)
        .map(|(&at, factor)| raised(at, factor, one, many))
        .collect();
    let gain = |from, to| many.share(from, to) - one.share(from, to);
    let (middle, end) = (gain(0.25, 0.5), gain(0.75, 1.0));
    // What is to be said where a part does not hold, and whether it does.
    let parts = [
        (
            "without occluders less is attenuated strongly (why was not found)",
            none.above(FLOORS[0]) < n / 20,
        ),
        (
            "one occluder does not raise low frequencies, or middle ones as well (why was not found)",
            one.above(FLOORS[0]) > none.above(FLOORS[0]) && one.values[n / 2] < FLOORS[1],
        ),
        (
            "more occluders do not raise more values (why was not found)",
            grows(&|row| row.above(FLOORS[1]) as f64),
        ),
        (
            "more occluders do not recover more of the highest frequencies (why was not found)",
            grows(&|row| row.highest()) && many.highest() > 5.0 * one.highest(),
        ),
        (
            "values at the end are not raised most (why was not found)",
            most_at_the_end,
        ),
        (
            "of frequencies themselves, which an index of singular values is only without occluders, those in the middle gain more than the \
             highest (with occluders waves are no singular vectors, so that the two orders differ)",
            end > middle,
        ),
        (
            "occluders at random places raise no more values than one does (why was not found)",
            random.iter().all(|r| r.least > one.above(FLOORS[1])),
        ),
    ];
    let held = parts.map(|(_, held)| held);
    let counts = |floor: usize| -> String {
        let counts: Vec<String> = blocker
            .iter()
            .map(|r| r.above(FLOORS[floor]).to_string())
            .collect();
        counts.join(", ")
    };
    Ok(Evidence {
        name: "conditioning",
        title: "How much of the light an occluder makes visible",
        source: "Verbin et al. 2024, Fig. 3 and S16–S19",
        claim: "A matt disc attenuates almost all frequencies of light; one occluder makes some low ones recoverable; more occluders \
                recover more, most of all at the highest frequencies.",
        verdict: Verdict::of(&held),
        sentence: format!(
            "with none, 1, 2, 8, 16 and 32 occluders {} of {n} singular values are above 1/1000 of the largest; of the highest quarter of \
             frequencies {}, {} and {} % can be recovered with none, 1 and 32.{}",
            counts(1),
            number(100.0 * none.highest()),
            number(100.0 * one.highest()),
            number(100.0 * many.highest()),
            but(&parts)
        ),
        numbers: json!({
            "blocker": table(&blocker),
            "window": table(&window),
            "random_places": random.iter().map(|r| (r.name(), r.numbers())).collect::<serde_json::Map<_, _>>(),
        }),
        figures: vec![
            spectra("singular-values", &blocker, "An occluder that blocks, as in the text."),
            frequencies(&blocker),
            spectra(
                "singular-values-window",
                &window,
                "For reference, S17 as printed: light passes inside only. One or two windows see a part of the circle and nothing \
                 of the rest; many see it better than blockers, as each sees little at a time.",
            ),
        ],
        details: vec![
            format!(
                "Above 1/100 of the largest are {}; the smallest is {} with one occluder and {} with 32, as a share of the largest. \
                 Of singular values, {}.",
                counts(0),
                in_words(one.smallest()),
                in_words(many.smallest()),
                raised.join(", "),
            ),
            format!(
                "In shares of a frequency's variance at a noise of 0.3 %, what 32 occluders add to one: {} % of the second quarter, {} % of \
                 the highest. One occluder makes odd low frequencies ({} to {}) recoverable at the cost of even ones, which are seen \
                 without: of odd ones {} % in place of {} %, of even ones {} % in place of {} %.",
                number(100.0 * middle),
                number(100.0 * end),
                LOW.start,
                LOW.end - 1,
                percent(one.low(true)),
                percent(none.low(true)),
                percent(one.low(false)),
                percent(none.low(false)),
            ),
        ],
        notes: vec![
            format!(
                "A disc of radius 1, albedo 1, {n} places and {n} directions; occluders of {} rad at a distance of {}, evenly \
                 spread. The singular values are of A in S19, through its triangular factor; each curve is divided by its largest \
                 value, so that seeing more often alone does not count.",
                flatland.width, flatland.distance
            ),
            format!(
                "Without occluders A is circulant and its singular values are the Fourier coefficients of the cosine lobe: those of \
                 odd frequencies above 1 are exactly zero, and the curve ends at {} of {n}. Occluders bring these back: no amount of \
                 light or patience does.",
                none.above(1e-12)
            ),
            "The index of a singular value is a frequency only without occluders. The second figure asks for frequencies themselves: \
             which share of a wave's variance the best linear estimate recovers, given noise of 0.3 % of the largest singular value."
                .into(),
            "Occluders at random places (three seeds) stand for people who do not walk in even steps.".into(),
        ],
    })
}

/// By what `factor` many occluders raise a singular value beyond one: from zero there is none to be told.
fn raised(at: usize, factor: f64, one: &Row, many: &Row) -> String {
    match one.values[at] < ZERO {
        true => format!(
            "number {at}, which is zero with one, is {} with 32",
            in_words(many.values[at])
        ),
        false => format!(
            "number {at} is {} times as large with 32 as with one",
            number(factor)
        ),
    }
}

/// Of a share that may be zero but for round-off.
fn percent(share: f64) -> String {
    match share.abs() < ZERO.sqrt() {
        true => "0".to_owned(),
        false => number(100.0 * share),
    }
}

/// A share of the largest singular value.
fn in_words(value: f64) -> String {
    match value < ZERO {
        true => "zero".to_owned(),
        false => number(value),
    }
}

fn table(rows: &[Row]) -> serde_json::Value {
    let rows = rows.iter();
    let fields = rows.map(|row| (row.label().replace(' ', "_"), row.numbers()));
    serde_json::Value::Object(fields.collect())
}

/// What is left above 1/1000 when occluders stand at random places.
struct Random {
    observations: usize,
    mean: f64,
    least: usize,
}

impl Random {
    fn name(&self) -> String {
        format!("{}_observations", self.observations)
    }

    fn numbers(&self) -> serde_json::Value {
        json!({"above_1e-3_mean": self.mean, "above_1e-3_least": self.least})
    }
}

fn random_places(flatland: &Flatland) -> Result<Vec<Random>, StudyError> {
    [8].into_iter()
        .map(|observations| {
            let mut counts = Vec::new();
            for seed in SEEDS {
                let key = SampleKey {
                    seed,
                    ..SampleKey::default()
                };
                let mut stream = key.stream();
                let angles: Vec<f64> = (0..observations)
                    .map(|_| TAU * f64::from(stream.uniform()))
                    .collect();
                let values = singular_values(&flatland.operator(&angles))?;
                counts.push(above(&values, FLOORS[1]));
            }
            Ok(Random {
                observations,
                mean: counts.iter().sum::<usize>() as f64 / counts.len() as f64,
                least: counts.iter().copied().min().unwrap_or(0),
            })
        })
        .collect()
}

fn spectra(name: &str, rows: &[Row], caption: &str) -> Figure {
    let series = rows.iter().map(|row| {
        let points = row.values.iter().enumerate();
        // In a circulant operator each frequency has two singular values, of its sine and its cosine.
        Series::line(
            row.label(),
            points.map(|(i, v)| [0.5 * i as f64, *v]).collect(),
        )
    });
    Figure {
        name: name.into(),
        caption: format!("Normalised singular values of the observation operator. {caption}"),
        content: Content::Chart(Chart {
            x: Axis::linear(
                "index / 2 (without occluders: angular frequency)",
                [0.0, 0.5 * rows[0].values.len() as f64],
            ),
            y: Axis::logarithmic("singular value / largest", [1e-6, 1.0]),
            series: series.collect(),
        }),
    }
}

fn frequencies(rows: &[Row]) -> Figure {
    let series = rows.iter().map(|row| {
        let points = row.recovered.iter().enumerate();
        Series::line(row.label(), points.map(|(k, r)| [k as f64, *r]).collect())
    });
    Figure {
        name: "recovered-frequencies".into(),
        caption: "Share of each frequency of light that can be recovered from blockers, given noise of 0.3 % of the largest singular value."
            .into(),
        content: Content::Chart(Chart {
            x: Axis::linear("angular frequency of light", [0.0, rows[0].recovered.len() as f64]),
            y: Axis::linear("share of variance recovered", [0.0, 1.0]),
            series: series.collect(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: Flatland = Flatland {
        samples: 128,
        ..Flatland::PAPER
    };

    #[test]
    fn without_occluders_the_values_are_the_lobes_fourier_coefficients() {
        let row = Row::new(&SMALL, 0).unwrap();
        // (cos φ)₊: 1/π, then ¼ twice, then 1/(π (k² − 1)) twice for even k, nothing for odd ones; aliasing is of order n⁻².
        let pi = std::f64::consts::PI;
        let mut expected = vec![1.0, 0.25 * pi, 0.25 * pi];
        expected.extend(
            (2..9)
                .step_by(2)
                .flat_map(|k| [1.0 / f64::from(k * k - 1); 2]),
        );
        for (value, expected) in row.values.iter().zip(&expected) {
            assert!((value - expected).abs() < 1e-3, "{value} {expected}");
        }
        assert_eq!(row.above(1e-12), 1 + 2 + SMALL.samples / 2 - 1);
    }

    #[test]
    fn odd_frequencies_are_lost_without_occluders_and_come_back_with_them() {
        let none = Row::new(&SMALL, 0).unwrap().recovered;
        let many = Row::new(&SMALL, 16).unwrap().recovered;
        assert!(none[1] > 0.9 && none[2] > 0.9, "{none:?}");
        assert!(none[3].abs() < 1e-9 && none[5].abs() < 1e-9);
        assert!(many[3] > 0.9 && many[5] > 0.9, "{many:?}");
    }

    #[test]
    fn one_occluder_gives_odd_low_frequencies_for_even_ones() {
        let [none, one] = [0, 1].map(|n| Row::new(&SMALL, n).unwrap());
        assert!(none.low(true).abs() < 1e-6 && one.low(true) > 0.1);
        assert!(one.low(false) < none.low(false));
        assert_eq!(percent(none.low(true)), "0");
    }

    #[test]
    fn from_zero_there_is_no_factor() {
        let [one, many] = [1, 32].map(|n| Row::new(&SMALL, n).unwrap());
        let factor = many.values[8] / one.values[8];
        let told = [8, 112].map(|at| raised(at, factor, &one, &many));
        assert!(
            told[0].starts_with("number 8 is 3.05 times as large"),
            "{told:?}"
        );
        assert!(
            told[1].starts_with("number 112, which is zero with one"),
            "{told:?}"
        );
    }

    #[test]
    fn conditioning_improves_with_observations() {
        let rows: Vec<Row> = OBSERVATIONS
            .iter()
            .map(|&n| Row::new(&SMALL, n).unwrap())
            .collect();
        for pair in rows.windows(2) {
            let counts = [pair[0].above(1e-3), pair[1].above(1e-3)];
            assert!(
                counts[0] < counts[1] || counts[1] == SMALL.samples,
                "{counts:?}"
            );
        }
        assert!(rows[5].smallest() > 1e-3 && rows[1].smallest() < 1e-12);
    }

    #[test]
    fn an_occluder_that_never_moves_is_no_help_at_the_highest_frequencies() {
        // The claim must be able to fail: 16 times the same occluder is as good as one.
        let repeated = SMALL.operator(&[0.0; 16]);
        let values = singular_values(&repeated).unwrap();
        let one = Row::new(&SMALL, 1).unwrap();
        assert_eq!(above(&values, 1e-3), one.above(1e-3));
    }
}
