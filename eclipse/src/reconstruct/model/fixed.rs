//! What the tape reads and never changes during a stage, or only between rounds.

use std::sync::Arc;

use glam::Vec3;
use render::lat_long::LatLong;

use super::super::{
    patches::Observations,
    shell::{Shell, Shells},
};

/// Texels of a mask along the side of one of light.
pub(in crate::reconstruct) const MASK_SIDE: usize = 2;

/// Inputs of the tape, bound without copies.
pub(super) struct Fixed {
    pub(super) offsets: Arc<[u32]>,
    pub(super) texel: Arc<[u32]>,
    pub(super) weight: Arc<[f32]>,
    pub(super) groups: Vec<FixedGroup>,
    /// Which albedo each residual depends on.
    pub(super) albedo_of: Arc<[u32]>,
}

/// Inputs of a group of frames; values are `[channel][patch][frame of the group]`.
pub(super) struct FixedGroup {
    pub(super) corner: [Arc<[u32]>; 4],
    pub(super) corner_weight: [Arc<[f32]>; 4],
    pub(super) value: Arc<[f32]>,
    pub(super) root_weight: Arc<[f32]>,
}

impl Fixed {
    pub(super) fn new(
        grid: LatLong,
        rows: &[f32],
        observations: &Observations,
        shells: &Shells,
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
            shells,
            [offsets.into(), texel.into()],
            weight.into(),
        )
    }

    /// The same transport with occluders on other surfaces, and the values as they were observed.
    pub(super) fn repainted(
        &self,
        grid: LatLong,
        observations: &Observations,
        shells: &Shells,
    ) -> Self {
        let rows = [self.offsets.clone(), self.texel.clone()];
        Self::painted(grid, observations, shells, rows, self.weight.clone())
    }

    fn painted(
        grid: LatLong,
        observations: &Observations,
        shells: &Shells,
        [offsets, texel]: [Arc<[u32]>; 2],
        weight: Arc<[f32]>,
    ) -> Self {
        let patches = observations.patches.len();
        let views = &observations.views;
        let values = grouped(shells, patches, observations, &|i, c| views[i].value[c]);
        let weights = grouped(shells, patches, observations, &|i, c| {
            views[i].weight[c].sqrt()
        });
        let mut albedo_of = Vec::new();
        let groups = shells
            .groups
            .iter()
            .zip(values.into_iter().zip(weights))
            .map(|(group, (value, root_weight))| {
                let count = group.frames.len();
                albedo_of.extend((0..3 * patches * count).map(|i| (i / count) as u32));
                let (corner, corner_weight) =
                    lookups(grid, &offsets, &texel, observations, group.shell);
                FixedGroup {
                    corner: corner.map(Into::into),
                    corner_weight: corner_weight.map(Into::into),
                    value: value.into(),
                    root_weight: root_weight.into(),
                }
            })
            .collect();
        Self {
            groups,
            albedo_of: albedo_of.into(),
            offsets,
            texel,
            weight,
        }
    }
}

/// Where the rays of all patches look masks up: four texels each, and their weights.
fn lookups(
    grid: LatLong,
    offsets: &[u32],
    texel: &[u32],
    observations: &Observations,
    shell: Shell,
) -> ([Vec<u32>; 4], [Vec<f32>; 4]) {
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
    (corner, weight)
}

/// Values of all views by group of frames, `[channel][patch][frame of the group]`; zero where there is no view.
pub(super) fn grouped(
    shells: &Shells,
    patches: usize,
    observations: &Observations,
    part: &dyn Fn(usize, usize) -> f32,
) -> Vec<Vec<f32>> {
    let counts: Vec<usize> = shells.groups.iter().map(|g| g.frames.len()).collect();
    let mut all: Vec<Vec<f32>> = counts.iter().map(|n| vec![0.0; 3 * patches * n]).collect();
    for (i, view) in observations.views.iter().enumerate() {
        let [group, k] = shells.place[view.frame as usize];
        for c in 0..3 {
            let row = c * patches + view.patch as usize;
            all[group][row * counts[group] + k] = part(i, c);
        }
    }
    all
}

/// The masks' grid beside that of light.
pub fn mask_grid(grid: LatLong) -> LatLong {
    LatLong::new(MASK_SIDE * grid.rows, MASK_SIDE * grid.columns)
}
