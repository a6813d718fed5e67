//! The outcome in a word and in a sentence.

use super::{
    diagnosis::{Diagnosis, Finding, Ranked, Verdict},
    effects,
    locate::Structured,
    statistics::median,
};

/// Structured mismatch, in units of the noise's variance, that calls for an explanation.
const STRUCTURE: f64 = 0.35;
/// Effects that would have to be larger than this share of the image to be found are named where nothing is missing.
const HIDDEN: f64 = 0.05;
/// A share of the structured mismatch that is left, from which on the sentence says where.
const REST: f64 = 0.1;
/// An effect whose gain is this many standard errors may be there.
const HINT: f64 = 2.5;

/// What a verdict rests on.
pub struct Grounds<'a> {
    /// What sealed data confirmed.
    pub found: &'a [Finding],
    /// A stand-in for physics outside the table that they confirmed.
    pub unknown: Option<&'static str>,
    /// Whether they gave an effect some credit, but too little.
    pub refused: bool,
    /// The first screening.
    pub ranking: &'a [Ranked],
    /// Structured mismatch before and after, in units of the noise's variance: see [`judged`].
    pub structured: [f64; 2],
}

/// The structured mismatch that a verdict rests on: the surface's where it has any, since light behind it may be scenery that no
/// simulation of the object holds; else all.
pub fn judged(structured: [Structured; 2]) -> [f64; 2] {
    if structured[0].surface > STRUCTURE {
        structured.map(|s| s.surface)
    } else {
        structured.map(Structured::all)
    }
}

/// The outcome.
pub fn verdict(grounds: &Grounds<'_>) -> Verdict {
    let [before, after] = grounds.structured;
    if !grounds.found.is_empty() {
        // An effect that leaves most of the structure is a part of something else.
        return if after > STRUCTURE && after > 0.5 * before {
            Verdict::Unexplained
        } else if grounds.found.iter().any(|f| !f.ambiguous_with.is_empty()) {
            Verdict::Ambiguous
        } else {
            Verdict::Explained
        };
    }
    if before > STRUCTURE || grounds.unknown.is_some() {
        return Verdict::Unexplained;
    }
    let hint = |r: &Ranked| {
        !r.capacity
            && r.gain > HINT * r.gain_se
            && r.p < 1e-3
            && r.size < r.minimum_detectable
            && r.minimum_detectable > 0.02
    };
    if grounds.refused || grounds.ranking.iter().any(hint) {
        Verdict::Underpowered
    } else {
        Verdict::NothingMissing
    }
}

/// The sentence a person reads first.
pub fn sentence(d: &Diagnosis) -> String {
    let place = d.hot_spots.first().map_or(String::new(), |spot| {
        let sign = if spot.sigma > 0.0 {
            "brighter"
        } else {
            "darker"
        };
        let [x, y] = spot.middle();
        format!(
            "Frame {} is up to {:.1} % {sign} than its simulation around pixel ({x:.0}, {y:.0}). ",
            spot.frame,
            100.0 * spot.relative.abs()
        )
    });
    let explained = 100.0 * (1.0 - d.unexplained_fraction);
    // Where neighbouring places share nothing beyond noise, there is no share of it to tell.
    let share = if d.structured[0] > STRUCTURE {
        format!("explains {explained:.0} % of the structured mismatch")
    } else {
        "explains the photographs better, though neighbouring places differ by no more than noise"
            .to_owned()
    };
    let names: Vec<String> = d.effects.iter().map(told).collect();
    let chi2 = format!(
        "χ² a sealed value goes from {:.2} to {:.2}",
        d.sealed.chi2_before, d.sealed.chi2_after
    );
    match d.verdict {
        Verdict::Explained => format!(
            "{place}{} {share}; {chi2}.{}",
            names.join(" together with "),
            left(d)
        ),
        Verdict::Ambiguous => {
            let others = &d.effects[0].ambiguous_with;
            format!(
                "{place}{} {share}, but {} would do as well; {chi2}.{}",
                names.join(" together with "),
                others.join(" or "),
                left(d)
            )
        }
        Verdict::Underpowered => format!(
            "{place}Something may be missing, but these photographs are too few or too noisy to tell what."
        ),
        Verdict::NothingMissing => {
            let physics = || {
                d.ranking
                    .iter()
                    .filter(|r| !r.capacity && r.minimum_detectable.is_finite())
            };
            let mut sizes: Vec<f64> = physics().map(|r| r.minimum_detectable).collect();
            let middle = median(&mut sizes);
            let hidden: Vec<&str> = physics()
                .filter(|r| r.minimum_detectable > HIDDEN)
                .map(|r| r.id)
                .collect();
            let bound = if middle.is_finite() {
                format!(
                    " Half of the effects would have shown at {:.1} % of the image.",
                    100.0 * middle
                )
            } else {
                String::new()
            };
            let but = if hidden.is_empty() {
                String::new()
            } else {
                format!(
                    " Not excluded, since light and albedo imitate them here: {} of {:.0} % and more.",
                    hidden.join(", "),
                    100.0 * HIDDEN
                )
            };
            format!(
                "Nothing is missing: simulation and photographs agree within their noise.{bound}{but}"
            )
        }
        Verdict::Unexplained => {
            let like = d
                .looks_like
                .and_then(effects::by_id)
                .map_or(String::new(), |stand_in| {
                    format!(" It looks most like {}.", stand_in.describe())
                });
            let part = if d.unexplained_fraction < 1.0 {
                format!(" The best of them explain {explained:.0} % of it.")
            } else {
                String::new()
            };
            format!(
                "{place}Something is missing that none of the known effects explains; see the maps for where.{like}{part}"
            )
        }
    }
}

/// What the effects that were found leave over.
fn left(d: &Diagnosis) -> String {
    let mut left: Vec<String> = Vec::new();
    let spot = d.hot_spots_after.first();
    if let Some(spot) =
        spot.filter(|_| d.unexplained_fraction > REST && d.structured[0] > STRUCTURE)
    {
        let [x, y] = spot.middle();
        left.push(format!(
            "frame {} around pixel ({x:.0}, {y:.0})",
            spot.frame
        ));
    }
    let [before, after] = d.background;
    if after > STRUCTURE && after > 0.5 * before {
        left.push("light in the background, which may be scenery".to_owned());
    }
    if left.is_empty() {
        return String::new();
    }
    format!(" Not explained: {}.", left.join(", and "))
}

fn told(finding: &Finding) -> String {
    let what = effects::by_id(finding.id).map_or("", |e| e.describe());
    format!(
        "{} ({what}; {:.1} % of the image, RMS)",
        finding.id,
        100.0 * finding.size
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(ambiguous_with: Vec<&'static str>) -> Finding {
        Finding::example("vignetting", ambiguous_with)
    }

    fn of(found: &[Finding], structured: [f64; 2]) -> Grounds<'_> {
        Grounds {
            found,
            unknown: None,
            refused: false,
            ranking: &[],
            structured,
        }
    }

    #[test]
    fn a_name_is_given_only_where_it_explains_most() {
        let one = [found(Vec::new())];
        assert_eq!(verdict(&of(&one, [3.0, 0.2])), Verdict::Explained);
        assert_eq!(verdict(&of(&one, [3.0, 1.0])), Verdict::Explained);
        assert_eq!(verdict(&of(&one, [3.0, 1.6])), Verdict::Unexplained);
        assert_eq!(verdict(&of(&one, [0.05, 0.05])), Verdict::Explained);
        let both = [found(Vec::new()), found(vec!["medium"])];
        assert_eq!(verdict(&of(&both, [3.0, 0.2])), Verdict::Ambiguous);
    }

    #[test]
    fn scenery_behind_a_surface_that_is_explained_does_not_count() {
        let at = |surface, background| Structured {
            surface,
            background,
        };
        assert_eq!(judged([at(9.0, 50.0), at(0.4, 49.0)]), [9.0, 0.4]);
        // A surface without mismatch says nothing of glare behind it.
        assert_eq!(judged([at(0.1, 50.0), at(0.1, 1.0)]), [50.1, 1.1]);
    }

    #[test]
    fn without_a_name_the_structure_decides() {
        assert_eq!(verdict(&of(&[], [0.05, 0.05])), Verdict::NothingMissing);
        assert_eq!(verdict(&of(&[], [2.0, 2.0])), Verdict::Unexplained);
        let stand_in = Grounds {
            unknown: Some("image_pattern"),
            ..of(&[], [0.05, 0.05])
        };
        assert_eq!(verdict(&stand_in), Verdict::Unexplained);
        let refused = Grounds {
            refused: true,
            ..of(&[], [0.05, 0.05])
        };
        assert_eq!(verdict(&refused), Verdict::Underpowered);
    }
}
