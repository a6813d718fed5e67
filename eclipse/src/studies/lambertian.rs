//! Fig. 6: a matt object with and without somebody in the light, the same photographs otherwise.

use std::rc::Rc;

use serde_json::{Map, Value, json};

use super::{
    Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Content, Figure, Picture, listed, white},
    trial::{Solved, Trial},
};
use crate::report::text::number;

/// Ends the name of the capture in which nobody stands in the light.
const CLEAR: &str = "-unoccluded";

/// The largest share of the error left that counts as better.
const MARGIN: f64 = 0.9;

/// The study.
pub(super) struct Lambertian;

impl Study for Lambertian {
    fn name(&self) -> &'static str {
        "lambertian"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = bench.trials()?;
        let mut pairs = Vec::new();
        for clear in &trials {
            let partner = clear.name.strip_suffix(CLEAR);
            let partner = trials.iter().find(|t| partner == Some(t.name.as_str()));
            if let Some(occluded) = partner.filter(|t| t.truth.specular.is_none()) {
                pairs.push(Pair::new(bench, occluded, clear)?);
            }
        }
        if pairs.is_empty() {
            return Err(StudyError::Nothing(
                "a matt capture NAME and the same NAME-unoccluded without anybody in the light",
            ));
        }
        Ok(evidence(bench, &pairs))
    }
}

/// One object, photographed twice; solved once for each seed.
struct Pair {
    occluded: Rc<Trial>,
    /// Occluders recovered.
    shadows: Vec<Rc<Solved>>,
    /// Nobody in the light, and none modelled.
    alone: Vec<Rc<Solved>>,
}

impl Pair {
    fn new(bench: &Bench<'_>, occluded: &Rc<Trial>, clear: &Rc<Trial>) -> Result<Self, StudyError> {
        let solve = |trial: &Trial, occluders| -> Result<Vec<_>, StudyError> {
            let seeds = bench.seeds();
            seeds
                .map(|seed| bench.solve(trial, occluders, seed))
                .collect()
        };
        Ok(Self {
            shadows: solve(occluded, true)?,
            alone: solve(clear, false)?,
            occluded: Rc::clone(occluded),
        })
    }

    fn errors(solved: &[Rc<Solved>]) -> Vec<f64> {
        solved.iter().map(|s| s.environment_error()).collect()
    }

    /// By the worst seed with somebody in the light and the best without: a tenth less at least.
    fn held(&self) -> bool {
        let (shadows, alone) = (Self::errors(&self.shadows), Self::errors(&self.alone));
        let mut pairs = shadows
            .iter()
            .flat_map(|s| alone.iter().map(move |a| (s, a)));
        pairs.all(|(shadow, alone)| *shadow < MARGIN * alone)
    }
}

fn evidence(bench: &Bench<'_>, pairs: &[Pair]) -> Evidence {
    let held: Vec<bool> = pairs.iter().map(Pair::held).collect();
    let mut sentences = Vec::new();
    for pair in pairs {
        let albedo =
            |solved: &[Rc<Solved>]| listed(&solved.iter().map(|s| s.albedo()).collect::<Vec<_>>());
        sentences.push(format!(
            "{}: relative RMSE of the light {} with somebody in it and recovered, {} by the object's own shadows alone; albedo {} \
             against {} dB{}",
            pair.occluded.name,
            listed(&Pair::errors(&pair.shadows)),
            listed(&Pair::errors(&pair.alone)),
            albedo(&pair.shadows),
            albedo(&pair.alone),
            if pair.held() {
                ""
            } else {
                ", which is less than a tenth better; a longer --time-limit may say more"
            }
        ));
    }
    let numbers: Map<String, Value> = pairs
        .iter()
        .map(|pair| {
            let of = |solved: &[Rc<Solved>]| {
                json!({
                    "environment_relative_rmse": Pair::errors(solved),
                    "environment_relative_mse": solved.iter().map(|s| s.scores.environment.texels.relative_mse_aligned).collect::<Vec<_>>(),
                    "albedo_psnr": solved.iter().map(|s| s.scores.albedo.psnr_aligned).collect::<Vec<_>>(),
                })
            };
            let numbers = json!({"somebody_in_the_light": of(&pair.shadows), "own_shadows_alone": of(&pair.alone)});
            (pair.occluded.name.clone(), numbers)
        })
        .collect();
    Evidence {
        name: "lambertian",
        title: "A matt object, with and without somebody in the light",
        source: "Verbin et al. 2024, Fig. 6",
        claim: "For a purely Lambertian object its shadows on itself do not suffice to recover light of high frequency; occluders that \
                are modelled and estimated do.",
        verdict: Verdict::of(&held),
        sentence: sentences.join("; ") + ".",
        numbers: Value::Object(numbers),
        figures: pairs.iter().map(figure).collect(),
        notes: vec![
            bench.conditions(),
            "Both captures have the same object, light, cameras and noise level; materials are told to be matt in both. Errors after \
             the best scale of each channel."
                .into(),
        ],
    }
}

fn figure(pair: &Pair) -> Figure {
    let truth = &pair.occluded.light;
    let bright = white(truth);
    let map = |words: &str, solved: &Solved| {
        let label = format!("{words}: {}", number(solved.environment_error()));
        Picture::light(label, &solved.light(), bright)
    };
    Figure {
        name: format!("{}-light", pair.occluded.name),
        caption: "Light by the object's own shadows alone, with somebody in the light, and the truth; first seed.".into(),
        content: Content::Pictures(vec![
            map("own shadows alone", &pair.alone[0]),
            map("somebody in the light", &pair.shadows[0]),
            Picture::light("true", truth, bright),
        ]),
    }
}
