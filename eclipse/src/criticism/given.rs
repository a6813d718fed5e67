//! Occluders that the simulation has already: a part of the first model, as the simulation found them.

use render::{image::Image, lat_long::LatLong, occluder::shell_direction};

use super::{
    effects::{Mask, Passing},
    horizon::Horizon,
    observe::Observations,
};

/// Light that all masks let pass at least: none of it is blocked.
const CLEAR: f32 = 0.999;

/// One mask a frame, equirectangular on the shell at its camera's distance: 1 where light passes.
pub struct Given {
    masks: Vec<Image>,
}

impl Given {
    /// Of these masks; `None` where nothing is blocked.
    pub fn new(masks: &[Image]) -> Option<Self> {
        let values = masks.iter().flat_map(|mask| &mask.data);
        let blocks = values.into_iter().any(|share| *share < CLEAR);
        blocks.then(|| Self {
            masks: masks.to_vec(),
        })
    }

    /// The share of light that passes to each view from each source.
    pub fn passing(&self, horizon: &Horizon, seen: &Observations) -> Passing {
        let masks = self.masks.clone();
        let directions = horizon.directions.clone();
        let places: Vec<_> = seen
            .views
            .iter()
            .map(|view| {
                let frame = view.frame as usize;
                let point = seen.sites[view.site as usize].point.position;
                (frame, point, seen.eyes[frame].length())
            })
            .collect();
        let mask = Self { masks }.into_mask();
        Box::new(move |view, source| {
            let (frame, point, radius) = places[view];
            mask(frame, shell_direction(point, directions[source], radius))
        })
    }

    /// The share that passes from each direction, seen from the middle.
    pub fn into_mask(self) -> Mask {
        Box::new(move |frame, from| {
            let mask = &self.masks[frame];
            let grid = LatLong::new(mask.height, mask.width);
            let from = grid.bilinear(from);
            let share = |k: usize| mask.data[mask.channels * from.index[k] as usize];
            let sum: f32 = (0..4).map(|k| from.weight[k] * share(k)).sum();
            sum.clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_that_let_everything_pass_are_none() {
        let clear = Image::filled(8, 4, 1, 1.0);
        assert!(Given::new(&[clear.clone(), clear.clone()]).is_none());
        assert!(Given::new(&[]).is_none());
        let mut dark = clear.clone();
        dark.data[5] = 0.2;
        assert!(Given::new(&[clear, dark]).is_some());
    }

    #[test]
    fn what_passes_is_looked_up_from_the_middle() {
        let mut dark = Image::filled(8, 4, 1, 1.0);
        dark.data[8 + 3] = 0.25;
        let there = LatLong::new(4, 8).texel_direction(1, 3);
        let mask = Given::new(&[Image::filled(8, 4, 1, 1.0), dark])
            .unwrap()
            .into_mask();
        assert!((mask(1, there) - 0.25).abs() < 1e-3);
        assert!((mask(1, -there) - 1.0).abs() < 1e-3);
        assert!((mask(0, there) - 1.0).abs() < 1e-6);
    }
}
