//! The outcome in a word.

use super::{
    diagnosis::{Finding, Ranked, Verdict},
    locate::Structured,
};

/// Structured mismatch, in units of the noise's variance, that calls for an explanation.
pub(super) const STRUCTURE: f64 = 0.35;
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
    /// The first screening, in any order.
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
