//! How much of the paper's budget an iteration takes here, and how much memory.
//!
//! The paper draws 2 × 2¹⁶ pixels of 1024 rays an iteration on a GPU. The expected gradient is the same for any batch, and
//! Adam gains more from many noisy steps than from few exact ones, so a CPU takes small batches.

use render::{lat_long::LatLong, visibility::VisibilityCache};

use crate::{
    capture::{Capture, Frame},
    settings::{Batch, MaskForm, Settings},
};

/// The paper's pixels an iteration.
pub const MOST_PIXELS: u64 = 1 << 16;
/// The paper's rays from a surface point.
const MOST_RAYS: u64 = 1024;
/// Fewer pixels than this leave most frames without one.
const LEAST_PIXELS: u64 = 512;
/// Rays from a point where time is short.
const LEAST_RAYS: u64 = 32;
/// Pixels without a time limit to derive them from.
const USUAL_PIXELS: u64 = 2048;
/// Samples that one core shades in a second, the network and derivatives included: it scales the batch, no more.
const SAMPLES_PER_SECOND: f64 = 1.5e6;
/// Iterations that a time limit should allow for.
const WANTED_ITERATIONS: f64 = 2500.0;
/// Share of the time limit kept for materials and renders.
const FINISH_SHARE: f64 = 0.12;
/// Samples that one core shades in a second in final renders, without derivatives.
const FINAL_SAMPLES_PER_SECOND: f64 = 5e6;
/// Rays from the light of each pixel of a final render. With 64 their noise is larger than what a good fit leaves; as many as
/// the paper's iterations draw leave 35 dB and more to be seen.
const FINAL_RAYS: (f64, f64) = (64.0, 512.0);
/// Memory that a sample takes while an iteration runs, in bytes: its path twice over, and what the tape keeps of it.
const BYTES_PER_SAMPLE: u64 = 160;
/// The same for a pixel's two renders: the network's layers and their adjoints.
const BYTES_PER_PIXEL: u64 = 2 * 6 * 128 * 4 * 2;
/// Iterations without a limit of either kind.
const USUAL_ITERATIONS: u64 = 10_000;
/// Cells of the surface that are told apart, at most.
const MOST_CELLS: u64 = 40_000;
/// With fewer cells shadows would be too coarse: rays are cast instead.
const LEAST_CELLS: u64 = 400;
/// Shadow rays that one core casts in a second.
pub const RAYS_PER_SECOND: f64 = 2.5e6;
/// Share of one core's time that may go into the cache of what cells see.
const CACHE_SHARE: f64 = 0.15;
/// Bytes of the capture's mesh and its hierarchy for each face.
const BYTES_PER_FACE: u64 = 400;

/// The size of an iteration, kept when a run goes on with other limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// Pixels, each rendered twice.
    pub pixels: u64,
    /// Rays a render of a pixel: half from the light, half from the material.
    pub rays: u64,
    /// Most cells of the surface.
    pub cells: u64,
    /// Parts of a texel, along a side, whose visibility from each cell is cached; 0 casts rays.
    pub side: u64,
}

/// Where memory goes, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// Photographs and masks, and the images that are written at the end.
    pub images: u64,
    /// The mesh and its hierarchy.
    pub mesh: u64,
    /// The list of pixels that can be fitted.
    pub pixels: u64,
    /// Tables of light and masks with their moments and gradients.
    pub tables: u64,
    /// An iteration's paths and tape.
    pub iteration: u64,
    /// The cache of what cells see.
    pub visibility: u64,
}

impl Memory {
    /// All of it.
    pub fn total(&self) -> u64 {
        self.images + self.mesh + self.pixels + self.tables + self.iteration + self.visibility
    }
}

impl Plan {
    /// What casts rays; cells then tell materials apart, no more.
    const CASTING: Self = Self {
        pixels: 0,
        rays: 0,
        cells: MOST_CELLS / 4,
        side: 0,
    };

    /// The batch that was asked for or, without one, a batch that suits the time limit and a cache that does, both within the
    /// memory. It does not depend on the threads.
    pub fn new(settings: &Settings, capture: &Capture) -> Self {
        if let Some(Batch { pixels, rays }) = settings.batch {
            return Self {
                pixels: pixels.min(Batch::MOST),
                rays: rays.min(Batch::MOST),
                ..Self::CASTING
            };
        }
        let rest = |memory: &Memory| settings.memory.saturating_sub(memory.total());
        let fixed = Self::default().memory(settings, capture);
        let mut plan = Self::batch(settings, rest(&fixed) / 2);
        let room = rest(&plan.memory(settings, capture));
        (plan.cells, plan.side) = plan.cache(settings, room);
        plan
    }

    /// Pixels and rays of an iteration within `memory` bytes.
    fn batch(settings: &Settings, memory: u64) -> Self {
        let usual = 2 * USUAL_PIXELS * LEAST_RAYS;
        let affordable = settings.time_limit.map_or(usual, |limit| {
            (limit * SAMPLES_PER_SECOND / WANTED_ITERATIONS) as u64
        });
        let per_sample = BYTES_PER_SAMPLE + BYTES_PER_PIXEL / (2 * LEAST_RAYS);
        let samples = affordable.min(memory / per_sample);
        let pixels = (samples / (2 * LEAST_RAYS)).clamp(LEAST_PIXELS, MOST_PIXELS);
        // Pixels first: they tell more than rays do.
        let rays = (samples / (2 * pixels)).clamp(LEAST_RAYS, MOST_RAYS);
        Self {
            pixels,
            rays,
            ..Self::default()
        }
    }

    /// Cells and side of the visibility cache within `memory` bytes and the time there is.
    fn cache(&self, settings: &Settings, memory: u64) -> (u64, u64) {
        let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
        let in_time = settings
            .time_limit
            .map_or(f64::INFINITY, |limit| limit * RAYS_PER_SECOND * CACHE_SHARE);
        // A cache that casts more rays than it saves is none.
        let saved = iterations(settings).map_or(f64::INFINITY, |n| {
            n as f64 * (2 * self.pixels * self.rays) as f64
        });
        // Half of the directions are below the horizon.
        let cast = in_time.min(saved / 2.0) / (grid.len() as f64 / 2.0);
        let memory = usize::try_from(memory).unwrap_or(usize::MAX);
        for side in [2, 1] {
            let per_cell = VisibilityCache::bytes(1, grid, side).max(1);
            let cells = MOST_CELLS
                .min((cast / (side * side) as f64) as u64)
                .min((memory / per_cell) as u64);
            // Four times the bits are worth it only where there are enough cells.
            if cells >= if side > 1 { MOST_CELLS } else { LEAST_CELLS } {
                return (cells, side as u64);
            }
        }
        (Self::CASTING.cells, Self::CASTING.side)
    }

    /// What a run of this plan needs.
    pub fn memory(&self, settings: &Settings, capture: &Capture) -> Memory {
        let grid = LatLong::new(settings.grid_rows, 2 * settings.grid_rows);
        let pixels: u64 = capture
            .frames
            .iter()
            .map(|f| f.mask.data.len() as u64)
            .sum();
        let frames = capture.frames.len() as u64;
        let covered = |mask: &[f32]| mask.iter().filter(|&&m| m > super::batch::COVERED).count();
        let object: u64 = capture
            .frames
            .iter()
            .map(|f| covered(&f.mask.data) as u64)
            .sum();
        let coefficients = match settings.parametrisation.masks {
            MaskForm::Harmonics => (settings.harmonic_degree as u64 + 1).pow(2),
            MaskForm::Texels => grid.len() as u64,
        };
        let cached = usize::try_from(self.cells).unwrap_or(usize::MAX);
        Memory {
            // Photograph (3) and mask (1) before, materials (5) and render (3) after.
            images: 12 * 4 * pixels,
            mesh: BYTES_PER_FACE * capture.mesh.faces.len() as u64,
            // Pixel and cell; while cells are cut, the surface point and its key.
            pixels: 80 * object,
            tables: 4 * frames * (4 * grid.len() as u64 + 6 * coefficients),
            iteration: self.pixels * (BYTES_PER_PIXEL + 2 * self.rays * BYTES_PER_SAMPLE),
            visibility: match self.side {
                0 => 0,
                side => VisibilityCache::bytes(cached, grid, side as usize) as u64,
            },
        }
    }
}

/// How far a run has come, of [0, 1]: by iterations or by time, whichever is further.
pub fn progress(settings: &Settings, iteration: u64, seconds: f64) -> f64 {
    let by_time = self::seconds(settings).map_or(0.0, |limit| seconds / limit);
    let by_count = iterations(settings).map_or(0.0, |most| iteration as f64 / most as f64);
    by_time.max(by_count).min(1.0)
}

/// The seconds for iterations: the time limit without the share that materials and renders take at the end.
pub fn seconds(settings: &Settings) -> Option<f64> {
    settings
        .time_limit
        .map(|limit| (1.0 - FINISH_SHARE) * limit)
}

/// Rays from the light, and as many from the material, of each pixel of the final renders: what the time kept for them allows.
pub fn final_rays(settings: &Settings, frames: &[Frame]) -> usize {
    let (least, most) = FINAL_RAYS;
    let object = |frame: &Frame| frame.mask.data.iter().filter(|&&m| m > 0.0).count();
    let pixels: usize = frames.iter().map(object).sum();
    let rays = settings.time_limit.map_or(most, |limit| {
        FINISH_SHARE * limit * FINAL_SAMPLES_PER_SECOND / (2.0 * pixels.max(1) as f64)
    });
    rays.clamp(least, most) as usize
}

/// The most iterations, when time does not limit them.
pub fn iterations(settings: &Settings) -> Option<u64> {
    settings
        .iterations
        .or(settings.time_limit.is_none().then_some(USUAL_ITERATIONS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use render::mesh::Mesh;

    fn capture() -> Capture {
        Capture {
            path: "nowhere".into(),
            frames: Vec::new(),
            mesh: Mesh::default(),
            centre: Vec3::ZERO,
            lamps: None,
        }
    }

    fn plan(time_limit: Option<f64>, memory: u64) -> Plan {
        let settings = Settings {
            time_limit,
            memory,
            ..Settings::default()
        };
        let plan = Plan::new(&settings, &capture());
        let needed = plan.memory(&settings, &capture()).total();
        assert!(needed <= memory, "{plan:?}: {needed} of {memory}");
        plan
    }

    #[test]
    fn batches_grow_with_time_up_to_the_papers_and_stay_within_memory() {
        let usual = plan(Some(150.0), 4 << 30);
        assert!((1000..4000).contains(&usual.pixels), "{usual:?}");
        let paper = plan(Some(1e7), 1 << 60);
        assert_eq!((paper.pixels, paper.rays), (1 << 16, 1024));
        plan(Some(1e7), 64 << 20);
    }

    #[test]
    fn the_cache_shrinks_with_memory_and_time_until_rays_are_cast() {
        let whole = plan(Some(1e5), 4 << 30);
        assert_eq!((whole.side, whole.cells), (2, MOST_CELLS));
        let coarse = plan(Some(600.0), 4 << 30);
        assert_eq!(coarse.side, 1);
        assert!(coarse.cells > 10_000);
        let small = plan(Some(600.0), 40 << 20);
        assert!(small.side == 1 && small.cells < coarse.cells, "{small:?}");
        assert_eq!(plan(Some(1.0), 4 << 30).side, 0);
        // In the least memory that holds a batch there is no room for a cache beside it.
        let fits = |kib: &u64| {
            let settings = Settings {
                time_limit: Some(600.0),
                memory: kib << 10,
                ..Settings::default()
            };
            let plan = Plan::new(&settings, &capture());
            plan.memory(&settings, &capture()).total() <= settings.memory
        };
        let least = (1u64..1 << 16).step_by(64).find(fits);
        let least = least.expect("an empty capture takes little");
        assert_eq!(plan(Some(600.0), least << 10).side, 0);
    }

    #[test]
    fn a_batch_that_is_asked_for_is_taken_whatever_the_time() {
        for time_limit in [None, Some(1e5)] {
            let settings = Settings {
                time_limit,
                batch: Some(Batch {
                    pixels: 700,
                    rays: 6,
                }),
                ..Settings::default()
            };
            let plan = Plan::new(&settings, &capture());
            assert_eq!((plan.pixels, plan.rays, plan.side), (700, 6, 0));
        }
    }

    #[test]
    fn a_few_iterations_do_not_pay_for_a_cache() {
        let settings = Settings {
            time_limit: None,
            iterations: Some(2),
            ..Settings::default()
        };
        assert_eq!(Plan::new(&settings, &capture()).side, 0);
    }
}
