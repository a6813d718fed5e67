//! Samples of a run of points in the making, and runs joined to a batch.

use std::iter::repeat_n;
use std::sync::Arc;

use rayon::prelude::*;

use super::{Corners, Lookup, PathBatch};
use crate::lat_long::Bilinear;

/// What a [`PathBatch`] is made of, for some of its points.
pub(super) struct Run {
    /// Of the run's first sample: 0.
    pub(super) offsets: Vec<u32>,
    pub(super) outgoing: Vec<f32>,
    pub(super) incident: Vec<f32>,
    pub(super) half: Vec<f32>,
    pub(super) difference: Vec<f32>,
    pub(super) weight: Vec<f32>,
    pub(super) light: Texels,
    pub(super) mask: Texels,
}

/// The texels that samples read, a corner an array.
pub(super) struct Texels {
    pub(super) index: Vec<Vec<u32>>,
    /// Empty for one corner.
    pub(super) weight: Vec<Vec<f32>>,
}

impl Run {
    /// A run without points.
    pub(super) fn empty(lookup: Lookup) -> Self {
        Self {
            offsets: vec![0],
            outgoing: Vec::new(),
            incident: Vec::new(),
            half: Vec::new(),
            difference: Vec::new(),
            weight: Vec::new(),
            light: Texels::empty(lookup),
            mask: Texels::empty(lookup),
        }
    }

    /// All runs after one another.
    pub(super) fn join(runs: &[Self], lookup: Lookup) -> PathBatch {
        if runs.is_empty() {
            return Self::join(&[Self::empty(lookup)], lookup);
        }
        let mut offsets = vec![0];
        for run in runs {
            let start = offsets[offsets.len() - 1];
            offsets.extend(run.offsets[1..].iter().map(|o| o + start));
        }
        let reals: Vec<Vec<&[f32]>> = runs.iter().map(Self::reals).collect();
        let words: Vec<Vec<&[u32]>> = runs.iter().map(Self::words).collect();
        let (reals, words) = rayon::join(|| concatenated(&reals), || concatenated(&words));
        let (mut reals, mut words) = (reals.into_iter(), words.into_iter());
        let mut real = || reals.next().unwrap_or_default();
        let [outgoing, incident, half, difference, weight] = std::array::from_fn(|_| real());
        let corners = words.len() / 2;
        let weights = reals.len() / 2;
        let mut corners = || Corners {
            index: words.by_ref().take(corners).collect(),
            weight: reals.by_ref().take(weights).collect(),
        };
        PathBatch {
            offsets,
            outgoing,
            incident,
            half,
            difference,
            weight,
            light: corners(),
            mask: corners(),
        }
    }

    /// All arrays of numbers, the weights of corners last.
    fn reals(&self) -> Vec<&[f32]> {
        let own = [
            &self.outgoing,
            &self.incident,
            &self.half,
            &self.difference,
            &self.weight,
        ];
        let corners = [&self.light.weight, &self.mask.weight];
        let all = own.into_iter().chain(corners.into_iter().flatten());
        all.map(Vec::as_slice).collect()
    }

    /// All arrays of texels.
    fn words(&self) -> Vec<&[u32]> {
        let all = [&self.light.index, &self.mask.index].into_iter().flatten();
        all.map(Vec::as_slice).collect()
    }
}

impl Texels {
    fn empty(lookup: Lookup) -> Self {
        let weights = match lookup {
            Lookup::Bilinear => 4,
            Lookup::Stochastic => 0,
        };
        Self {
            index: vec![Vec::new(); lookup.corners()],
            weight: vec![Vec::new(); weights],
        }
    }

    pub(super) fn push(&mut self, texels: &Bilinear) {
        for (index, texel) in self.index.iter_mut().zip(texels.index) {
            index.push(texel);
        }
        for (weights, weight) in self.weight.iter_mut().zip(texels.weight) {
            weights.push(weight);
        }
    }
}

/// Each of the runs' arrays after one another; arrays and runs are shared among threads.
fn concatenated<T: Copy + Default + Send + Sync>(runs: &[Vec<&[T]>]) -> Vec<Arc<[T]>> {
    let arrays = runs.first().map_or(0, Vec::len);
    let array = |k: usize| {
        let len = runs.iter().map(|run| run[k].len()).sum();
        let mut all: Arc<[T]> = repeat_n(T::default(), len).collect();
        let mut rest = Arc::get_mut(&mut all).unwrap_or_default();
        let mut copies = Vec::with_capacity(runs.len());
        for run in runs {
            let (to, others) = rest.split_at_mut(run[k].len());
            copies.push((to, run[k]));
            rest = others;
        }
        let copies = copies.into_par_iter();
        copies.for_each(|(to, from)| to.copy_from_slice(from));
        all
    };
    (0..arrays).into_par_iter().map(array).collect()
}
