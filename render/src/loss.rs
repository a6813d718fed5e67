//! The two-sample loss (Eq. 9): unbiased where the square of one render's deviation is not.

use autodiff::{Detached, Var};

/// How the loss is recorded. Both have the same expected gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LossForm {
    /// Σ (I₁ − I)(I₂ − I), differentiated through both renders.
    Product,
    /// Σ 2 (I₁ − I)(I₂ − I) with I₁ detached: half the backward work. Its value is twice the product's.
    HalfBackward,
}

/// Records the loss of two independent renders of the same pixels against their photographs, summed.
///
/// The renders must share no random numbers: then the expectation is the squared deviation of the expected render.
pub fn two_sample(first: &Var, second: &Var, photograph: &Detached, form: LossForm) -> Var {
    let deviation = second - photograph;
    match form {
        LossForm::Product => ((first - photograph) * deviation).sum(),
        LossForm::HalfBackward => ((first.detach() - photograph) * deviation * 2.0).sum(),
    }
}

/// Records the square of one render's deviation, summed: biased by the render's variance. It is here for comparison.
pub fn one_sample(render: &Var, photograph: &Detached) -> Var {
    (render - photograph).square().sum()
}
