//! Selections by masks, and masks of masks.

use std::ops::{BitAnd, BitOr, Not};
use std::panic::Location;

use super::array::{Array, Detached, Join, Kind, Mask};
use crate::op::Element;

impl Mask {
    /// `a` where set, `b` elsewhere. The branch not taken contributes no gradient, whatever it holds.
    #[track_caller]
    pub fn select<A: Join<B>, B: Kind>(&self, a: &Array<A>, b: &Array<B>) -> Array<A::Out> {
        let mask = &self.value;
        Array::<A>::elementwise(
            &mask.graph,
            Element::Select,
            &[(&mask.graph, mask.id), (&a.graph, a.id), (&b.graph, b.id)],
            Location::caller(),
        )
    }

    /// `a` where set, 0 elsewhere.
    #[track_caller]
    pub fn select_or_zero<A: Kind>(&self, a: &Array<A>) -> Array<A> {
        let mask = &self.value;
        let zero: Detached = mask.graph.constant(0.0);
        Array::<A>::elementwise(
            &mask.graph,
            Element::Select,
            &[
                (&mask.graph, mask.id),
                (&a.graph, a.id),
                (&zero.graph, zero.id),
            ],
            Location::caller(),
        )
    }

    /// The mask as 0 and 1.
    pub fn to_array(&self) -> Detached {
        self.value.clone()
    }
}

impl BitAnd for &Mask {
    type Output = Mask;
    #[track_caller]
    fn bitand(self, other: &Mask) -> Mask {
        Mask {
            value: self.value.min(&other.value),
        }
    }
}

impl BitOr for &Mask {
    type Output = Mask;
    #[track_caller]
    fn bitor(self, other: &Mask) -> Mask {
        Mask {
            value: self.value.max(&other.value),
        }
    }
}

impl Not for &Mask {
    type Output = Mask;
    #[track_caller]
    fn not(self) -> Mask {
        Mask {
            value: 1.0 - &self.value,
        }
    }
}
