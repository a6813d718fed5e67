//! Quality over time: the paper's algorithm and the fast one, side by side, and what the fast one has to reach in a quarter of the
//! time.

use std::rc::Rc;

use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Series, listed, mean, range, seeds},
    trial::{Solved, Trial},
};
use crate::{
    report::text::number,
    settings::{OccluderPrior, Preset, Settings},
};

/// Shares of the time limit that are solved for: at a glance, quick, in full.
const SHARES: [&[f64]; 3] = [
    &[QUARTER, 1.0],
    &[QUARTER, 0.5, 1.0],
    &[0.125, QUARTER, 0.5, 1.0],
];
/// The share in which the fast preset is to be as good as a bar asks, and as the paper's algorithm ever is.
const QUARTER: f64 = 0.25;
/// Relative RMSE of the light that a matt capture with somebody in the light is to come below: with a figure assumed behind the
/// camera, and with nothing assumed of occluders.
const BARS: [f64; 2] = [0.54, 0.62];
/// The time in seconds that those bars are set for.
const BAR_SECONDS: f64 = 600.0;

/// The study.
pub(super) struct Time;

impl Study for Time {
    fn name(&self) -> &'static str {
        "time"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = bench.trials()?.into_iter();
        let mut chosen: Vec<Rc<Trial>> = trials.filter(|t| t.occluded()).collect();
        // Matt captures first: both presets then fit the same materials, and there is a bar.
        chosen.sort_by_key(|t| t.truth.specular.is_some());
        chosen.truncate(bench.pick([1, usize::MAX]));
        let rows = bench.each_trial(&chosen, |trial| Row::new(bench, trial))?;
        match rows.is_empty() {
            true => Err(bench.nothing("a capture with somebody in the light")),
            false => Ok(evidence(bench, &rows)),
        }
    }
}

/// A capture's curves.
struct Row {
    name: String,
    /// Whether there is a bar for captures of this kind.
    matt: bool,
    /// The time limit in seconds, and the shares of it that were solved for.
    limit: f64,
    shares: &'static [f64],
    /// The error of the best constant map.
    constant: f64,
    seeds: Vec<Curves>,
}

/// What one seed reached, `[share]` each.
struct Curves {
    seed: u64,
    /// The fast preset with a figure assumed behind the camera.
    figure: Vec<Point>,
    /// The same with nothing assumed of occluders, as in the paper.
    anywhere: Vec<Point>,
    /// The paper's algorithm.
    paper: Vec<Point>,
}

/// Where a solve ended.
#[derive(Clone, Copy)]
struct Point {
    /// Of solving.
    seconds: f64,
    /// Relative RMSE of the light.
    error: f64,
    /// Decibels.
    albedo: f64,
}

impl Point {
    fn new(solved: &Solved, limit: f64) -> Self {
        Self {
            seconds: solved.found.curve.last().map_or(limit, |p| p.seconds),
            error: solved.environment_error(),
            albedo: solved.albedo(),
        }
    }
}

impl Row {
    fn new(bench: &Bench<'_>, trial: &Trial) -> Result<Self, StudyError> {
        let shares = bench.of_scale(SHARES);
        let seeds = bench.each(bench.seeds(), |seed| {
            let curve = |way: Way| -> Result<Vec<Point>, StudyError> {
                let points = shares.iter();
                points
                    .map(|share| solve(bench, trial, way, *share, seed))
                    .collect()
            };
            Ok(Curves {
                seed,
                figure: curve(Way::Figure)?,
                anywhere: curve(Way::Anywhere)?,
                paper: curve(Way::Paper)?,
            })
        })?;
        Ok(Self {
            name: trial.name.clone(),
            matt: trial.truth.specular.is_none(),
            limit: bench.seconds(),
            shares,
            constant: trial.constant_error(),
            seeds,
        })
    }

    /// Errors after a share of the time, a seed each.
    fn at(&self, way: Way, share: usize) -> Vec<f64> {
        self.seeds.iter().map(|s| way.of(s)[share].error).collect()
    }

    /// The best that any seed of the paper's algorithm had after any share of the time.
    fn best_of_paper(&self) -> f64 {
        let points = self.seeds.iter().flat_map(|s| &s.paper);
        range(&points.map(|p| p.error).collect::<Vec<_>>())[0]
    }

    /// The first share of the time after which the worst seed of a way was as good as that, if any.
    fn caught(&self, way: Way) -> Option<f64> {
        let best = self.best_of_paper();
        let caught = |&index: &usize| range(&self.at(way, index))[1] <= best;
        (0..self.shares.len())
            .find(caught)
            .map(|index| self.shares[index])
    }

    /// The share that bars are of.
    fn quarter(&self) -> usize {
        let quarter = self.shares.iter().position(|share| *share == QUARTER);
        quarter.unwrap_or(0)
    }

    /// The claim's parts, by the worst seed: with either assumption on occluders the bar, where there is one, and the paper's
    /// algorithm. A bar that is missed in less time than it is of was not tested, nor was the comparison with an algorithm that found nothing.
    fn parts(&self) -> Vec<Option<bool>> {
        let bars = FAST.iter().zip(BARS).filter(|_| self.matt);
        let bars = bars.map(|(way, bar)| self.reached(*way, bar));
        let found = self.best_of_paper() < self.constant;
        let sooner = FAST.iter().map(|way| {
            let sooner = self.caught(*way).is_some_and(|share| share <= QUARTER);
            found.then_some(sooner)
        });
        bars.chain(sooner).collect()
    }

    /// Whether the worst seed came below a bar after a quarter of the time: less time than the bar is of shows nothing where it did not,
    /// more shows nothing where it did.
    fn reached(&self, way: Way, bar: f64) -> Option<bool> {
        let worst = range(&self.at(way, self.quarter()))[1];
        match worst < bar {
            true => (self.limit <= BAR_SECONDS).then_some(true),
            // What failed altogether does not come of the time.
            false => (self.limit >= BAR_SECONDS || worst.is_nan()).then_some(false),
        }
    }

    /// For one look: both ways against their bars and against the paper's algorithm.
    fn sentence(&self) -> String {
        let limit = number(self.limit);
        let ways = FAST.iter().zip(BARS).map(|(way, bar)| {
            let bar = match (self.matt, self.reached(*way, bar)) {
                (false, _) => String::new(),
                (true, Some(true)) => format!("bar {bar} reached, "),
                (true, Some(false)) => format!("bar {bar} not reached, "),
                (true, None) => format!("bar {bar} not tested, "),
            };
            format!(
                "{} {} ({bar}{})",
                listed(&self.at(*way, self.quarter())),
                way.words(),
                match self.caught(*way) {
                    Some(share) => format!(
                        "after {} s as good as the paper's algorithm at its best",
                        number(share * self.limit)
                    ),
                    None => "never as good as the paper's algorithm at its best".to_owned(),
                }
            )
        });
        format!(
            "{}: after a quarter of {limit} s the light's relative RMSE is {}; the paper's algorithm comes to {} at its best{}",
            self.name,
            ways.collect::<Vec<_>>().join(", "),
            number(self.best_of_paper()),
            match self.best_of_paper() < self.constant {
                true => "",
                false => ", no better than a constant map",
            }
        )
    }

    /// The same at every share of the time, and what it says.
    fn details(&self) -> Vec<String> {
        let seconds: Vec<f64> = self.shares.iter().map(|s| s * self.limit).collect();
        let curve = |way: Way| -> String {
            let shares = 0..self.shares.len();
            let errors: Vec<String> = shares.map(|share| listed(&self.at(way, share))).collect();
            format!("{} {}", way.words(), errors.join(" / "))
        };
        let mut details = vec![format!(
            "{}: relative RMSE of the light, a seed each, after {} s: {}; the best constant map {}.",
            self.name,
            listed(&seconds),
            Way::ALL.map(curve).join("; "),
            number(self.constant)
        )];
        let last = self.shares.len() - 1;
        let [soon, late] = [0, last].map(|share| mean(&self.at(Way::Paper, share)));
        if late > soon {
            details.push(format!(
                "{}: the paper's algorithm is worse after {} s than after {} ({} and {}, means); why was not found.",
                self.name,
                number(self.limit),
                number(seconds[0]),
                number(late),
                number(soon)
            ));
        }
        if self.matt && self.limit < BAR_SECONDS {
            details.push(format!(
                "{}: the bars are of {} s, a quarter of which is {} s: one that is missed in less was not tested.",
                self.name,
                number(BAR_SECONDS),
                number(QUARTER * BAR_SECONDS)
            ));
        }
        if !self.matt {
            details.push(format!(
                "{}: no bar is known for a glossy capture, which is compared with the paper's algorithm alone.",
                self.name
            ));
        }
        details
    }

    fn numbers(&self) -> Value {
        let curve = |points: &[Point]| {
            let list = |of: fn(&Point) -> f64| points.iter().map(of).collect::<Vec<_>>();
            json!({
                "seconds": list(|p| p.seconds),
                "environment_relative_rmse": list(|p| p.error),
                "albedo_psnr": list(|p| p.albedo),
            })
        };
        let of = |s: &Curves| {
            let curves = Way::ALL.map(|way| (way.key().to_owned(), curve(way.of(s))));
            let curves: Map<String, Value> = curves.into_iter().collect();
            (format!("seed {}", s.seed), Value::Object(curves))
        };
        let mut table: Map<String, Value> = self.seeds.iter().map(of).collect();
        let limits = self.shares.iter().map(|s| s * self.limit);
        table.insert("limits".into(), json!(limits.collect::<Vec<_>>()));
        table.insert("map_of_one_value".into(), json!(self.constant));
        Value::Object(table)
    }

    /// A line a seed.
    fn figure(&self) -> Figure {
        let mut series: Vec<Series> = Way::ALL
            .iter()
            .flat_map(|way| self.seeds.iter().map(move |of| (way, of)))
            .map(|(way, of)| {
                let points = way.of(of).iter().map(|p| [p.seconds, p.error]).collect();
                Series::line(way.label(), points).of_seed(of.seed)
            })
            .collect();
        let all = || series.iter().flat_map(|s| &s.points);
        let high = all().map(|p| p[0]).fold(0.0, f64::max);
        let worst = all().map(|p| p[1]).fold(self.constant, f64::max);
        let constant = vec![[0.0, self.constant], [1.05 * high, self.constant]];
        series.push(Series::line("best constant map", constant));
        Figure {
            name: format!("{}-over-time", self.name),
            caption: "Relative RMSE of the light over seconds of solving; a line a seed.".into(),
            content: Content::Chart(Chart {
                x: Axis::linear("seconds", [0.0, 1.05 * high]),
                y: Axis::linear("relative RMSE of the light", [0.0, 1.1 * worst]),
                series,
            }),
        }
    }
}

/// How a capture is solved.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    /// The fast preset with a figure assumed behind the camera.
    Figure,
    /// The same with nothing assumed of occluders.
    Anywhere,
    /// The paper's algorithm.
    Paper,
}

/// What is claimed of, in the order of [`BARS`].
const FAST: [Way; 2] = [Way::Figure, Way::Anywhere];

impl Way {
    const ALL: [Self; 3] = [Self::Figure, Self::Anywhere, Self::Paper];

    fn of(self, curves: &Curves) -> &[Point] {
        match self {
            Self::Figure => &curves.figure,
            Self::Anywhere => &curves.anywhere,
            Self::Paper => &curves.paper,
        }
    }

    /// In sentences, after a number.
    fn words(self) -> &'static str {
        match self {
            Self::Figure => "with a figure assumed",
            Self::Anywhere => "with nothing assumed of occluders",
            Self::Paper => "by the paper's algorithm",
        }
    }

    /// In legends.
    fn label(self) -> &'static str {
        match self {
            Self::Figure => "fast",
            Self::Anywhere => "fast, no figure",
            Self::Paper => "paper",
        }
    }

    /// For programs.
    fn key(self) -> &'static str {
        match self {
            Self::Figure => "fast",
            Self::Anywhere => "fast_with_nothing_assumed",
            Self::Paper => "paper",
        }
    }
}

/// What comes of a share of the time.
fn solve(
    bench: &Bench<'_>,
    trial: &Trial,
    way: Way,
    share: f64,
    seed: u64,
) -> Result<Point, StudyError> {
    let limit = share * bench.seconds();
    let (preset, occluder_prior) = match way {
        // All of it is what other studies have solved already.
        Way::Figure if share == 1.0 => {
            return Ok(Point::new(&*bench.solve(trial, true, seed)?, limit));
        }
        Way::Anywhere if share == 1.0 => {
            return Ok(Point::new(&*bench.solve_anywhere(trial, seed)?, limit));
        }
        Way::Figure => (Preset::Fast, OccluderPrior::Operator),
        Way::Anywhere => (Preset::Fast, OccluderPrior::None),
        Way::Paper => (Preset::Paper, OccluderPrior::default()),
    };
    let settings = Settings {
        time_limit: Some(limit),
        occluder_prior,
        seed,
        ..bench.settings_of(preset, trial)
    };
    let (label, seconds) = (way.label(), number(limit));
    let words = format!("{}, {label}, {seconds} s, seed {seed}", trial.name);
    let solved = bench.reconstructed(trial, &words, &settings)?;
    Ok(Point::new(&solved, limit))
}

/// The claim's parts on all captures. Its bars are of matt ones: without any they were not tested.
fn parts(rows: &[Row]) -> Vec<Option<bool>> {
    let bars = match rows.iter().any(|row| row.matt) {
        true => None,
        false => Some(None),
    };
    rows.iter().flat_map(Row::parts).chain(bars).collect()
}

fn evidence(bench: &Bench<'_>, rows: &[Row]) -> Evidence {
    let held = parts(rows);
    let sentences: Vec<String> = rows.iter().map(Row::sentence).collect();
    let numbers: Map<String, Value> = rows
        .iter()
        .map(|row| (row.name.clone(), row.numbers()))
        .collect();
    Evidence {
        name: "time",
        title: "Quality over time, the paper's algorithm and ours",
        source: "Beyond the paper",
        claim: "Second-order steps reach in a quarter of the time what is asked of a reconstruction, and what the paper's algorithm \
                reaches at any time within the limit, with a figure assumed behind the camera and with nothing assumed of occluders.",
        verdict: Verdict::of_all(&held),
        sentence: sentences.join(". ") + ".",
        numbers: Value::Object(numbers),
        figures: rows.iter().map(Row::figure).collect(),
        details: rows.iter().flat_map(Row::details).collect(),
        notes: vec![
            format!(
                "Each point is a run of its own with that time limit, on {} thread(s), {}: both schedules depend on the limit. Every part \
                 of the claim is judged by the worst seed of the fast preset. Seconds are those of solving.",
                bench.threads,
                seeds(bench.seeds().end)
            ),
            "The bars are what this project asks of a matt capture with somebody in the light, 64 photographs of 128 x 128 pixels, in ten \
             minutes on two cores. The paper's algorithm took hours on eight graphics cards in the paper; here it runs on a processor, \
             from its own start, and assumes nothing of occluders: with nothing assumed, the fast preset is told no more than that."
                .into(),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two seeds whose errors are those given, `[share]` each; the best constant map leaves 0.96.
    fn row(matt: bool, limit: f64, [figure, anywhere, paper]: [[[f64; 2]; 2]; 3]) -> Row {
        let point = |error| Point {
            seconds: 1.0,
            error,
            albedo: 20.0,
        };
        let curve = |errors: [f64; 2]| errors.map(point).to_vec();
        let curves = [0, 1].map(|seed| Curves {
            seed: seed as u64,
            figure: curve(figure[seed]),
            anywhere: curve(anywhere[seed]),
            paper: curve(paper[seed]),
        });
        Row {
            name: "potatoes".into(),
            matt,
            limit,
            shares: SHARES[0],
            constant: 0.96,
            seeds: curves.into(),
        }
    }

    const PAPER: [[f64; 2]; 2] = [[0.95, 0.9], [0.94, 0.88]];
    const FIGURE: [[f64; 2]; 2] = [[0.5, 0.4], [0.53, 0.42]];
    const ANYWHERE: [[f64; 2]; 2] = [[0.6, 0.5]; 2];

    #[test]
    fn the_worst_seed_decides_at_a_quarter_of_the_time() {
        let good = row(true, 600.0, [FIGURE, ANYWHERE, PAPER]);
        assert_eq!(good.parts(), [Some(true); 4]);
        assert_eq!(good.caught(Way::Figure), Some(0.25));
        let sentence = good.sentence();
        assert!(
            sentence.contains(
                "0.5, 0.53 with a figure assumed (bar 0.54 reached, after 150 s as good as"
            ),
            "{sentence}"
        );
        let [none, yes, no] = [None, Some(true), Some(false)];

        let (slow, poor) = ([[0.5, 0.4], [0.55, 0.42]], [[0.63, 0.5]; 2]);
        let short = row(true, 60.0, [slow, poor, PAPER]);
        assert_eq!(short.parts(), [none, none, yes, yes]);
        assert!(short.sentence().contains("bar 0.54 not tested"));
        assert!(
            short
                .details()
                .concat()
                .contains("a quarter of which is 150 s")
        );
        let early = row(true, 60.0, [FIGURE, poor, PAPER]);
        assert_eq!(early.parts(), [yes, none, yes, yes]);
        let late = row(true, 600.0, [slow, poor, PAPER]);
        assert_eq!(late.parts(), [no, no, yes, yes]);
        assert!(late.sentence().contains("bar 0.62 not reached"));

        let broken = row(
            true,
            600.0,
            [[[0.5, 0.4], [f64::NAN, 0.42]], ANYWHERE, PAPER],
        );
        assert_eq!(broken.parts(), [no, yes, no, yes]);
        assert_eq!(broken.caught(Way::Figure), Some(1.0));

        // More time than the bars are of shows nothing where they are reached.
        let long = row(true, 2400.0, [FIGURE, poor, PAPER]);
        assert_eq!(long.parts(), [none, no, yes, yes]);
        assert_eq!(parts(&[long]), [none, no, yes, yes]);
    }

    #[test]
    fn with_nothing_assumed_it_has_to_come_to_the_papers_as_well() {
        let late = row(true, 600.0, [FIGURE, [[0.6, 0.5], [0.9, 0.5]], PAPER]);
        let parts = late.parts();
        assert_eq!(parts[2..], [Some(true), Some(false)]);
        let sentence = late.sentence();
        assert!(
            sentence.contains("with nothing assumed of occluders (bar 0.62 not reached, after 600 s as good as the paper's algorithm at its best)"),
            "{sentence}"
        );
        let never = row(true, 600.0, [FIGURE, [[0.9, 0.9]; 2], PAPER]);
        assert!(never.sentence().contains("never as good"));
    }

    #[test]
    fn that_the_papers_algorithm_becomes_worse_is_told() {
        let told = |paper| {
            let row = row(true, 600.0, [FIGURE, ANYWHERE, paper]);
            row.details().concat().contains("is worse after 600 s")
        };
        assert!(!told(PAPER));
        assert!(told([[0.8, 0.9], [0.85, 0.84]]));
    }

    #[test]
    fn glossy_captures_are_compared_with_the_paper_alone() {
        let nothing = [[0.97, 0.96], [1.0, 0.99]];
        let row = row(false, 600.0, [[[0.5, 0.4]; 2], ANYWHERE, nothing]);
        // To be as good as what found nothing shows nothing.
        assert_eq!(row.parts(), [None; 2]);
        let sentence = row.sentence();
        assert!(
            sentence.contains("no better than a constant map"),
            "{sentence}"
        );
        assert!(row.details().concat().contains("no bar is known"));
        assert_eq!(parts(&[row]), [None; 3]);
    }
}
