//! Why errors of the albedo are not where its deviations are large.

use super::{
    edges::Edges,
    spread::{CORRELATED, Spread},
    truths::Truths,
};
use crate::report::text::number;

/// What was measured that may explain it.
pub(super) struct Misplaced {
    /// What is at rims and contacts.
    pub edges: Edges,
    /// The rank correlation of errors that are drawn from the deviations.
    pub drawn: f64,
    /// Errors in other light; `None` where nothing was to be explained.
    pub truths: Option<Truths>,
}

impl Misplaced {
    /// Of the albedo's `spread`.
    pub(super) fn new(spread: &Spread, edges: Edges, truths: Option<Truths>) -> Self {
        Self {
            edges,
            drawn: spread.place_if_drawn(),
            truths,
        }
    }

    /// Which of them is the cause.
    pub(super) fn why(&self) -> String {
        let [pixels, error] = self.edges.shares.map(|share| number(100.0 * share));
        let by_chance = self.truths.as_ref();
        let by_chance = by_chance.is_some_and(|truths| truths.place > CORRELATED);
        let at_edges = self.edges.elsewhere > CORRELATED;
        let alike = self.drawn.is_nan() || self.drawn <= CORRELATED;
        let causes = [at_edges, alike, by_chance];
        let is = |cause| match (cause, causes.iter().filter(|c| **c).count()) {
            (false, _) => "not the",
            (true, 1) => "the",
            (true, _) => "a",
        };
        let mut words = format!(
            "elsewhere than beside rims and contacts, {pixels} % of pixels with {error} % of the squared error, its rank correlation is {}: these \
             are {} cause; errors drawn from the deviations themselves would have {}: that deviations are alike is {} cause",
            number(self.edges.elsewhere),
            is(at_edges),
            number(self.drawn),
            is(alike),
        );
        if let Some(truths) = &self.truths {
            words += &format!(
                "; over {} scenes of other lamps it is {}: that errors of one scene are alike from pixel to pixel, so that chance decides where they are, \
                 is {} cause",
                truths.scenes,
                number(truths.place),
                is(by_chance)
            );
        }
        if !causes.contains(&true) {
            words += "; it was not found";
        }
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cause_is_told_by_what_is_in_order_without_it() {
        let with = |elsewhere, drawn, place: Option<f64>| {
            let edges = Edges {
                shares: [0.1, 0.6],
                elsewhere,
            };
            let misplaced = Misplaced {
                edges,
                drawn,
                truths: place.map(|place| Truths { scenes: 5, place }),
            };
            misplaced.why()
        };
        let none = with(0.3, 0.6, None);
        assert!(
            none.contains("10 % of pixels with 60 % of the squared error"),
            "{none}"
        );
        assert!(none.ends_with("it was not found"), "{none}");
        let edges = with(0.5, 0.6, Some(0.1));
        assert!(edges.contains("these are the cause"), "{edges}");
        assert!(edges.contains("alike is not the cause"), "{edges}");
        assert!(edges.ends_with("is not the cause"), "{edges}");
        let alike = with(f64::NAN, 0.2, Some(0.1));
        assert!(alike.contains("these are not the cause"), "{alike}");
        assert!(alike.contains("alike is the cause"), "{alike}");
        let chance = with(0.3, 0.6, Some(0.5));
        assert!(
            chance.contains("over 5 scenes of other lamps it is 0.5"),
            "{chance}"
        );
        assert!(chance.ends_with("where they are, is the cause"), "{chance}");
        let two = with(0.5, 0.2, None);
        assert!(two.contains("these are a cause"), "{two}");
        assert!(two.ends_with("alike is a cause"), "{two}");
        assert!(with(0.3, 0.6, Some(f64::NAN)).ends_with("it was not found"));
    }
}
