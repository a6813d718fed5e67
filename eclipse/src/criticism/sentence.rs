//! The outcome in a sentence.

use super::{
    diagnosis::{Diagnosis, Finding, Verdict},
    effects,
    statistics::median,
    stretch::Stretch,
    verdict::STRUCTURE,
};

/// Effects that would have to be larger than this share of the image to be found are named where nothing is missing.
const HIDDEN: f64 = 0.05;
/// A share of the structured mismatch that is left, from which on the sentence says where.
const REST: f64 = 0.1;

/// The sentence a person reads first.
pub fn sentence(d: &Diagnosis) -> String {
    let place = Stretch::around(&d.hot_spots)
        .map_or(String::new(), |stretch| format!("{} ", stretch.sentence()));
    let explained = 100.0 * (1.0 - d.unexplained_fraction);
    // Where neighbouring places share nothing beyond noise, there is no share of it to tell.
    let share = if d.structured[0] > STRUCTURE {
        let unseen = unseen(d).map_or(String::new(), |share| {
            format!(" ({share:.0} % in frames that no fit has seen)")
        });
        format!("explains {explained:.0} % of the structured mismatch{unseen}")
    } else {
        "explains the photographs better, though neighbouring places differ by no more than noise"
            .to_owned()
    };
    let names: Vec<String> = d.effects.iter().map(told).collect();
    let above = d.sealed.explained().map_or(String::new(), |share| {
        let apart = d.structured[0] > STRUCTURE && share < 0.5 && d.unexplained_fraction < 0.5;
        let rest = match apart {
            true => ", the rest of which neighbouring places do not share",
            false => "",
        };
        format!(
            ", which is {:.0} % of what noise does not explain there{rest}",
            100.0 * share
        )
    });
    let chi2 = format!(
        "χ² a sealed value goes from {:.2} to {:.2}{above}",
        d.sealed.chi2_before, d.sealed.chi2_after
    );
    match d.verdict {
        Verdict::Explained => format!(
            "{place}{} {share}; {chi2}.{}",
            names.join(" together with "),
            left(d)
        ),
        Verdict::Ambiguous => {
            format!(
                "{place}{} {share}, but {} would do as well{}; {chi2}.{}",
                names.join(" together with "),
                rivals(d).join(" or "),
                instead(d),
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
            let part = if d.unnamed > 0 && d.unexplained_fraction < 1.0 {
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

/// The percentage of the surface's structured mismatch in sealed frames that is explained, where there is any to speak of.
fn unseen(d: &Diagnosis) -> Option<f64> {
    let [before, after] = d.structured_sealed?;
    (before > STRUCTURE).then(|| 100.0 * (1.0 - after / before).max(0.0))
}

/// The first effect that others could take the place of.
fn ambiguous(d: &Diagnosis) -> Option<&Finding> {
    d.effects.iter().find(|f| !f.ambiguous_with.is_empty())
}

fn rivals(d: &Diagnosis) -> &[&'static str] {
    ambiguous(d).map_or(&[], |finding| finding.ambiguous_with.as_slice())
}

/// Whose place they could take, where several effects were found.
fn instead(d: &Diagnosis) -> String {
    match ambiguous(d) {
        Some(finding) if d.effects.len() > 1 => format!(" in place of {}", finding.id),
        _ => String::new(),
    }
}

/// What the effects that were found leave over.
fn left(d: &Diagnosis) -> String {
    let mut left: Vec<String> = Vec::new();
    if d.unexplained_fraction > REST && d.structured[0] > STRUCTURE {
        left.extend(Stretch::around(&d.hot_spots_after).map(|stretch| stretch.place()));
    }
    if let Some(stand_in) = d.looks_like.and_then(effects::by_id) {
        left.push(format!(
            "something that looks most like {}",
            stand_in.describe()
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
        "{} ({what}; {:.1} ± {:.1} % of the image, RMS)",
        finding.id,
        100.0 * finding.size,
        100.0 * finding.size_se
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stand_in_explains_beside_an_effect_is_told() {
        let found = vec![Finding::example("vignetting", Vec::new())];
        let mut d = Diagnosis::example(Verdict::Explained, found);
        assert!(!sentence(&d).contains("Not explained"));
        d.looks_like = Some("image_warp");
        let told = sentence(&d);
        assert!(
            told.contains("Not explained: something that looks most like"),
            "{told}"
        );
    }

    #[test]
    fn what_sealed_frames_say_stands_beside_what_fits_have_seen() {
        let found = vec![Finding::example("vignetting", Vec::new())];
        let mut d = Diagnosis::example(Verdict::Explained, found);
        assert!(sentence(&d).contains("explains 95 % of the structured mismatch;"));
        d.structured_sealed = Some([2.0, 0.24]);
        let told = sentence(&d);
        let expected =
            "explains 95 % of the structured mismatch (88 % in frames that no fit has seen);";
        assert!(told.contains(expected), "{told}");
        d.structured_sealed = Some([0.1, 0.0]);
        assert!(!sentence(&d).contains("seen"));
        let told = sentence(&d);
        let expected = "goes from 3.00 to 1.10, which is 95 % of what noise does not explain there";
        assert!(told.contains(expected), "{told}");
        assert!(!told.contains("the rest of which"), "{told}");
        d.sealed.chi2_after = 2.7;
        let told = sentence(&d);
        let expected = "which is 15 % of what noise does not explain there, the rest of which neighbouring places do not share";
        assert!(told.contains(expected), "{told}");
        for (before, after) in [(1.08, 1.01), (3.0, 0.9)] {
            (d.sealed.chi2_before, d.sealed.chi2_after) = (before, after);
            assert!(!sentence(&d).contains("there"), "{before} {after}");
        }
    }

    #[test]
    fn effects_without_a_name_are_told_where_there_are_any() {
        let mut d = Diagnosis::example(Verdict::Unexplained, Vec::new());
        d.unexplained_fraction = 0.6;
        assert!(!sentence(&d).contains("of it"), "{}", sentence(&d));
        d.unnamed = 2;
        assert!(sentence(&d).contains("explain 40 % of it"));
    }

    #[test]
    fn whoever_would_do_as_well_is_named_with_the_effect_whose_place_it_takes() {
        let second = [
            Finding::example("vignetting", Vec::new()),
            Finding::example("black_level", vec!["veiling_glare"]),
        ];
        let told = sentence(&Diagnosis::example(Verdict::Ambiguous, second.to_vec()));
        assert!(
            told.contains("but veiling_glare would do as well in place of black_level;"),
            "{told}"
        );
        assert!(
            told.contains("a constant is added to all values; 2.0 ± 0.1 % of the image, RMS)"),
            "{told}"
        );
        let one = Finding::example("vignetting", vec!["medium", "near_field_light"]);
        let told = sentence(&Diagnosis::example(Verdict::Ambiguous, vec![one]));
        let expected = "but medium or near_field_light would do as well;";
        assert!(told.contains(expected), "{told}");
    }
}
