//! The frames whose photographs are embedded, where all would be too many.

/// `most` of `count` frames, evenly spread; of those held out, by which a fit is judged, a quarter of the places at least.
pub(super) fn frames(count: usize, most: usize, held_out: impl Fn(usize) -> bool) -> Vec<usize> {
    let (held, fitted): (Vec<usize>, Vec<usize>) = (0..count).partition(|&frame| held_out(frame));
    let places = most.max(1).min(count);
    let of_held = held
        .len()
        .min((places / 4).max(places.saturating_sub(fitted.len())));
    let chosen = |frames: &[usize], most: usize| -> Vec<usize> {
        match most {
            0 => Vec::new(),
            most => spread(frames.len(), most).map(|i| frames[i]).collect(),
        }
    };
    let mut all = chosen(&fitted, places - of_held);
    all.extend(chosen(&held, of_held));
    all.sort_unstable();
    all
}

/// `most` of `count` indices, evenly spread, both ends among them.
fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let shown = count.min(most.max(1));
    (0..shown).map(move |i| {
        if shown < 2 {
            0
        } else {
            i * (count - 1) / (shown - 1)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::{frames, spread};

    #[test]
    fn held_out_frames_are_among_those_shown() {
        let all = frames(64, 16, |frame| frame % 8 == 7);
        assert_eq!(all.len(), 16);
        assert!(all.is_sorted_by(|a, b| a < b), "{all:?}");
        assert_eq!(all.iter().filter(|frame| **frame % 8 == 7).count(), 4);
        assert_eq!(frames(5, 16, |frame| frame == 4), [0, 1, 2, 3, 4]);
        assert_eq!(frames(5, 3, |_| false), [0, 2, 4]);
        assert_eq!(frames(4, 2, |_| true), [0, 3]);
        assert_eq!(frames(1, 0, |_| false), [0]);
        assert!(frames(0, 4, |_| false).is_empty());
    }

    #[test]
    fn frames_are_spread_evenly_with_both_ends() {
        assert_eq!(spread(5, 16).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        assert_eq!(spread(10, 4).collect::<Vec<_>>(), [0, 3, 6, 9]);
        assert_eq!(spread(0, 4).count(), 0);
        assert_eq!(spread(1, 4).collect::<Vec<_>>(), [0]);
    }
}
