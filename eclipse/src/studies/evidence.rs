//! What a study finds: a verdict on the paper's claim, the numbers behind it, and figures with their data.

use render::image::Image;
use serde::Serialize;
use serde_json::Value;

use crate::report::text::number;

/// Whether the paper's claim held here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// In every part.
    Held,
    /// Some parts did; the sentence says which did not, or were not tested, and why.
    HeldInPart,
    /// It did not.
    DidNotHold,
    /// What it takes was not at hand.
    NotTested,
}

impl Verdict {
    /// From the outcomes of a claim's parts that were tested.
    pub fn of(parts: &[bool]) -> Self {
        match parts.iter().filter(|&&held| held).count() {
            _ if parts.is_empty() => Self::NotTested,
            n if n == parts.len() => Self::Held,
            0 => Self::DidNotHold,
            _ => Self::HeldInPart,
        }
    }

    /// The same of all parts, `None` where one was not tested: without it the claim does not hold as a whole.
    pub fn of_all(parts: &[Option<bool>]) -> Self {
        let tested: Vec<bool> = parts.iter().flatten().copied().collect();
        match Self::of(&tested) {
            Self::Held if tested.len() < parts.len() => Self::HeldInPart,
            verdict => verdict,
        }
    }

    /// As the first words of a page.
    pub fn words(self) -> &'static str {
        match self {
            Self::Held => "The claim held here",
            Self::HeldInPart => "The claim held here in part",
            Self::DidNotHold => "The claim did not hold here",
            Self::NotTested => "The claim was not tested here",
        }
    }
}

/// Numbers one after the other, in three digits.
pub fn listed(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|v| number(*v)).collect();
    words.join(", ")
}

/// The mean; no number of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Least and most; no number where one is none, which then is no better than anything.
pub fn range(values: &[f64]) -> [f64; 2] {
    if values.is_empty() || values.iter().any(|v| v.is_nan()) {
        return [f64::NAN; 2];
    }
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    values
        .iter()
        .fold(none, |[low, high], v| [low.min(*v), high.max(*v)])
}

/// What is to be said of a claim's parts that failed, each in the words that say so; nothing where all held.
pub fn but<W: AsRef<str>>(parts: &[(W, bool)]) -> String {
    let failed = parts.iter().filter(|(_, held)| !held);
    let failed: Vec<&str> = failed.map(|(words, _)| words.as_ref()).collect();
    match failed.is_empty() {
        true => String::new(),
        false => format!(" But {}.", failed.join("; ")),
    }
}

/// Seeds in words.
pub fn seeds(count: u64) -> String {
    match count {
        1 => "one seed".to_owned(),
        n => format!("{n} seeds"),
    }
}

/// The result of a study.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// The study's name.
    pub name: &'static str,
    /// A heading.
    pub title: &'static str,
    /// Which part of the paper.
    pub source: &'static str,
    /// What the paper says, in our words.
    pub claim: &'static str,
    /// Whether it held.
    pub verdict: Verdict,
    /// The numbers that decide, and where it did not hold, why. Follows [`Verdict::words`] and a colon: short enough for one look.
    pub sentence: String,
    /// The same in full, a paragraph each, below it.
    pub details: Vec<String>,
    /// Every number, for the table and for JSON.
    pub numbers: Value,
    /// What is shown.
    pub figures: Vec<Figure>,
    /// How it was computed, and what the paper leaves out. A paragraph each.
    pub notes: Vec<String>,
}

/// The part of the evidence that programs read.
#[derive(Clone, Debug, Serialize)]
pub struct Summary<'a> {
    /// The study's name.
    pub study: &'a str,
    /// Which part of the paper.
    pub source: &'a str,
    /// What the paper says.
    pub claim: &'a str,
    /// Whether it held.
    pub verdict: Verdict,
    /// The page's first line.
    pub sentence: String,
    /// What follows it.
    pub details: &'a [String],
    /// Every number.
    pub numbers: &'a Value,
}

impl Evidence {
    /// The page's first line.
    pub fn first_line(&self) -> String {
        format!("{}: {}", self.verdict.words(), self.sentence)
    }

    /// What programs read.
    pub fn summary(&self) -> Summary<'_> {
        Summary {
            study: self.name,
            source: self.source,
            claim: self.claim,
            verdict: self.verdict,
            sentence: self.first_line(),
            details: &self.details,
            numbers: &self.numbers,
        }
    }
}

/// One figure; its files are called after `name`.
#[derive(Clone, Debug)]
pub struct Figure {
    /// A name for files.
    pub name: String,
    /// What is seen and what to conclude.
    pub caption: String,
    /// What is drawn.
    pub content: Content,
}

impl Figure {
    /// What was measured of `places` with every seed, in several ways: labels, each with `[place][seed]`.
    pub fn of_seeds(
        name: &str,
        what: &str,
        value: &str,
        places: &[String],
        ways: &[(&str, Vec<Vec<f64>>)],
    ) -> Self {
        let series = ways.iter().flat_map(|(label, values)| {
            let places = values.iter().enumerate();
            Series::dots_by_seed(
                label,
                places.map(|(index, seeds)| (index as f64 + 1.0, seeds.clone())),
            )
        });
        let all = ways.iter().flat_map(|(_, values)| values.iter().flatten());
        let most = all.copied().filter(|v| v.is_finite()).fold(1e-3, f64::max);
        let numbered = places.iter().zip(1..);
        let numbered: Vec<String> = numbered.map(|(name, n)| format!("{n} {name}")).collect();
        Self {
            name: name.to_owned(),
            caption: format!("{what}, a dot a seed: {}.", numbered.join(", ")),
            content: Content::Chart(Chart {
                x: Axis::linear("as numbered below", [0.0, places.len() as f64 + 1.0]),
                y: Axis::linear(value, [0.0, 1.1 * most]),
                series: series.collect(),
            }),
        }
    }
}

/// What a figure shows.
#[derive(Clone, Debug)]
pub enum Content {
    /// Curves or dots.
    Chart(Chart),
    /// Images side by side.
    Pictures(Vec<Picture>),
}

/// Curves or dots over two axes.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Along the bottom.
    pub x: Axis,
    /// Up the side.
    pub y: Axis,
    /// In the order of the legend.
    pub series: Vec<Series>,
}

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Its label.
    pub label: String,
    /// The ends; on a logarithmic axis both positive.
    pub range: [f64; 2],
    /// Whether equal ratios are equal steps.
    pub logarithmic: bool,
}

impl Axis {
    /// Equal steps.
    pub fn linear(label: impl Into<String>, range: [f64; 2]) -> Self {
        Self {
            label: label.into(),
            range,
            logarithmic: false,
        }
    }

    /// Equal ratios.
    pub fn logarithmic(label: impl Into<String>, range: [f64; 2]) -> Self {
        Self {
            label: label.into(),
            range,
            logarithmic: true,
        }
    }
}

/// One curve or cloud of dots.
#[derive(Clone, Debug)]
pub struct Series {
    /// In the legend and the data.
    pub label: String,
    /// What is plotted.
    pub points: Vec<[f64; 2]>,
    /// Dots that are not joined.
    pub dots: bool,
    /// The seed that it was computed with, where there are several; series of one label share a colour.
    pub seed: Option<u64>,
}

impl Series {
    /// A curve.
    pub fn line(label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self {
            label: label.into(),
            points,
            dots: false,
            seed: None,
        }
    }

    /// Dots.
    pub fn dots(label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self {
            dots: true,
            ..Self::line(label, points)
        }
    }

    /// Dots of each seed: at every x the values of all seeds, in their order from zero on.
    pub fn dots_by_seed(
        label: &str,
        values: impl IntoIterator<Item = (f64, Vec<f64>)>,
    ) -> Vec<Self> {
        let mut series: Vec<Self> = Vec::new();
        for (x, of_seeds) in values {
            for (seed, y) in of_seeds.into_iter().enumerate() {
                if seed == series.len() {
                    series.push(Self::dots(label, Vec::new()).of_seed(seed as u64));
                }
                series[seed].points.push([x, y]);
            }
        }
        series
    }

    /// The same, of a seed.
    pub fn of_seed(self, seed: u64) -> Self {
        Self {
            seed: Some(seed),
            ..self
        }
    }
}

/// One image of a figure, with its values.
#[derive(Clone, Debug)]
pub struct Picture {
    /// In the caption below and the data.
    pub label: String,
    /// The values, of one channel or three.
    pub values: Image,
    /// How they are shown.
    pub tone: Tone,
}

impl Picture {
    /// Linear light, or shares of it, this value being white.
    pub fn light(label: impl Into<String>, values: &Image, white: f32) -> Self {
        Self {
            label: label.into(),
            values: values.clone(),
            tone: Tone::Light { white },
        }
    }
}

/// How values become colours.
#[derive(Clone, Copy, Debug)]
pub enum Tone {
    /// Linear light, this radiance being white.
    Light {
        /// Radiance of white.
        white: f32,
    },
    /// Small in blue, large in red, between these values; the first channel only.
    Heat {
        /// Full blue.
        low: f32,
        /// Full red.
        high: f32,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_without_parts_was_not_tested() {
        assert_eq!(Verdict::of(&[]), Verdict::NotTested);
        assert_eq!(Verdict::of(&[true, true]), Verdict::Held);
        assert_eq!(Verdict::of(&[true, false]), Verdict::HeldInPart);
        assert_eq!(Verdict::of(&[false]), Verdict::DidNotHold);
    }

    #[test]
    fn what_was_not_tested_keeps_a_claim_from_holding() {
        let of = Verdict::of_all;
        assert_eq!(of(&[Some(true), Some(true)]), Verdict::Held);
        assert_eq!(of(&[Some(true), None]), Verdict::HeldInPart);
        assert_eq!(of(&[Some(false), None]), Verdict::DidNotHold);
        assert_eq!(of(&[Some(true), None, Some(false)]), Verdict::HeldInPart);
        assert_eq!(of(&[None, None]), Verdict::NotTested);
    }

    #[test]
    fn parts_that_failed_are_told_and_no_others() {
        assert_eq!(but(&[("it rains", true)]), "");
        let parts = [("it rains", false), ("it snows", true), ("it hails", false)];
        assert_eq!(but(&parts), " But it rains; it hails.");
    }

    #[test]
    fn a_range_with_a_hole_is_no_better_than_anything() {
        assert_eq!(range(&[2.0, 0.5, 1.0]), [0.5, 2.0]);
        for values in [&[][..], &[1.0, f64::NAN]] {
            assert!(range(values).iter().all(|v| v.is_nan()));
        }
    }
}
