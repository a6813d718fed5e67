//! How finely the surface is divided, so that a run keeps to its memory.

use render::lat_long::LatLong;

use super::{
    super::{fast::Stage, paper::plan::RAYS_PER_SECOND, shell::Shells, surface},
    ReconstructError, memory,
    uncertainty::MOST_PRODUCTS,
};
use crate::{
    capture::Capture,
    settings::{OccluderPrior, Settings},
};

/// About the share of the grid of light that a point of a surface looks at, and that is not behind the object.
const SEEN: f64 = 0.47;
/// Share of a time limit that may go into what sites see. More, and short runs end before their first step.
const VISIBILITY_SHARE: f64 = 0.2;
/// Cores that the plan counts on: as a number and not the machine's, so that it follows from settings alone.
const CORES: f64 = 2.0;
/// Fewer sites or patches than this say too little about light.
const LEAST: [usize; 2] = [500, 150];

/// Refuses a run of which even the coarsest plan takes more memory than the settings allow.
///
/// # Errors
/// [`ReconstructError::Memory`].
pub fn check_memory(capture: &Capture, settings: &Settings) -> Result<(), ReconstructError> {
    let needed = memory(capture, settings);
    if needed <= settings.memory {
        return Ok(());
    }
    Err(ReconstructError::Memory {
        needed,
        allowed: settings.memory,
    })
}

/// How many sites the surface has and how finely the largest stage divides it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// Sites of the surface in fine.
    pub(super) sites: usize,
    /// Most patches of a stage.
    pub(super) patches: usize,
}

impl Plan {
    /// The finest that fits into the settings' memory; where even the coarsest does not, that, which [`check_memory`] refuses.
    pub(super) fn new(capture: &Capture, settings: &Settings, largest: &Stage) -> Self {
        let sites = surface::sites_for(&capture.frames);
        let mut plan = Self {
            sites: sites.min(sites_in_time(settings).max(LEAST[0])),
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

/// Sites whose view of the light is cast in their share of the time limit.
fn sites_in_time(settings: &Settings) -> usize {
    let Some(seconds) = settings.time_limit else {
        return usize::MAX;
    };
    let texels = LatLong::new(settings.grid_rows, 2 * settings.grid_rows).len() as f64;
    let rays = texels * SEEN * surface::SIDE.pow(2) as f64;
    let seconds_a_site = rays / (CORES * RAYS_PER_SECOND);
    (VISIBILITY_SHARE * seconds / seconds_a_site) as usize
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use render::{camera::Camera, image::Image, mesh::Mesh};

    use super::*;
    use crate::{capture::Frame, control::Control, reconstruct::run, settings::Preset};

    /// A photograph of a ball.
    fn capture() -> Capture {
        let frame = Frame {
            name: "000".to_owned(),
            camera: Camera::look_at(32, 32, 0.5, 4.0 * Vec3::X, Vec3::ZERO),
            image: Image::filled(32, 32, 3, 0.5),
            mask: Image::filled(32, 32, 1, 1.0),
        };
        Capture {
            path: "ball".into(),
            frames: vec![frame],
            mesh: Mesh::sphere(Vec3::ZERO, 1.0, 16),
            centre: Vec3::ZERO,
            lamps: None,
        }
    }

    #[test]
    fn short_runs_have_fewer_sites() {
        let with = |seconds: Option<f64>| {
            sites_in_time(&Settings {
                time_limit: seconds,
                ..Settings::default()
            })
        };
        let (short, usual) = (with(Some(30.0)), with(Some(120.0)));
        assert!((3_000..3_500).contains(&short) && (12_000..14_000).contains(&usual));
        assert_eq!(with(None), usize::MAX);
        assert_eq!(with(Some(0.0)), 0);
        // A finer light takes more rays.
        let fine = Settings {
            time_limit: Some(30.0),
            grid_rows: 100,
            ..Settings::default()
        };
        assert_eq!(sites_in_time(&fine), short / 4);
    }

    #[test]
    fn a_run_that_cannot_keep_to_its_memory_is_refused_and_told_what_it_takes() {
        let capture = capture();
        for preset in [Preset::Fast, Preset::Paper] {
            let with = |memory: u64| Settings {
                preset,
                memory,
                ..Settings::default()
            };
            check_memory(&capture, &with(4 << 30)).unwrap();
            let refused = run(&capture, &with(1 << 20), &Control::detached());
            let error = refused.expect_err("a mebibyte holds no run");
            let ReconstructError::Memory { needed, allowed } = error else {
                panic!("{preset:?}: {error}");
            };
            assert!(error.is_of_the_input());
            assert_eq!(allowed, 1 << 20);
            check_memory(&capture, &with(needed)).unwrap();
            assert!(check_memory(&capture, &with(needed - 1)).is_err());
            // As much as the message says is enough.
            let enough = needed.div_ceil(1 << 20);
            assert!(
                error
                    .to_string()
                    .contains(&format!("--memory {enough}MiB or more")),
                "{error}"
            );
        }
    }

    #[test]
    fn the_least_memory_has_the_coarsest_plan_and_more_a_finer_one() {
        let (capture, settings) = (capture(), Settings::default());
        let largest = Stage {
            rows: 50,
            patches: 1500,
            members: 4,
            steps: 3,
            products: 25,
        };
        let plan = |memory: u64| {
            let settings = Settings {
                memory,
                ..settings.clone()
            };
            Plan::new(&capture, &settings, &largest)
        };
        let (coarsest, finest) = (plan(1), plan(4 << 30));
        let needed = coarsest.bytes(&capture, &settings);
        assert_eq!(plan(needed), coarsest);
        assert!(finest.patches > coarsest.patches);
        assert!(finest.bytes(&capture, &settings) > needed);
    }
}
