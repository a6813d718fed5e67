//! The outcome in a word and in a sentence.

use super::{
    diagnosis::{Diagnosis, Finding, Ranked, Verdict},
    effects,
};

/// Structured mismatch, in units of the noise's variance, that calls for an explanation.
const STRUCTURE: f64 = 0.35;
/// An effect whose gain is this many standard errors may be there.
const HINT: f64 = 2.5;

/// The outcome from what was found, the first ranking and the structured mismatch before and after.
pub fn verdict(found: &[Finding], ranking: &[Ranked], structured: [f64; 2]) -> Verdict {
    if let Some(first) = found.first() {
        // An effect that leaves most of the structure is a part of something else.
        if structured[1] > STRUCTURE && structured[1] > 0.6 * structured[0] {
            return Verdict::Unexplained;
        }
        return if first.ambiguous_with.is_empty() {
            Verdict::Explained
        } else {
            Verdict::Ambiguous
        };
    }
    if structured[0] > STRUCTURE {
        return Verdict::Unexplained;
    }
    let hint = ranking.iter().any(|r| {
        !r.capacity
            && r.gain > HINT * r.gain_se
            && r.p < 1e-3
            && r.size < r.minimum_detectable
            && r.minimum_detectable > 0.02
    });
    if hint {
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
        format!(
            "Frame {} is up to {:.1} % {sign} than its simulation around pixel ({:.0}, {:.0}). ",
            spot.frame,
            100.0 * spot.relative.abs(),
            0.5 * (spot.pixels[0] + spot.pixels[2]),
            0.5 * (spot.pixels[1] + spot.pixels[3])
        )
    });
    let explained = 100.0 * (1.0 - d.unexplained_fraction);
    let names: Vec<String> = d.effects.iter().map(told).collect();
    let chi2 = format!(
        "χ² a sealed value goes from {:.2} to {:.2}",
        d.sealed.chi2_before, d.sealed.chi2_after
    );
    match d.verdict {
        Verdict::Explained => format!(
            "{place}{} explains {explained:.0} % of the structured mismatch; {chi2}.",
            names.join(" together with ")
        ),
        Verdict::Ambiguous => {
            let others = &d.effects[0].ambiguous_with;
            format!(
                "{place}{} explains {explained:.0} % of the structured mismatch, but {} would do as well; {chi2}.",
                names.join(" together with "),
                others.join(" or ")
            )
        }
        Verdict::Underpowered => format!(
            "{place}Something may be missing, but these photographs are too few or too noisy to tell what."
        ),
        Verdict::NothingMissing => {
            let least = d
                .ranking
                .iter()
                .filter(|r| !r.capacity && r.minimum_detectable.is_finite())
                .map(|r| r.minimum_detectable)
                .fold(0.0, f64::max);
            format!(
                "Nothing is missing: simulation and photographs agree within their noise. Effects of {:.1} % of the image and more would have been found.",
                100.0 * least
            )
        }
        Verdict::Unexplained => {
            let part = if names.is_empty() {
                String::new()
            } else {
                format!(
                    " {} explains only {explained:.0} % of it.",
                    names.join(" together with ")
                )
            };
            format!(
                "{place}Something is missing that none of the known effects explains; see the maps for where.{part}"
            )
        }
    }
}

fn told(finding: &Finding) -> String {
    let what = effects::by_id(finding.id).map_or("", |e| e.describe());
    format!(
        "{} ({what}; {:.1} % of the image, RMS)",
        finding.id,
        100.0 * finding.size
    )
}
