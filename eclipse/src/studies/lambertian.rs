//! Fig. 6: a matt object with and without somebody in the light, the same photographs otherwise.

use std::{path::Path, rc::Rc};

use serde_json::{Map, Value, json};

use super::{
    CAPTURES, Evidence, Study, StudyError, Verdict,
    bench::Bench,
    evidence::{Content, Figure, Picture, listed, seeds},
    recovery::CLEAR,
    small::{self, Setup},
    trial::{Solved, Trial, ends},
};
use crate::{image_io::white, report::text::number};

/// The largest share of the error left that counts as better.
const MARGIN: f64 = 0.9;

/// The study.
pub(super) struct Lambertian;

impl Study for Lambertian {
    fn name(&self) -> &'static str {
        "lambertian"
    }

    fn run(&self, bench: &Bench<'_>) -> Result<Evidence, StudyError> {
        let trials = match bench.trials() {
            // Outside of this project there are none, and none were asked for.
            Err(StudyError::Captures { .. })
                if bench.captures == Path::new(CAPTURES) && !bench.captures.exists() =>
            {
                Vec::new()
            }
            trials => trials?,
        };
        let clear_of = |trial: &Trial| {
            let name = format!("{}{CLEAR}", trial.name);
            trials.iter().find(|other| other.name == name)
        };
        let paired = trials
            .iter()
            .filter(|trial| trial.truth.specular.is_none() && clear_of(trial).is_some());
        let paired: Vec<Rc<Trial>> = paired.cloned().collect();
        let needed =
            "a matt capture NAME and the same NAME-unoccluded without anybody in the light";
        let pairs = match paired.is_empty() {
            true => vec![Pair::made(bench)?],
            false => bench.each_trial(&paired, |occluded| match clear_of(occluded) {
                Some(clear) => Pair::given(bench, occluded, clear),
                None => Err(StudyError::Nothing(needed)),
            })?,
        };
        match pairs.is_empty() {
            true => Err(bench.nothing(needed)),
            false => Ok(evidence(bench, &pairs, paired.is_empty())),
        }
    }
}

/// One object, photographed twice; solved once for each seed.
struct Pair {
    occluded: Rc<Trial>,
    /// Occluders recovered.
    shadows: Vec<Rc<Solved>>,
    /// Nobody in the light, and none modelled.
    alone: Vec<Rc<Solved>>,
    /// Whether seeds differ in the solver's random numbers alone, and not in lamps.
    same: bool,
}

impl Pair {
    fn given(
        bench: &Bench<'_>,
        occluded: &Rc<Trial>,
        clear: &Rc<Trial>,
    ) -> Result<Self, StudyError> {
        let solved = bench.each(bench.seeds(), |seed| {
            Ok((
                bench.solve(occluded, true, seed)?,
                bench.solve(clear, false, seed)?,
            ))
        })?;
        let (shadows, alone) = solved.into_iter().unzip();
        Ok(Self {
            shadows,
            alone,
            occluded: Rc::clone(occluded),
            same: true,
        })
    }

    /// Of small captures, where none are given; seeds are of lamps and noise as well.
    fn made(bench: &Bench<'_>) -> Result<Self, StudyError> {
        let mut shown = None;
        let solved = bench.each(bench.seeds(), |seed| {
            let occluded = Setup {
                scene: seed,
                seed,
                ..Setup::telling(bench.scale)
            };
            let clear = Setup {
                person: None,
                ..occluded
            };
            let (trial, shadows) = small::solve(bench, occluded)?;
            let (_, alone) = small::solve(bench, clear)?;
            shown.get_or_insert(Rc::new(trial));
            Ok((Rc::new(shadows), Rc::new(alone)))
        })?;
        let (shadows, alone) = solved.into_iter().unzip();
        Ok(Self {
            shadows,
            alone,
            occluded: shown.ok_or(StudyError::Nothing("at least one seed"))?,
            same: false,
        })
    }

    fn errors(solved: &[Rc<Solved>]) -> Vec<f64> {
        solved.iter().map(|s| s.environment_error()).collect()
    }

    /// By the worst seed with somebody in the light and the best without: a tenth less at least. Under lamps of each seed's own a seed is
    /// compared with itself.
    fn held(&self) -> bool {
        let errors = [&self.shadows, &self.alone].map(|solved| Self::errors(solved));
        is_better(&errors, self.same)
    }
}

/// See [`Pair::held`]; what is no number is not better.
fn is_better([shadows, alone]: &[Vec<f64>; 2], same: bool) -> bool {
    let less = |shadow: &f64, alone: &f64| *shadow < MARGIN * alone;
    match same {
        true => shadows.iter().all(|s| alone.iter().all(|a| less(s, a))),
        false => shadows.iter().zip(alone).all(|(s, a)| less(s, a)),
    }
}

/// Of pairs that were given or, `made`, of one that was not.
fn evidence(bench: &Bench<'_>, pairs: &[Pair], made: bool) -> Evidence {
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
                String::new()
            } else {
                let solves = pair.shadows.iter().map(Rc::as_ref);
                let ends = ends(solves, bench.seconds());
                format!(", which is less than a tenth better for some seeds; {ends}")
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
        figures: [errors(pairs)]
            .into_iter()
            .chain(pairs.iter().map(figure))
            .collect(),
        details: Vec::new(),
        notes: vec![
            match made {
                true => conditions_of_small(bench),
                false => bench.conditions(),
            },
            "Both captures have the same object, light, cameras and noise level; materials are told to be matt in both. Errors after \
             the best scale of each channel."
                .into(),
        ],
    }
}

fn conditions_of_small(bench: &Bench<'_>) -> String {
    let setup = Setup::telling(bench.scale);
    format!(
        "No pair of captures NAME and NAME{CLEAR} was given with --captures: these were made for it, three balls that touch under six \
         lamps, {} photographs of {} x {} pixels; {} of lamps, noise and solver alike; {} steps of the fast preset.",
        setup.frames,
        setup.resolution,
        setup.resolution,
        seeds(bench.seeds().end),
        small::telling_steps(bench)
    )
}

/// The light's errors of every pair.
fn errors(pairs: &[Pair]) -> Figure {
    let of = |solved: fn(&Pair) -> &[Rc<Solved>]| -> Vec<Vec<f64>> {
        let errors = pairs.iter().map(|pair| Pair::errors(solved(pair)));
        errors.collect()
    };
    let names = pairs.iter().map(|pair| pair.occluded.name.clone());
    Figure::of_seeds(
        "errors",
        "Relative RMSE of the light with somebody in it and by the object's own shadows alone",
        "relative RMSE of the light",
        &names.collect::<Vec<_>>(),
        &[
            ("somebody in the light", of(|pair| &pair.shadows)),
            ("own shadows alone", of(|pair| &pair.alone)),
        ],
    )
}

fn figure(pair: &Pair) -> Figure {
    let truth = &pair.occluded.light;
    let bright = white([truth]);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_less_is_better_in_every_seed() {
        let with = |shadows: [f64; 2], alone: [f64; 2], same| {
            is_better(&[shadows.to_vec(), alone.to_vec()], same)
        };
        for same in [true, false] {
            assert!(with([0.5, 0.6], [0.7, 0.8], same));
            assert!(!with([0.5, 0.75], [0.7, 0.8], same));
            assert!(!with([0.5, f64::NAN], [0.7, 0.8], same));
            assert!(!with([0.5, 0.5], [0.7, f64::NAN], same));
        }
        // Under the same lamps the worst is compared with the best.
        assert!(with([0.3, 0.65], [0.5, 0.8], false));
        assert!(!with([0.3, 0.65], [0.5, 0.8], true));
    }
}
