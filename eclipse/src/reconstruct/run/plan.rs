//! How finely the surface is divided, so that a run keeps to its memory.

use render::lat_long::LatLong;

use super::{
    super::{fast::Stage, shell::Shells, surface},
    uncertainty::MOST_PRODUCTS,
};
use crate::{
    capture::Capture,
    settings::{OccluderPrior, Settings},
};

/// About the share of the grid of light that a point of a surface looks at, and that is not behind the object.
const SEEN: f64 = 0.47;
/// Fewer sites or patches than this say too little about light.
const LEAST: [usize; 2] = [500, 150];

/// How many sites the surface has and how finely the largest stage divides it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// Sites of the surface in fine.
    pub(super) sites: usize,
    /// Most patches of a stage.
    pub(super) patches: usize,
}

impl Plan {
    /// The finest that fits into the settings' memory; where even the coarsest does not, that.
    pub(super) fn new(capture: &Capture, settings: &Settings, largest: &Stage) -> Self {
        let mut plan = Self {
            sites: surface::sites_for(&capture.frames),
            patches: largest.patches,
        };
        while plan.bytes(capture, settings) > settings.memory
            && (plan.sites > LEAST[0] || plan.patches > LEAST[1])
        {
            plan.sites = (plan.sites * 4 / 5).max(LEAST[0].min(plan.sites));
            plan.patches = (plan.patches * 4 / 5).max(LEAST[1].min(plan.patches));
        }
        plan
    }

    /// What a run takes at its peak, in bytes: measured peaks lie below.
    pub(super) fn bytes(&self, capture: &Capture, settings: &Settings) -> u64 {
        let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
        let frames = capture.frames.len() as f64;
        let pixels: usize = capture.frames.iter().map(|f| f.mask.data.len()).sum();
        let inside = |mask: &[f32]| mask.iter().filter(|&&m| m > 0.5).count();
        let seen: usize = capture.frames.iter().map(|f| inside(&f.mask.data)).sum();
        let groups = if settings.occluders {
            Shells::of_cameras(capture.frames.iter().map(|f| &f.camera))
                .groups
                .len() as f64
        } else {
            1.0
        };
        // A photograph and its mask; materials and render at the end, and the patch of every pixel, twice over.
        let images = pixels as f64 * (4.0 * (4.0 + 8.0) + 2.0 * 4.0);
        // What every pixel looks at while the surface is divided.
        let sights = seen as f64 * 72.0;
        let directions = grid.len() as f64 * SEEN;
        let rows = self.sites as f64 * (directions * 6.0 + frames * 150.0);
        let tape = self.patches as f64
            * (directions * (8.0 + 32.0 * groups) + grid.len() as f64 * 4.0 + frames * 200.0);
        let masks = 4.0 * grid.len() as f64 * frames * 60.0;
        let mesh = capture.mesh.faces.len() as f64 * 400.0;
        // Directions that data determine, and what moves with each.
        let harmonics = match settings.occluder_prior {
            OccluderPrior::None => (settings.harmonic_degree as f64 + 1.0).powi(2) * frames,
            OccluderPrior::Operator => 0.0,
        };
        let moved = 8.0 * grid.len() as f64 + 3.0 * self.patches as f64 + harmonics;
        let doubt = 2.0 * MOST_PRODUCTS as f64 * 4.0 * moved;
        (images + sights + rows + tape + masks + mesh + doubt + 80e6) as u64
    }
}
