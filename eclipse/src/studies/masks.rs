//! Fig. 5: where masks are wrong, there was little light to tell by.

use std::rc::Rc;

use render::{image::Image, lat_long::LatLong};
use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Axis, Chart, Content, Figure, Picture, Series, Tone, listed},
    ranks::rank_correlation,
    trial::{Solved, Trial},
};
use crate::report::text::number;

/// A correlation of ranks below this counts as a strong inverse one.
const STRONG: f64 = -0.5;
/// Among turns of the light as strong a correlation is chance where so many or more have it.
const CHANCE: f64 = 0.05;
/// Turns of the light by less than this share of a circle are too much like itself to be tried.
const LEAST_TURN: f64 = 1.0 / 24.0;
/// Directions that fewer photographs than this have blocked say nothing of a mean.
const BLOCKED: usize = 2;
/// Ends the name of a capture whose masks were free in every direction.
const FREE: &str = "-free-masks";

/// The study.
pub(super) struct Masks;

impl Study for Masks {
    fn name(&self) -> &'static str {
        "masks"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = bench.trials()?;
        let occluded: Vec<Rc<Trial>> = trials.into_iter().filter(|t| t.occluded()).collect();
        // The paper's masks are free in every direction. Where material is known they have most to tell by.
        let matt = occluded.iter().find(|t| t.truth.specular.is_none());
        let free = matt.or(occluded.first()).map(|trial| (trial, true));
        let cases = occluded.iter().map(|trial| (trial, false)).chain(free);
        let cases: Vec<_> = cases.collect();
        let rows = bench.each_capture(
            &cases,
            |(trial, _)| &trial.name,
            |&(trial, free)| {
                bench.each(bench.seeds(), |seed| {
                    let solved = match free {
                        true => bench.solve_anywhere(trial, seed)?,
                        false => bench.solve(trial, true, seed)?,
                    };
                    Ok(Row::new(trial, &solved, free))
                })
            },
        )?;
        let rows: Vec<Row> = rows.into_iter().flatten().collect();
        if rows.is_empty() {
            return Err(bench.nothing("a capture with truth/occluders.exr: somebody in the light"));
        }
        Ok(evidence(bench, &rows))
    }
}

/// The errors of one solve's masks.
struct Row {
    /// The capture's, and how masks were modelled.
    name: String,
    /// Whether masks were free in every direction.
    free: bool,
    /// The true light.
    light: Image,
    /// `[light, mean error]` of directions that were blocked, over the photographs in which they were.
    points: Vec<[f64; 2]>,
    /// Mean error over all photographs, all directions.
    map: Image,
    /// Correlation of ranks of `points`.
    blocked: f64,
    /// Share of turns of the light about the vertical, to which masks owe nothing, under which that is as inverse.
    turned: f64,
    /// The same as `blocked` over all directions and photographs.
    everywhere: f64,
    /// Share of the blocked solid angle, and of the blocked light, that was missed.
    missed: [f64; 2],
}

impl Row {
    fn new(trial: &Rc<Trial>, solved: &Solved, free: bool) -> Self {
        let truth = trial.truth.occluders.as_deref().unwrap_or_default();
        let (height, width) = (trial.light.height, trial.light.width);
        let grid = LatLong::new(height, width);
        let at = |mask: &Image, texel: usize| -> f64 {
            let own = LatLong::new(mask.height, mask.width);
            let direction = grid.texel_direction(texel / width, texel % width);
            f64::from(own.bilinear(direction).gather(&mask.data))
        };
        let radiance: Vec<f64> = (0..grid.len())
            .map(|texel| f64::from(trial.light.data[3 * texel..][..3].iter().sum::<f32>()) / 3.0)
            .collect();
        let mut map = Image::filled(width, height, 1, 0.0);
        let (mut points, mut all, mut places) = (Vec::new(), Vec::new(), Vec::new());
        let (mut missed, mut total) = ([0.0; 2], [0.0; 2]);
        for texel in 0..grid.len() {
            let light = radiance[texel];
            let (mut among, mut blocked, mut mean) = (0.0, 0usize, 0.0);
            for (frame, mask) in truth.iter().enumerate() {
                let passes = at(mask, texel);
                let found = solved.found.occluders.get(frame);
                let found = found.map_or(1.0, |mask| at(mask, texel));
                let error = (found - passes).abs();
                mean += error / truth.len() as f64;
                if passes < 0.5 {
                    among += error;
                    blocked += 1;
                    let solid_angle = f64::from(grid.solid_angle(texel / width));
                    for (i, weight) in [solid_angle, solid_angle * light].into_iter().enumerate() {
                        missed[i] += weight * (found - passes).max(0.0);
                        total[i] += weight * (1.0 - passes);
                    }
                }
            }
            map.data[texel] = mean as f32;
            all.push([light, mean]);
            if blocked >= BLOCKED {
                points.push([light, among / blocked as f64]);
                places.push(texel);
            }
        }
        let blocked = rank_correlation(&points);
        let turned = turned(width, |columns| {
            let pairs = places.iter().zip(&points).map(|(&texel, [_, error])| {
                let column = (texel % width + columns) % width;
                [radiance[texel - texel % width + column], *error]
            });
            rank_correlation(&pairs.collect::<Vec<_>>()) <= blocked
        });
        Self {
            blocked,
            turned,
            everywhere: rank_correlation(&all),
            missed: [0, 1].map(|i| missed[i] / total[i]),
            light: trial.light.clone(),
            name: format!("{}{}", trial.name, if free { FREE } else { "" }),
            free,
            points,
            map,
        }
    }

    /// Whether the correlation is strong, and no chance; one that is no number is none.
    fn held(&self) -> bool {
        self.blocked < STRONG && self.turned < CHANCE
    }
}

/// The share of turns by whole columns of a map of this width that are `as_good`, the map as it is among them.
fn turned(width: usize, as_good: impl Fn(usize) -> bool) -> f64 {
    let least = ((LEAST_TURN * width as f64).ceil() as usize).max(1);
    let turns = least..(width + 1).saturating_sub(least);
    let (all, found) = (
        turns.len(),
        turns.filter(|&columns| as_good(columns)).count(),
    );
    (1 + found) as f64 / (1 + all) as f64
}

/// Of every capture whether it held, by its worst seed.
fn parts(rows: &[Row]) -> Vec<bool> {
    let mut names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
    names.dedup();
    let of_capture = |name: &&str| rows.iter().filter(|row| row.name == *name).all(Row::held);
    names.iter().map(of_capture).collect()
}

fn evidence(bench: &Bench<'_>, rows: &[Row]) -> Evidence {
    let mut names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
    names.dedup();
    let parts = parts(rows);
    let of = |name: &str, value: &dyn Fn(&Row) -> f64| -> String {
        let values = rows.iter().filter(|row| row.name == name);
        let values: Vec<String> = values.map(|row| number(value(row))).collect();
        values.join(", ")
    };
    let correlations = names
        .iter()
        .map(|name| format!("{name} {}", of(name, &|row| row.blocked)));
    let correlations: Vec<String> = correlations.collect();
    let details = names.iter().map(|name| {
        format!(
            "{name}: null test: of rotations of the environment about the vertical {} % correlate as inversely. Masks miss {} of the blocked \
             solid angle and {} of the blocked light. Over all directions and photographs, most of them clear in both, the correlation is {}.",
            of(name, &|row| 100.0 * row.turned),
            of(name, &|row| row.missed[0]),
            of(name, &|row| row.missed[1]),
            of(name, &|row| row.everywhere)
        )
    });
    let details = details.collect();
    let (free, of_figure): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| row.free);
    let free: Vec<(bool, f64)> = free.iter().map(|row| (row.held(), row.missed[0])).collect();
    let why = why(of_figure.iter().all(|row| row.held()), &free);
    let numbers: Map<String, Value> = names
        .iter()
        .map(|name| {
            let list = |value: &dyn Fn(&Row) -> f64| -> Vec<f64> {
                let values = rows.iter().filter(|row| row.name == *name);
                values.map(value).collect()
            };
            let numbers = json!({
                "rank_correlation_where_blocked": list(&|row| row.blocked),
                "share_of_turned_lights_as_inverse": list(&|row| row.turned),
                "rank_correlation_everywhere": list(&|row| row.everywhere),
                "directions": list(&|row| row.points.len() as f64),
                "share_of_blocked_solid_angle_missed": list(&|row| row.missed[0]),
                "share_of_blocked_light_missed": list(&|row| row.missed[1]),
            });
            ((*name).to_owned(), numbers)
        })
        .collect();
    Evidence {
        name: "masks",
        title: "Masks are wrong where it is dark",
        source: "Verbin et al. 2024, Fig. 5",
        claim: "There is a very strong inverse correlation between the mean error of recovered masks and the light that they block.",
        verdict: Verdict::of(&parts),
        sentence: format!(
            "rank correlation of a direction's light and the mean error of masks that block it, a seed each: {}{why}.",
            correlations.join("; ")
        ),
        numbers: Value::Object(numbers),
        figures: figures(rows),
        details,
        notes: vec![
            bench.conditions(),
            format!(
                "The paper does not say which mean is taken. Here a direction's error is the mean of |M̂ − M| over the photographs in which \
                 it was truly blocked, for directions blocked in {BLOCKED} photographs at least; the correlation is Spearman's. A capture \
                 counts by its worst seed: below {STRONG}, and more inverse than all but {} % of rotations of the environment.",
                100.0 * CHANCE
            ),
        ],
    }
}

/// What was measured that bears on where the claim did not hold: for masks of one figure it `held`, and for each seed of `free` ones it
/// did or not, which missed such a share of the blocked solid angle.
fn why(held: bool, free: &[(bool, f64)]) -> String {
    let figure = match held {
        true => "",
        false => {
            "; masks are one silhouette that moves with the camera, where the paper's are free in every direction"
        }
    };
    let all = free.iter().all(|(held, _)| *held);
    let free = match free {
        [] if held => String::new(),
        [] => ", which was not tested".to_owned(),
        _ if held && all => String::new(),
        free => {
            let holds = free.iter().filter(|(held, _)| *held).count();
            let missed: Vec<f64> = free.iter().map(|(_, missed)| *missed).collect();
            format!(
                "; of free ones ({}), which miss {} of the blocked solid angle, {holds} of {} are below {STRONG} and beyond chance",
                &FREE[1..],
                listed(&missed),
                free.len()
            )
        }
    };
    figure.to_owned() + &free
}

fn figures(rows: &[Row]) -> Vec<Figure> {
    let mut figures = Vec::new();
    let mut shown: Vec<&str> = Vec::new();
    for row in rows {
        if shown.contains(&row.name.as_str()) {
            continue;
        }
        shown.push(&row.name);
        let of_capture = || rows.iter().filter(|other| other.name == row.name);
        let points = || of_capture().flat_map(|row| &row.points);
        let lights = points().map(|p| p[0]).filter(|&l| l > 0.0);
        let [low, high] = lights.fold([f64::INFINITY, 0.0], |[low, high]: [f64; 2], l| {
            [low.min(l), high.max(l)]
        });
        figures.push(Figure {
            name: format!("{}-error", row.name),
            caption: "Every direction that was blocked: its light, and the mean error of the masks that blocked it.".into(),
            content: Content::Chart(Chart {
                x: Axis::logarithmic("radiance, mean of channels", [0.9 * low, 1.1 * high]),
                y: Axis::linear("mean |recovered − true|", [0.0, 1.0]),
                series: of_capture()
                    .enumerate()
                    .map(|(seed, row)| {
                        Series::dots(row.name.clone(), row.points.clone())
                            .of_seed(seed as u64)
                    })
                    .collect(),
            }),
        });
        let most = row.map.data.iter().copied().fold(0.0, f32::max);
        let grey = Image {
            channels: 1,
            data: row
                .light
                .data
                .chunks_exact(3)
                .map(|p| (p.iter().sum::<f32>() / 3.0).max(1e-3).log10())
                .collect(),
            ..row.light
        };
        let heat = |label: &str, values: &Image, [low, high]: [f32; 2]| Picture {
            label: label.into(),
            values: values.clone(),
            tone: Tone::Heat { low, high },
        };
        figures.push(Figure {
            name: format!("{}-where", row.name),
            caption: format!(
                "Mean error over all photographs (0 blue, {most:.2} red), and the logarithm of light."
            ),
            content: Content::Pictures(vec![
                heat("mean error", &row.map, [0.0, most]),
                heat(
                    "light (log)",
                    &grey,
                    [
                        grey.data.iter().copied().fold(f32::INFINITY, f32::min),
                        grey.data.iter().copied().fold(f32::NEG_INFINITY, f32::max),
                    ],
                ),
            ]),
        });
    }
    figures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_those_that_were_measured() {
        let all = [(true, 0.7), (true, 0.6)];
        assert_eq!(why(true, &all), "");
        assert_eq!(why(true, &[]), "");
        assert!(why(false, &[]).ends_with("which was not tested"));
        let told = why(false, &all);
        assert!(
            told.contains("one silhouette") && told.contains("2 of 2 are below"),
            "{told}"
        );
        // Where only free ones fail nothing is said of the others.
        let free = why(true, &[(true, 0.7), (false, 0.6)]);
        assert!(
            free.contains("miss 0.7, 0.6 of the blocked solid angle, 1 of 2")
                && !free.contains("silhouette"),
            "{free}"
        );
    }

    #[test]
    fn a_capture_counts_by_its_worst_seed() {
        let row = |name: &str, blocked: f64, turned: f64| Row {
            name: name.into(),
            free: false,
            light: Image::filled(2, 1, 3, 1.0),
            points: Vec::new(),
            map: Image::filled(2, 1, 1, 0.0),
            blocked,
            turned,
            everywhere: 0.0,
            missed: [0.0; 2],
        };
        let strong = || row("a", -0.6, 0.01);
        assert_eq!(
            parts(&[strong(), strong(), row("b", -0.7, 0.0)]),
            [true, true]
        );
        let weak = [
            row("a", -0.4, 0.01),
            row("a", -0.6, 0.2),
            row("a", f64::NAN, 0.0),
        ];
        for other in weak {
            assert_eq!(parts(&[strong(), other]), [false]);
        }
    }

    #[test]
    fn turns_count_the_map_as_it_is_and_leave_out_those_too_like_it() {
        // Of 24 columns all turns but none are tried.
        assert_eq!(turned(24, |_| false), 1.0 / 24.0);
        assert_eq!(turned(24, |_| true), 1.0);
        assert_eq!(turned(24, |columns| columns == 12), 2.0 / 24.0);
        // Of 100, those of five columns either way and more.
        assert_eq!(
            turned(100, |columns| !(5..=95).contains(&columns)),
            1.0 / 92.0
        );
    }
}
