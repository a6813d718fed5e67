//! Fig. 8 and S2: photographs of a real object, judged by views that were held out.

use std::path::Path;

use render::image::Image;
use serde_json::json;

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Content, Figure, Picture, listed, range},
    trial::name_of,
};
use crate::{
    capture::{Capture, LoadOptions},
    image_io::white,
    reconstruct::{self, hold_out, photometric},
    reconstruction::Reconstruction,
    report::text::number,
    settings::{OccluderPrior, Settings},
};

/// Every so many photographs are held out.
const HOLD_OUT: usize = 8;
/// Longest side of photographs: of 48 of 640 x 480 pixels, four steps were done in the time that sixteen of half the size took.
const MAX_SIZE: [Option<usize>; 3] = [Some(96), Some(320), None];
/// Decibels by which held-out views should be better, in every seed.
const BETTER: f64 = 0.1;

/// What is assumed of occluders, each solved by itself: what blocks the light of a real object need not be a person. `None` is
/// that there are none.
const MODELS: [Option<OccluderPrior>; 3] = [
    Some(OccluderPrior::Operator),
    Some(OccluderPrior::None),
    None,
];
/// In words, for people and for the table.
const WORDS: [[&str; 2]; 3] = [
    [
        "occluders upright behind the camera",
        "occluders_upright_behind_the_camera",
    ],
    ["occluders anywhere", "occluders_anywhere"],
    ["occluders not modelled", "occluders_not_modelled"],
];

/// The study.
pub(super) struct Real;

impl Study for Real {
    fn name(&self) -> &'static str {
        "real"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let Some(folder) = bench.real else {
            return Ok(absent());
        };
        let capture = Capture::load(folder, &reading(bench))?;
        reconstruct::check_light(&capture)?;
        let name = name_of(folder);
        let solved = bench.each(bench.seeds(), |seed| {
            let solve = |(model, [words, _]): (&Option<OccluderPrior>, &[&str; 2])| -> Result<_, StudyError> {
                let defaults = Settings::default();
                let settings = Settings {
                    time_limit: Some(bench.seconds()),
                    seed,
                    threads: bench.threads,
                    occluders: model.is_some(),
                    occluder_prior: model.unwrap_or(defaults.occluder_prior),
                    hold_out: Some(HOLD_OUT),
                    ..defaults
                };
                let found = bench.run(&capture, &settings)?;
                (bench.tell)(&format!(
                    "{name}, {words}, seed {seed}: held-out views {} dB",
                    number(held_out(&capture, &found))
                ));
                Ok(found)
            };
            MODELS.iter().zip(&WORDS).map(solve).collect::<Result<Vec<Reconstruction>, _>>()
        })?;
        Ok(evidence(bench, &name, &capture, &solved))
    }
}

/// Photographs in a size of which the bench's time allows many steps, unless one is asked for.
fn reading(bench: &Bench<'_>) -> LoadOptions {
    LoadOptions {
        max_size: bench.reading.max_size.or(bench.of_scale(MAX_SIZE)),
        ..bench.reading.clone()
    }
}

/// Decibels of the judged half of views that were held out, after the gain of each channel that the other half asks for: models
/// with occluders fit a frame's own to that half, and what a number does as well is none of their merit.
fn held_out(capture: &Capture, found: &Reconstruction) -> f64 {
    let mut renders = found.renders.clone();
    for (t, (frame, render)) in capture.frames.iter().zip(&mut renders).enumerate() {
        if found.settings.holds_out(t) {
            *render = hold_out::gained(&frame.image, &frame.mask, render);
        }
    }
    let judged = photometric(capture, &found.settings, &renders);
    judged.psnr_held_out.unwrap_or(f64::NAN)
}

const TITLE: &str = "A real object";
const SOURCE: &str = "Verbin et al. 2024, Fig. 8 and S2";
const CLAIM: &str = "On photographs of real objects, modelling unseen occluders explains views that were not fitted better; its light and \
                     occluders are plausible.";

fn absent() -> Evidence {
    Evidence {
        name: "real",
        title: TITLE,
        source: SOURCE,
        claim: CLAIM,
        verdict: Verdict::NotTested,
        sentence: "no real photographs were given; name the folder of a capture with --real or ECLIPSE_REAL.".into(),
        numbers: json!({}),
        figures: Vec::new(),
        details: Vec::new(),
        notes: vec![
            "Real photographs are not part of the project; any capture that `eclipse inspect` accepts will do.".into(),
        ],
    }
}

/// `solved` is `[seed][model]`.
fn evidence(
    bench: &Bench<'_>,
    name: &str,
    capture: &Capture,
    solved: &[Vec<Reconstruction>],
) -> Evidence {
    let list = |model: usize, of: &dyn Fn(&Reconstruction) -> f64| -> Vec<f64> {
        solved.iter().map(|found| of(&found[model])).collect()
    };
    let fitted = |r: &Reconstruction| r.metrics.photometric.psnr.unwrap_or(f64::NAN);
    let views = [0, 1, 2].map(|model| list(model, &|found| held_out(capture, found)));
    let as_rendered = |r: &Reconstruction| r.metrics.photometric.psnr_held_out.unwrap_or(f64::NAN);
    let held = [0, 1].map(|model| better(&views[model], &views[2]));
    let found = [0, 1].map(|model| solved.iter().any(|s| !s[model].occluders.is_empty()));
    let left = (0..3).flat_map(|model| list(model, &|found| unexplained(capture, found)));
    let unexplained = range(&left.collect::<Vec<_>>())[0];
    let sentences =
        (0..3).map(|model| format!("{} dB with {}", listed(&views[model]), WORDS[model][0]));
    let sentences: Vec<String> = sentences.collect();
    let mut numbers = serde_json::Map::new();
    for (model, [_, key]) in WORDS.iter().enumerate() {
        numbers.insert(format!("held_out_psnr_{key}"), json!(views[model]));
        numbers.insert(
            format!("held_out_psnr_without_gain_{key}"),
            json!(list(model, &as_rendered)),
        );
        numbers.insert(format!("fitted_psnr_{key}"), json!(list(model, &fitted)));
    }
    Evidence {
        name: "real",
        title: TITLE,
        source: SOURCE,
        claim: CLAIM,
        // Whether something is plausible no number here tells.
        verdict: Verdict::of_all(&[Some(held[0]), Some(held[1]), None]),
        sentence: format!(
            "{name}: PSNR on held-out views, a seed each: {}{}; of fitted views the best model leaves {} % (RMS over RMS). Whether its light is \
             plausible was not tested: it can only be looked at.",
            sentences.join(", "),
            why(held, found),
            number(100.0 * unexplained)
        ),
        numbers: numbers.into(),
        figures: figures(capture, &solved[0]),
        details: Vec::new(),
        notes: vec![
            bench.conditions(),
            match reading(bench).max_size {
                Some(size) => {
                    format!("Photographs of more than {size} pixels a side are reduced to these.")
                }
                None => "Photographs are used in full.".to_owned(),
            },
            match described(bench.real) {
                names if names.is_empty() => {
                    "Nothing in the folder says what the photographs are of, and whose.".to_owned()
                }
                names => format!(
                    "What the photographs are of, and whose: see {} in their folder.",
                    names.join(", ")
                ),
            },
            format!(
                "Every {HOLD_OUT}th photograph is held out; of it only the occluder's place is fitted, to half of its pixels, and the \
                 other half is judged, after one gain a channel that the first half asks for in every model, so that an occluder has \
                 to do better than a number. There is no truth: light and occluders can only be looked at. Each assumption on occluders is a \
                 part of the claim: better than without occluders by {BETTER} dB in the worst of its seeds against the best without."
            ),
        ],
    }
}

/// What is left of the views that were fitted, RMS, over what they are.
fn unexplained(capture: &Capture, found: &Reconstruction) -> f64 {
    let (mut left, mut all) = (0.0, 0.0);
    let frames = capture.frames.iter().zip(&found.renders).enumerate();
    for (_, (frame, render)) in frames.filter(|(t, _)| !found.settings.holds_out(*t)) {
        let pixels = frame
            .image
            .data
            .chunks_exact(3)
            .zip(render.data.chunks_exact(3));
        for ((photograph, render), _) in pixels.zip(&frame.mask.data).filter(|(_, m)| **m > 0.999) {
            for (a, b) in photograph.iter().zip(render) {
                left += f64::from(a - b).powi(2);
                all += f64::from(*a).powi(2);
            }
        }
    }
    (left / all).sqrt()
}

/// Whether the worst of these decibels is clearly above the best of those.
fn better(these: &[f64], those: &[f64]) -> bool {
    range(these)[0] - range(those)[1] > BETTER
}

/// What was measured that bears on a model of occluders that did not help: `held` and whether any seed `found` one, with occluders
/// upright behind the camera and with occluders anywhere.
fn why(held: [bool; 2], found: [bool; 2]) -> &'static str {
    match (held, found) {
        ([true, true], _) => "",
        ([false, true], _) => {
            "; as if what blocks the light here were no upright figure behind the camera, or no figure of one outline: without that \
             assumption it is found"
        }
        ([true, false], _) => {
            "; without the assumption of a figure behind the camera they are explained no better, and why was not found"
        }
        ([false, false], [false, false]) => "; no run found more sign of an occluder than chance",
        ([false, false], _) => {
            "; the occluders that were found do not explain what was held out, and why was not found"
        }
    }
}

/// The files of a folder that tell of it.
fn described(folder: Option<&Path>) -> Vec<String> {
    let files = folder.and_then(|folder| std::fs::read_dir(folder).ok());
    let files = files.into_iter().flatten().flatten();
    let names = files.map(|file| file.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names
        .filter(|name| name.starts_with("README") || name.starts_with("LICENSE"))
        .collect();
    names.sort();
    names
}

/// Left, top, width and height of what a mask shows; all of it where that is nothing.
fn bounds(mask: &Image) -> [usize; 4] {
    let shown = |p: &usize| mask.data[*p * mask.channels] > 0.0;
    let shown = || (0..mask.width * mask.height).filter(shown);
    let ends = |of: &dyn Fn(usize) -> usize, all: usize| {
        let (least, most) = (shown().map(of).min(), shown().map(of).max());
        match least.zip(most) {
            Some((least, most)) => [least, most + 1 - least],
            None => [0, all],
        }
    };
    let [left, width] = ends(&|p| p % mask.width, mask.width);
    let [top, height] = ends(&|p| p / mask.width, mask.height);
    [left, top, width, height]
}

/// A part of an image: the object fills it, and its data are no longer than they need be.
fn cropped(image: &Image, [left, top, width, height]: [usize; 4]) -> Image {
    let pixels = (top..top + height).flat_map(|y| (left..left + width).map(move |x| [x, y]));
    Image {
        width,
        height,
        channels: image.channels,
        data: pixels
            .flat_map(|[x, y]| image.pixel(x, y).to_vec())
            .collect(),
    }
}

/// Light, a view that was held out, and occluders, of one seed's results.
fn figures(capture: &Capture, solved: &[Reconstruction]) -> Vec<Figure> {
    let named = || WORDS.iter().map(|[words, _]| *words).zip(solved);
    let maps = named().map(|(words, found)| {
        let map = &found.environment;
        Picture::light(words, map, white([map]))
    });
    let frame = (0..capture.frames.len())
        .find(|&t| solved[0].settings.holds_out(t))
        .unwrap_or(0);
    let photograph = &capture.frames[frame].image;
    let bright = white([photograph]);
    let object = bounds(&capture.frames[frame].mask);
    let of = |words: &str, image: &Image| Picture::light(words, &cropped(image, object), bright);
    let views = named().map(|(words, found)| of(words, &found.renders[frame]));
    let first = of("photograph", photograph);
    let mut figures = vec![
        Figure {
            name: "light".into(),
            caption: "Recovered light, each in its own exposure; first seed.".into(),
            content: Content::Pictures(maps.collect()),
        },
        Figure {
            name: "view".into(),
            caption: format!(
                "Photograph {}, which was held out, and its renders; first seed.",
                capture.frames[frame].name
            ),
            content: Content::Pictures(std::iter::once(first).chain(views).collect()),
        },
    ];
    for model in (0..2).filter(|&model| !solved[model].occluders.is_empty()) {
        let masks = solved[model].occluders.iter().step_by(HOLD_OUT).take(6);
        let pictures = masks
            .enumerate()
            .map(|(i, mask)| Picture::light(format!("{}", i * HOLD_OUT), mask, 1.0));
        figures.push(Figure {
            name: ["occluders-upright", "occluders-anywhere"][model].into(),
            caption: format!(
                "What was found to block the light of some photographs, with {}: black blocks.",
                WORDS[model][0]
            ),
            content: Content::Pictures(pictures.collect()),
        });
    }
    figures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_folder_tells_of_its_photographs_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert!(described(Some(folder.path())).is_empty() && described(None).is_empty());
        for name in ["a.png", "README-source.txt", "LICENSE"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = described(Some(folder.path()));
        assert_eq!(found, ["LICENSE", "README-source.txt"]);
    }

    #[test]
    fn pictures_show_the_object_and_nothing_around_it() {
        let mut mask = Image::filled(5, 4, 1, 0.0);
        for p in [6, 8, 13] {
            mask.data[p] = 1.0;
        }
        assert_eq!(bounds(&mask), [1, 1, 3, 2]);
        let part = cropped(&mask, bounds(&mask));
        assert_eq!(part.data, [1.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        assert_eq!(bounds(&Image::filled(5, 4, 1, 0.0)), [0, 0, 5, 4]);
    }

    #[test]
    fn every_seed_must_be_better_than_any_without_occluders() {
        assert!(better(&[30.3, 30.5], &[30.0, 30.1]));
        assert!(!better(&[30.3, 30.15], &[30.0, 30.1]));
        assert!(!better(&[30.3, f64::NAN], &[30.0, 30.1]));
    }

    #[test]
    fn reasons_follow_which_assumption_failed() {
        assert_eq!(why([true; 2], [true; 2]), "");
        assert!(why([false, true], [true; 2]).contains("no upright figure"));
        assert!(why([false; 2], [false; 2]).contains("chance"));
        assert!(why([false; 2], [true, false]).contains("why was not found"));
    }
}
