//! Fig. 8 and S2: photographs of a real object, judged by views that were held out.

use serde_json::json;

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Content, Figure, Picture, white},
    trial::name_of,
};
use crate::{
    capture::{Capture, LoadOptions},
    reconstruction::Reconstruction,
    report::text::number,
    settings::Settings,
};

/// Every so many photographs are held out.
const HOLD_OUT: usize = 8;
/// Decibels by which held-out views should be better, in every seed.
const BETTER: f64 = 0.1;

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
        let capture = Capture::load(folder, &LoadOptions::default())?;
        let mut solved = Vec::new();
        for seed in bench.seeds() {
            let mut pair = Vec::new();
            for occluders in [true, false] {
                let settings = Settings {
                    time_limit: Some(bench.seconds()),
                    seed,
                    threads: bench.threads,
                    occluders,
                    hold_out: Some(HOLD_OUT),
                    ..Settings::default()
                };
                let found = bench.run(&capture, &settings)?;
                (bench.tell)(&format!(
                    "{}, occluders {occluders}, seed {seed}: held-out views {} dB",
                    name_of(folder),
                    number(held_out(&found))
                ));
                pair.push(found);
            }
            solved.push(pair);
        }
        Ok(evidence(bench, &name_of(folder), &capture, &solved))
    }
}

fn held_out(found: &Reconstruction) -> f64 {
    found.metrics.photometric.psnr_held_out.unwrap_or(f64::NAN)
}

const TITLE: &str = "A real object";
const SOURCE: &str = "Verbin et al. 2024, Fig. 8 and S2";
const CLAIM: &str = "On photographs of real objects, modelling unseen occluders gives plausible light and occluders, and explains views \
                     that were not fitted better.";

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
        notes: vec![
            "Real photographs are not part of the project; any capture that `eclipse inspect` accepts will do.".into(),
        ],
    }
}

fn evidence(
    bench: &Bench<'_>,
    name: &str,
    capture: &Capture,
    solved: &[Vec<Reconstruction>],
) -> Evidence {
    let list = |which: usize, of: &dyn Fn(&Reconstruction) -> f64| -> Vec<f64> {
        solved.iter().map(|pair| of(&pair[which])).collect()
    };
    let fitted = |r: &Reconstruction| r.metrics.photometric.psnr.unwrap_or(f64::NAN);
    let (with, without) = (list(0, &held_out), list(1, &held_out));
    let held = with.iter().zip(&without).all(|(a, b)| a - b > BETTER);
    let kept = solved.iter().all(|pair| !pair[0].occluders.is_empty());
    let why = match (held, kept) {
        (true, _) => "",
        (false, false) => {
            "; the run found no more sign of an occluder than chance, so that both models are the same"
        }
        (false, true) => {
            "; the occluders that were found do not explain what was held out: what blocks the light here need not stand upright \
             behind the camera, the shape is approximate and the photographs' tone curve is unknown"
        }
    };
    let mut maps: Vec<Picture> = Vec::new();
    for (words, found) in ["occluders modelled", "occluders not modelled"]
        .iter()
        .zip(&solved[0])
    {
        maps.push(Picture::light(
            *words,
            &found.environment,
            white(&found.environment),
        ));
    }
    let frame = (0..capture.frames.len())
        .find(|&t| solved[0][0].settings.holds_out(t))
        .unwrap_or(0);
    let photograph = &capture.frames[frame].image;
    let bright = white(photograph);
    let views = vec![
        Picture::light("photograph", photograph, bright),
        Picture::light("occluders modelled", &solved[0][0].renders[frame], bright),
        Picture::light(
            "occluders not modelled",
            &solved[0][1].renders[frame],
            bright,
        ),
    ];
    let mut figures = vec![
        Figure {
            name: "light".into(),
            caption: "Recovered light, each in its own exposure; first seed.".into(),
            content: Content::Pictures(maps),
        },
        Figure {
            name: "view".into(),
            caption: format!(
                "Photograph {}, which was held out, and its renders; first seed.",
                capture.frames[frame].name
            ),
            content: Content::Pictures(views),
        },
    ];
    if kept {
        let masks = solved[0][0].occluders.iter().step_by(HOLD_OUT).take(6);
        figures.push(Figure {
            name: "occluders".into(),
            caption: "What was found to block the light of some photographs: black blocks.".into(),
            content: Content::Pictures(
                masks
                    .enumerate()
                    .map(|(i, mask)| Picture::light(format!("{}", i * HOLD_OUT), mask, 1.0))
                    .collect(),
            ),
        });
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    Evidence {
        name: "real",
        title: TITLE,
        source: SOURCE,
        claim: CLAIM,
        verdict: Verdict::of(&[held]),
        sentence: format!(
            "{name}: held-out views {} dB with occluders modelled, {} dB without (means of {} seed(s)){why}.",
            number(mean(&with)),
            number(mean(&without)),
            solved.len(),
        ),
        numbers: json!({
            "held_out_psnr_occluders_modelled": with,
            "held_out_psnr_occluders_not_modelled": without,
            "fitted_psnr_occluders_modelled": list(0, &fitted),
            "fitted_psnr_occluders_not_modelled": list(1, &fitted),
        }),
        figures,
        notes: vec![
            bench.conditions(),
            format!(
                "Every {HOLD_OUT}th photograph is held out; of it only the occluder's place is fitted, to half of its pixels, and the \
                 other half is judged. There is no truth: light and occluders can only be looked at."
            ),
        ],
    }
}
