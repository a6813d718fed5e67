//! Quality over time: the paper's algorithm and the fast one, side by side.

use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Series},
};
use crate::{
    report::text::number,
    settings::{Preset, Settings},
};

/// Shares of the longest time.
const SHARES: [f64; 4] = [0.125, 0.25, 0.5, 1.0];
/// How much sooner the fast preset should be as good as the paper's at the end.
const SOONER: f64 = 4.0;
const PRESETS: [Preset; 2] = [Preset::Fast, Preset::Paper];

/// The study.
pub(super) struct Time;

impl Study for Time {
    fn name(&self) -> &'static str {
        "time"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = bench.trials()?;
        let occluded = trials.iter().filter(|t| t.occluded());
        // Matt captures first: both presets then fit the same materials.
        let mut chosen: Vec<_> = occluded.collect();
        chosen.sort_by_key(|t| t.truth.specular.is_some());
        chosen.truncate(bench.pick([1, usize::MAX]));
        if chosen.is_empty() {
            return Err(StudyError::Nothing("a capture with somebody in the light"));
        }
        let mut rows = Vec::new();
        for trial in chosen {
            let mut curves = Vec::new();
            for preset in PRESETS {
                let mut curve = Vec::new();
                for share in SHARES {
                    let limit = share * bench.seconds();
                    let settings = Settings {
                        preset,
                        time_limit: Some(limit),
                        ..bench.settings(trial)
                    };
                    let words = format!("{}, {}, {limit} s", trial.name, preset.name());
                    let solved = bench.reconstructed(trial, &words, &settings)?;
                    let seconds = solved.found.curve.last().map_or(limit, |p| p.seconds);
                    curve.push([seconds, solved.environment_error(), solved.albedo()]);
                }
                curves.push(curve);
            }
            rows.push(Row {
                name: trial.name.clone(),
                curves,
            });
        }
        Ok(evidence(bench, &rows))
    }
}

/// `[preset][limit]`: seconds, error of light, albedo in decibels.
struct Row {
    name: String,
    curves: Vec<Vec<[f64; 3]>>,
}

impl Row {
    /// When the fast preset was as good as the paper's at its best, if ever.
    fn caught(&self) -> Option<f64> {
        let errors = self.curves[1].iter().map(|p| p[1]);
        let best = errors.fold(f64::INFINITY, f64::min);
        let fast = self.curves[0].iter();
        fast.filter(|p| p[1] <= best).map(|p| p[0]).reduce(f64::min)
    }

    fn longest(&self) -> f64 {
        self.curves[1][SHARES.len() - 1][0]
    }

    fn held(&self) -> bool {
        self.caught().is_some_and(|s| SOONER * s <= self.longest())
    }

    fn sentence(&self) -> String {
        let last = |k: usize| number(self.curves[k][SHARES.len() - 1][1]);
        let caught = match self.caught() {
            Some(seconds) => format!("the fast preset was as good within {} s", number(seconds)),
            None => "the fast preset was never as good".into(),
        };
        format!(
            "{}: after {} s the paper's algorithm leaves a relative RMSE of the light of {}, the fast preset {}; {caught}",
            self.name,
            number(self.longest()),
            last(1),
            last(0)
        )
    }
}

fn evidence(bench: &Bench<'_>, rows: &[Row]) -> Evidence {
    let held: Vec<bool> = rows.iter().map(Row::held).collect();
    let sentences: Vec<String> = rows.iter().map(Row::sentence).collect();
    let numbers: Map<String, Value> = rows
        .iter()
        .map(|row| {
            let curve = |k: usize| {
                let list = |i: usize| row.curves[k].iter().map(|p| p[i]).collect::<Vec<_>>();
                json!({"seconds": list(0), "environment_relative_rmse": list(1), "albedo_psnr": list(2)})
            };
            (row.name.clone(), json!({"fast": curve(0), "paper": curve(1)}))
        })
        .collect();
    let figures = rows
        .iter()
        .map(|row| {
            let all = || row.curves.iter().flatten();
            let high = all().map(|p| p[0]).fold(0.0, f64::max);
            let worst = all().map(|p| p[1]).fold(0.0, f64::max);
            let series = |k: usize| {
                let points = row.curves[k].iter().map(|p| [p[0], p[1]]).collect();
                Series::line(PRESETS[k].name(), points)
            };
            Figure {
                name: format!("{}-over-time", row.name),
                caption: "Relative RMSE of the light over seconds of solving.".into(),
                content: Content::Chart(Chart {
                    x: Axis::linear("seconds", [0.0, 1.05 * high]),
                    y: Axis::linear("relative RMSE of the light", [0.0, 1.1 * worst]),
                    series: vec![series(0), series(1)],
                }),
            }
        })
        .collect();
    Evidence {
        name: "time",
        title: "Quality over time, the paper's algorithm and ours",
        source: "Beyond the paper",
        claim: "Second-order steps reach what the paper's algorithm reaches, in a quarter of its time or less.",
        verdict: Verdict::of(&held),
        sentence: sentences.join("; ") + ".",
        numbers: Value::Object(numbers),
        figures,
        notes: vec![format!(
            "Each point is a run of its own with that time limit, on {} thread(s): both schedules depend on the limit. Seconds are \
             those of solving. The paper's algorithm took hours on eight graphics cards in the paper; here it runs on a processor, \
             from its own start.",
            bench.threads
        )],
    }
}
