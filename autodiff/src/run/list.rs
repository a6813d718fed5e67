//! Lists on the stack.

/// Places of a short list.
pub(super) const FEW: usize = 8;

/// Binds `$name` to a slice of at least `$count` places that hold `$empty`, at most `$most` of them. It is short where few are
/// needed: a long one takes as long to fill as a tile to compute.
macro_rules! list {
    ($name:ident, $count:expr, $empty:expr, $most:expr) => {
        let (mut few, mut many);
        let $name: &mut [_] = if $count <= $crate::run::list::FEW {
            few = [$empty; $crate::run::list::FEW];
            &mut few
        } else {
            many = [$empty; $most];
            &mut many
        };
    };
}

pub(super) use list;
