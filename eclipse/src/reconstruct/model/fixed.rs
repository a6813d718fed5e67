//! What the tape reads and never changes during a stage, or only between rounds.

use std::sync::Arc;

use glam::Vec3;
use render::lat_long::LatLong;

use super::{
    super::{patches::Observations, shell::Shell},
    lots::{Lots, WIDTH},
};

/// Texels of a mask along the side of one of light.
pub(in crate::reconstruct) const MASK_SIDE: usize = 2;

/// Inputs of the tape, bound without copies.
pub(super) struct Fixed {
    pub(super) offsets: Arc<[u32]>,
    pub(super) texel: Arc<[u32]>,
    pub(super) weight: Arc<[f32]>,
    pub(super) lots: Vec<FixedLot>,
    /// Which albedo each residual depends on.
    pub(super) albedo_of: Arc<[u32]>,
}

/// Inputs of a lot of frames; values are `[channel][patch][frame of the lot]`.
pub(super) struct FixedLot {
    pub(super) lookups: Arc<Lookups>,
    pub(super) value: Arc<[f32]>,
    pub(super) root_weight: Arc<[f32]>,
}

/// Where the rays of all patches look masks up: four texels each, and their weights.
pub(super) struct Lookups {
    pub(super) corner: [Arc<[u32]>; 4],
    pub(super) weight: [Arc<[f32]>; 4],
}

impl Fixed {
    pub(super) fn new(
        grid: LatLong,
        rows: &[f32],
        observations: &Observations,
        lots: &Lots,
    ) -> Self {
        let (mut offsets, mut texel, mut weight) = (vec![0u32], Vec::new(), Vec::new());
        for row in rows.chunks_exact(grid.len()) {
            for (d, &w) in row.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                texel.push(d as u32);
                weight.push(w);
            }
            offsets.push(texel.len() as u32);
        }
        Self::painted(
            grid,
            observations,
            lots,
            [offsets.into(), texel.into()],
            weight.into(),
        )
    }

    /// The same transport with occluders on other surfaces, and the values as they were observed.
    pub(super) fn repainted(
        &self,
        grid: LatLong,
        observations: &Observations,
        lots: &Lots,
    ) -> Self {
        let rows = [self.offsets.clone(), self.texel.clone()];
        Self::painted(grid, observations, lots, rows, self.weight.clone())
    }

    fn painted(
        grid: LatLong,
        observations: &Observations,
        lots: &Lots,
        [offsets, texel]: [Arc<[u32]>; 2],
        weight: Arc<[f32]>,
    ) -> Self {
        let patches = observations.patches.len();
        let views = &observations.views;
        let values = dealt(lots, patches, observations, &|i, c| views[i].value[c]);
        let weights = dealt(lots, patches, observations, &|i, c| {
            views[i].weight[c].sqrt()
        });
        let mut last: Option<(Shell, Arc<Lookups>)> = None;
        let mut of_shell = |shell: Shell| match &last {
            Some((own, lookups)) if *own == shell => lookups.clone(),
            _ => {
                let lookups = Arc::new(lookups(grid, &offsets, &texel, observations, shell));
                last = Some((shell, lookups.clone()));
                lookups
            }
        };
        let dealt = lots.all.iter().zip(values.into_iter().zip(weights));
        let fixed = dealt
            .map(|(lot, (value, root_weight))| FixedLot {
                lookups: of_shell(lot.shell),
                value: value.into(),
                root_weight: root_weight.into(),
            })
            .collect();
        let of_lot = 0..3 * patches * WIDTH;
        let albedo_of = (0..lots.all.len()).flat_map(|_| of_lot.clone());
        Self {
            lots: fixed,
            albedo_of: albedo_of.map(|i| (i / WIDTH) as u32).collect(),
            offsets,
            texel,
            weight,
        }
    }
}

fn lookups(
    grid: LatLong,
    offsets: &[u32],
    texel: &[u32],
    observations: &Observations,
    shell: Shell,
) -> Lookups {
    let directions: Vec<Vec3> = (0..grid.len())
        .map(|d| grid.texel_direction(d / grid.columns, d % grid.columns))
        .collect();
    let mut corner: [Vec<u32>; 4] = std::array::from_fn(|_| Vec::with_capacity(texel.len()));
    let mut weight: [Vec<f32>; 4] = std::array::from_fn(|_| Vec::with_capacity(texel.len()));
    for (ends, patch) in offsets.windows(2).zip(&observations.patches) {
        for &d in &texel[ends[0] as usize..ends[1] as usize] {
            let lookup = shell.lookup(mask_grid(grid), patch.position, directions[d as usize]);
            for k in 0..4 {
                corner[k].push(lookup.index[k]);
                weight[k].push(lookup.weight[k]);
            }
        }
    }
    Lookups {
        corner: corner.map(Into::into),
        weight: weight.map(Into::into),
    }
}

/// Values of all views by lot of frames, `[channel][patch][frame of the lot]`; zero where there is no view.
pub(super) fn dealt(
    lots: &Lots,
    patches: usize,
    observations: &Observations,
    part: &dyn Fn(usize, usize) -> f32,
) -> Vec<Vec<f32>> {
    let mut all = vec![vec![0.0; 3 * patches * WIDTH]; lots.all.len()];
    for (i, view) in observations.views.iter().enumerate() {
        let [lot, k] = lots.place[view.frame as usize];
        for c in 0..3 {
            let row = c * patches + view.patch as usize;
            all[lot][row * WIDTH + k] = part(i, c);
        }
    }
    all
}

/// The masks' grid beside that of light.
pub fn mask_grid(grid: LatLong) -> LatLong {
    LatLong::new(MASK_SIDE * grid.rows, MASK_SIDE * grid.columns)
}
