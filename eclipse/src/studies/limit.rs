//! What a capture can resolve, before anything is solved: the error of the best linear estimate of its light.

use std::rc::Rc;

use render::image::Image;
use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone},
};
use crate::{
    capture::Capture,
    inspect::limit::{Grain, Limit, MODEL_ERROR, limits},
    report::text::number,
};

/// An occluder that leaves more than this share of the error without it helps too little to be called help.
const HELPS: f64 = 0.9;
/// Quick, full.
const GRAINS: [Grain; 2] = [
    Grain {
        rows: 16,
        patches: 300,
    },
    Grain {
        rows: 25,
        patches: 800,
    },
];

/// The study.
pub(super) struct InformationLimit;

impl Study for InformationLimit {
    fn name(&self) -> &'static str {
        "limit"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let captures: Vec<(String, Rc<Capture>)> = bench.photographs()?;
        let mut studied = Vec::new();
        for (name, capture) in &captures {
            if bench.stopped() {
                return Err(StudyError::Stopped);
            }
            studied.push(Studied {
                name: name.clone(),
                limits: limits(capture, bench.pick(GRAINS), MODEL_ERROR, 0)?,
            });
            (bench.tell)(&format!(
                "{name}: {}",
                studied[studied.len() - 1].sentence()
            ));
        }
        Ok(evidence(bench, &studied))
    }
}

/// A capture's limits.
struct Studied {
    name: String,
    limits: Vec<Limit>,
}

impl Studied {
    fn of(&self, operator: bool, albedo: bool) -> &Limit {
        let wanted = |l: &&Limit| l.known.operator == operator && l.known.albedo == albedo;
        self.limits.iter().find(wanted).expect("all were computed")
    }

    /// What somebody in the light, at a known place, leaves of the error when the albedo is not known.
    fn held(&self) -> bool {
        self.of(true, false).error < HELPS * self.of(false, false).error
    }

    fn sentence(&self) -> String {
        let error = |operator, albedo| number(self.of(operator, albedo).error);
        format!(
            "the best linear estimate of light by texels of {}° is off by {} of its variation with somebody at a known place in the \
             light and the albedo unknown, by {} with nobody there ({} and {} with the albedo known)",
            number(180.0 / self.of(true, true).grid.rows as f64),
            error(true, false),
            error(false, false),
            error(true, true),
            error(false, true),
        )
    }
}

fn label(limit: &Limit) -> String {
    format!(
        "{}, albedo {}",
        if limit.known.operator {
            "somebody"
        } else {
            "nobody"
        },
        if limit.known.albedo {
            "known"
        } else {
            "unknown"
        }
    )
}

fn evidence(bench: &Bench<'_>, studied: &[Studied]) -> Evidence {
    let held: Vec<bool> = studied.iter().map(Studied::held).collect();
    let sentences: Vec<String> = studied
        .iter()
        .map(|s| {
            let why = if s.held() {
                ""
            } else {
                ": nobody in the light is as good, or nearly, since the surface's own shadows tell as much or the noise hides both"
            };
            format!("{}: {}{why}", s.name, s.sentence())
        })
        .collect();
    let numbers: Map<String, Value> = studied
        .iter()
        .map(|s| {
            let of = |limit: &Limit| {
                let revealed = limit.revealed.iter();
                let revealed: Map<String, Value> = revealed
                    .map(|(degrees, share)| (format!("{} degrees", number(*degrees)), json!(share)))
                    .collect();
                (
                    label(limit),
                    json!({"error": limit.error, "revealed": revealed}),
                )
            };
            let table: Map<String, Value> = s.limits.iter().map(of).collect();
            (s.name.clone(), Value::Object(table))
        })
        .collect();
    let grain = bench.pick(GRAINS);
    Evidence {
        name: "limit",
        title: "What the photographs can tell of the light at best",
        source: "Beyond the paper; compare its Fig. 3",
        claim: "Somebody who moves through the light makes visible what the object alone blurs away, so that light can be told from \
                albedo.",
        verdict: Verdict::of(&held),
        sentence: sentences.join("; ") + ".",
        numbers: Value::Object(numbers),
        figures: studied.iter().flat_map(figures).collect(),
        notes: vec![
            format!(
                "One channel on {} x {} texels, about {} patches of surface in every photograph that sees them, noise as the \
                 photographs show it, and {} % of each value left to what the right model would not explain. Light is 1 on average \
                 with independent texels of variance 1: an error of 1 means that nothing is known but that.",
                grain.rows,
                2 * grain.rows,
                grain.patches,
                100.0 * MODEL_ERROR
            ),
            "Somebody is the outline that a reconstruction starts from, upright behind each camera, at a place that is taken to be \
             known; a reconstruction has to find it. The albedo is a number a patch, known or eliminated, which does as well as \
             anybody could. No estimate that is linear in the photographs can do better on average over such light; light of few \
             lamps has more structure, and an estimate that uses it can."
                .into(),
        ],
    }
}

fn figures(studied: &Studied) -> [Figure; 2] {
    let series = |limit: &Limit| {
        let points = limit.revealed.iter().map(|&(x, y)| [x, y]).collect();
        Series::line(label(limit), points)
    };
    let all = studied.limits.iter().flat_map(|l| l.revealed.iter());
    let coarsest = all.map(|r| r.0).fold(1.0, f64::max);
    let resolved = Figure {
        name: format!("{}-resolved", studied.name),
        caption: "The share of the light's variance that the photographs reveal, over the size of the detail: 1 is everything, 0 \
                  nothing."
            .into(),
        content: Content::Chart(Chart {
            x: Axis::linear("size of detail, degrees", [0.0, 1.05 * coarsest]),
            y: Axis::linear("share of variance revealed", [0.0, 1.0]),
            series: studied.limits.iter().map(series).collect(),
        }),
    };
    let picture = |limit: &Limit| Picture {
        label: format!("{}: {}", label(limit), number(limit.error)),
        values: Image {
            width: limit.grid.columns,
            height: limit.grid.rows,
            channels: 1,
            data: limit.left.clone(),
        },
        tone: Tone::Heat {
            low: 0.0,
            high: 1.0,
        },
    };
    let left = Figure {
        name: format!("{}-left", studied.name),
        caption: "The error that is left at best in each direction, top +z, centre +x: blue is known, red is not.".into(),
        content: Content::Pictures(studied.limits.iter().map(picture).collect()),
    };
    [resolved, left]
}
