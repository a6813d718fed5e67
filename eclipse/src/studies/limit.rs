//! What a capture can resolve, before anything is solved: the error of the best linear estimate of its light.

use std::rc::Rc;

use render::image::Image;
use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone, listed, range, seeds},
};
use crate::{
    capture::Capture,
    inspect::limit::{Grain, Known, Limit, MODEL_ERROR, limits},
    report::text::number,
};

/// An occluder that leaves more than this share of the error without it helps too little to be called help.
const HELPS: f64 = 0.9;
/// Photographs that leave less than this of the light's variation tell something of it.
const TOLD: f64 = 0.9;
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
        let study = |(name, capture): &(String, Rc<Capture>)| -> Result<Studied, StudyError> {
            let seeds = bench.each(bench.seeds(), |seed| {
                Ok(limits(capture, bench.pick(GRAINS), MODEL_ERROR, seed)?)
            })?;
            let studied = Studied {
                name: name.clone(),
                seeds,
            };
            (bench.tell)(&format!("{name}: {}", studied.sentence()));
            Ok(studied)
        };
        // Whoever asks for one capture is told what is wrong with it; of many, one does not keep the others from an answer.
        let studied = match bench.capture {
            Some(_) => bench.each(&captures, study)?,
            None => bench.each_capture(&captures, |capture| &capture.0, study)?,
        };
        if studied.is_empty() {
            return Err(bench.nothing("a capture of whose object anything is seen"));
        }
        Ok(evidence(bench, &studied))
    }
}

/// A capture's limits.
struct Studied {
    name: String,
    /// `[seed]`: for everything that may be known. A seed chooses the places that patches look at.
    seeds: Vec<Vec<Limit>>,
}

impl Studied {
    /// The limits where this is known, a seed each.
    fn of(&self, operator: bool, albedo: bool) -> Vec<&Limit> {
        let wanted = Known { operator, albedo };
        let all = self.seeds.iter().flatten();
        all.filter(|limit| limit.known == wanted).collect()
    }

    fn errors(&self, operator: bool, albedo: bool) -> Vec<f64> {
        let limits = self.of(operator, albedo);
        limits.iter().map(|limit| limit.error).collect()
    }

    /// What somebody in the light, at a known place, leaves of the error with the albedo known or not: in the worst seed.
    fn left(&self, albedo: bool) -> f64 {
        let (with, without) = (self.errors(true, albedo), self.errors(false, albedo));
        let shares: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a / b).collect();
        range(&shares)[1]
    }

    /// Whether somebody there tells light from albedo and, beyond that, shows what the object's own shadows do not. Without anybody
    /// an unknown albedo a patch explains nearly all that a matt object shows: the former alone would be little to ask.
    fn parts(&self) -> [bool; 2] {
        [false, true].map(|albedo| self.left(albedo) < HELPS)
    }

    fn held(&self) -> bool {
        self.parts() == [true; 2]
    }

    fn sentence(&self) -> String {
        let error = |operator, albedo| listed(&self.errors(operator, albedo));
        let rows = self.seeds.iter().flatten().map(|limit| limit.grid.rows);
        format!(
            "the RMS error of the best linear estimate of light by texels of {}°, in units of the deviation that light is taken to have, is {} \
             with somebody at a known place in the light and the albedo unknown, {} with nobody there ({} and {} with the albedo known)",
            number(180.0 / rows.max().unwrap_or(1) as f64),
            error(true, false),
            error(false, false),
            error(true, true),
            error(false, true),
        )
    }

    /// Errors and what is revealed, a seed each.
    fn numbers(&self) -> Value {
        let all = [(true, true), (true, false), (false, true), (false, false)];
        let rows = all.into_iter().filter_map(|(operator, albedo)| {
            let limits = self.of(operator, albedo);
            let first = limits.first()?;
            let revealed = first.revealed.iter().enumerate();
            let revealed: Map<String, Value> = revealed
                .map(|(size, (degrees, _))| {
                    let shares = limits.iter().map(|limit| limit.revealed[size].1);
                    let shares: Vec<f64> = shares.collect();
                    (format!("{} degrees", number(*degrees)), json!(shares))
                })
                .collect();
            let errors = self.errors(operator, albedo);
            Some((label(first), json!({"error": errors, "revealed": revealed})))
        });
        Value::Object(rows.collect())
    }

    /// Why somebody in the light is little help, as far as the numbers tell.
    fn why(&self) -> String {
        if self.held() {
            return String::new();
        }
        if self.parts()[0] {
            return format!(
                "; with the albedo known, {} of the error without anybody there is left in the worst seed: the object's own shadows \
                 tell nearly as much",
                number(self.left(true))
            );
        }
        let alone = range(&self.errors(false, false))[0];
        let told_albedo = range(&self.errors(false, true))[0];
        let words = match (alone < TOLD, told_albedo < TOLD) {
            (true, _) => "the object's own shadows tell of the light already",
            (false, true) => {
                "somebody there hardly tells light from albedo, which is what hides it: were the albedo known, the object's own shadows \
                 would tell of it"
            }
            (false, false) => {
                "with the albedo known, too, nobody there tells little: whether noise or the surface's blur hides the light was not \
                 told apart"
            }
        };
        format!(
            "; of the error without anybody there {} is left in the worst seed: {words}",
            number(self.left(false))
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
    let held: Vec<bool> = studied.iter().flat_map(Studied::parts).collect();
    let details = studied.iter();
    let details = details.map(|s| format!("{}: {}{}.", s.name, s.sentence(), s.why()));
    let details: Vec<String> = details.collect();
    let numbers: Map<String, Value> = studied
        .iter()
        .map(|s| (s.name.clone(), s.numbers()))
        .collect();
    let grain = bench.pick(GRAINS);
    Evidence {
        name: "limit",
        title: "What the photographs can tell of the light at best",
        source: "Beyond the paper; compare its Fig. 3",
        claim: "Somebody who moves through the light lets it be told from albedo and, were the albedo known, still makes visible what \
                the object alone blurs away.",
        verdict: Verdict::of(&held),
        sentence: in_short(studied),
        numbers: Value::Object(numbers),
        figures: studied.iter().flat_map(figures).collect(),
        details,
        notes: vec![
            format!(
                "One channel on {} x {} texels, about {} patches of surface in every photograph that sees them ({} for their places; the \
                 claim is judged by the worst), noise as the photographs show it, and {} % of each value left to what the right model \
                 would not explain. Light is 1 on average with independent texels of variance 1: an error of 1 means that nothing is known but that.",
                grain.rows,
                2 * grain.rows,
                grain.patches,
                seeds(bench.seeds().end),
                100.0 * MODEL_ERROR
            ),
            "Somebody is the outline that a reconstruction starts from, upright behind each camera, at a place that is taken to be \
             known; a reconstruction has to find it. The albedo is a number a patch, known or eliminated, which does as well as \
             anybody could. No estimate that is linear in these patches can do better on average over such light. What a \
             reconstruction does is not bound by it: it expects light to be smooth and of few lamps, where this expects nothing, and its \
             patches are smaller."
                .into(),
            "The surface is taken to be matt; where it is not, its gloss tells more of the light than is said here.".into(),
        ],
    }
}

/// Least and most over all captures and seeds, and where somebody in the light was of little help.
fn in_short(studied: &[Studied]) -> String {
    let percent = |operator, albedo| {
        let errors = studied.iter().flat_map(|s| s.errors(operator, albedo));
        let [low, high] = range(&errors.collect::<Vec<_>>()).map(|e| number(100.0 * e));
        match low == high {
            true => format!("{low} %"),
            false => format!("{low} to {high} %"),
        }
    };
    let names: Vec<&str> = studied.iter().map(|s| &*s.name).collect();
    let failed = studied.iter().filter(|s| !s.held());
    let failed: Vec<&str> = failed.map(|s| &*s.name).collect();
    format!(
        "the best linear estimate of light without a prior, which does not bound a reconstruction, leaves an RMS error of {} of the light's \
         deviation where somebody stands at a known place in it, {} where nobody does, the albedo being unknown; {} and {} were it known (\
         less than {HELPS} of the error without anybody counts as help; {}){}.",
        percent(true, false),
        percent(false, false),
        percent(true, true),
        percent(false, true),
        names.join(", "),
        match failed.is_empty() {
            true => String::new(),
            false => format!(
                "; that is too little on {}: the object's own shadows tell as much, or somebody there does not tell light from albedo",
                failed.join(", ")
            ),
        }
    )
}

fn figures(studied: &Studied) -> Vec<Figure> {
    let series = |(seed, limits): (usize, &Vec<Limit>)| -> Vec<Series> {
        let line = |limit: &Limit| {
            let points = limit.revealed.iter().map(|&(x, y)| [x, y]).collect();
            Series::line(label(limit), points).of_seed(seed as u64)
        };
        limits.iter().map(line).collect()
    };
    let limits = || studied.seeds.iter().flatten();
    let all = limits().flat_map(|l| l.revealed.iter());
    let coarsest = all.map(|r| r.0).fold(1.0, f64::max);
    let resolved = Figure {
        name: format!("{}-resolved", studied.name),
        caption: "The share of the light's variance that the photographs reveal, over the size of the detail: 1 is everything, 0 \
                  nothing; errors elsewhere are RMS, so that an error e of the finest detail is a share 1 - e² here. A line a seed."
            .into(),
        content: Content::Chart(Chart {
            x: Axis::linear("size of detail, degrees", [0.0, 1.05 * coarsest]),
            y: Axis::linear("share of variance revealed", [0.0, 1.0]),
            series: studied.seeds.iter().enumerate().flat_map(series).collect(),
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
    let first = studied.seeds.iter().take(1).flatten();
    let left = Figure {
        name: format!("{}-left", studied.name),
        caption: "The RMS error that the best linear estimate leaves in each direction, top +z, centre +x: blue is known, red is not. \
                  First seed."
            .into(),
        content: Content::Pictures(first.map(picture).collect()),
    };
    vec![resolved, left]
}

#[cfg(test)]
mod tests {
    use render::lat_long::LatLong;

    use super::*;

    /// Errors of two seeds: with somebody and the albedo unknown, the same known, with nobody, and known.
    fn studied(errors: [[f64; 2]; 4]) -> Studied {
        let known = [(true, false), (true, true), (false, false), (false, true)];
        let of_seed = |seed: usize| -> Vec<Limit> {
            let limits = known.iter().zip(errors);
            limits
                .map(|(&(operator, albedo), error)| Limit {
                    known: Known { operator, albedo },
                    grid: LatLong::new(2, 4),
                    left: vec![1.0; 8],
                    error: error[seed],
                    revealed: Vec::new(),
                })
                .collect()
        };
        Studied {
            name: "ball".to_owned(),
            seeds: vec![of_seed(0), of_seed(1)],
        }
    }

    #[test]
    fn somebody_helps_where_the_worst_seed_says_so_with_the_albedo_known_or_not() {
        let helped = studied([[0.7, 0.8], [0.5, 0.5], [0.99, 0.99], [0.7, 0.7]]);
        assert!(helped.held() && helped.why().is_empty());
        let one_seed = studied([[0.7, 0.95], [0.5, 0.5], [0.99, 0.99], [0.7, 0.7]]);
        assert_eq!(one_seed.parts(), [false, true]);
        let why = one_seed.why();
        assert!(why.contains("0.96 is left in the worst seed"), "{why}");
        assert!(why.contains("hardly tells light from albedo"), "{why}");
        let albedo_alone = studied([[0.7, 0.8], [0.69, 0.5], [0.99, 0.99], [0.7, 0.7]]);
        assert_eq!(albedo_alone.parts(), [true, false]);
        let why = albedo_alone.why();
        assert!(why.contains("own shadows tell nearly as much"), "{why}");
        let mirror = studied([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5]]);
        assert!(mirror.why().contains("tell of the light already"));
        let broken = studied([[f64::NAN, 0.7], [0.5, 0.5], [0.99, 0.99], [0.7, 0.7]]);
        assert!(!broken.held());
    }
}
