//! How frames are dealt out to runs of the tape.
//!
//! A run works on a lot of frames side by side, one run after the other: the masks of a lot and their gradient then stay in a
//! core's second cache while every ray of every patch looks them up, which those of all frames together do not.

use super::super::shell::{Shell, Shells};

/// Frames side by side: as many as fill a vector register of the widest machines, or two or four of others. A lot of fewer is
/// filled up with frames that nothing is known of.
pub(super) const WIDTH: usize = 16;

/// Frames of one run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lot {
    /// Where their rays look masks up.
    pub(super) shell: Shell,
    /// At most [`WIDTH`].
    pub(super) frames: Vec<usize>,
}

/// All frames.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lots {
    pub(super) all: Vec<Lot>,
    /// For every frame its lot and its place in it.
    pub(super) place: Vec<[usize; 2]>,
}

impl Lots {
    /// Each group of frames that share a shell in lots of about equal size.
    pub(super) fn new(shells: &Shells) -> Self {
        let mut all = Vec::new();
        let mut place = vec![[0; 2]; shells.frames()];
        for group in &shells.groups {
            let count = group.frames.len();
            let lots = count.div_ceil(WIDTH);
            for lot in 0..lots {
                let frames = &group.frames[lot * count / lots..(lot + 1) * count / lots];
                for (k, &frame) in frames.iter().enumerate() {
                    place[frame] = [all.len(), k];
                }
                all.push(Lot {
                    shell: group.shell,
                    frames: frames.to_vec(),
                });
            }
        }
        Self { all, place }
    }

    /// The columns of one lot of `[texel][frame]`.
    pub(super) fn columns(&self, masks: &[f32], lot: usize) -> Vec<f32> {
        let frames = &self.all[lot].frames;
        let mut columns = vec![0.0; masks.len() / self.place.len() * WIDTH];
        let of_texel = masks.chunks_exact(self.place.len());
        for (to, from) in columns.chunks_exact_mut(WIDTH).zip(of_texel) {
            frames.iter().zip(to).for_each(|(&t, to)| *to = from[t]);
        }
        columns
    }

    /// Puts the columns of one lot back to where [`columns`](Self::columns) takes them from.
    pub(super) fn restore(&self, columns: &[f32], lot: usize, masks: &mut [f32]) {
        let frames = &self.all[lot].frames;
        let of_texel = masks.chunks_exact_mut(self.place.len());
        for (from, to) in columns.chunks_exact(WIDTH).zip(of_texel) {
            frames.iter().zip(from).for_each(|(&t, from)| to[t] = *from);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_has_one_place_and_columns_come_back() {
        let distances: Vec<f32> = (0..50).map(|t| 2.0 + 0.04 * (t * 7 % 50) as f32).collect();
        let lots = Lots::new(&Shells::cylinders(&distances));
        assert!(lots.all.len() > 3);
        let mut seen: Vec<usize> = lots.all.iter().flat_map(|lot| lot.frames.clone()).collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..50).collect::<Vec<_>>());
        for (frame, [lot, k]) in lots.place.iter().enumerate() {
            assert_eq!(lots.all[*lot].frames[*k], frame);
            assert!(*k < WIDTH);
        }
        let masks: Vec<f32> = (0..150).map(|i| i as f32).collect();
        let mut back = vec![0.0; masks.len()];
        for lot in 0..lots.all.len() {
            lots.restore(&lots.columns(&masks, lot), lot, &mut back);
        }
        assert_eq!(back, masks);
    }
}
