//! Small captures that studies make for themselves: an object that shades itself, most often three balls, lamps of a chosen size
//! around it, somebody in the light or nobody.

use std::{f32::consts::TAU, rc::Rc};

use glam::Vec3;
use render::{bsdf::Model, image::Image, lat_long::LatLong, mesh::Mesh, sampler::SampleKey};

use super::{
    Bench, Scale, StudyError,
    trial::{Solved, Trial},
};
use crate::{
    evaluate::{
        Truth,
        materials::{Specular, TrueAlbedo},
    },
    settings::{Batch, Preset, Settings},
    synthesize::{Occluders, Pattern, Scene, Shooting, SynthesizeError, synthesize_seen},
};

/// Rows of the map of light.
const ROWS: usize = 50;
/// Lamps around the object.
const LAMPS: usize = 6;
/// Radiance everywhere beside lamps.
const AMBIENT: f32 = 0.15;
/// Mean of what lamps add.
const LAMPLIGHT: f32 = 0.45;
/// Reflectance of shiny objects at normal incidence.
pub(super) const KAPPA: f32 = 0.04;

/// What is photographed and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// The object.
    pub object: Object,
    /// Radius in degrees at which each lamp is 1/e as bright as at its centre.
    pub lamp: f32,
    /// Width α of the specular lobe; `None` for a matt object.
    pub alpha: Option<f32>,
    /// Height of the person in the light relative to the usual; `None` for nobody.
    pub person: Option<f32>,
    /// Photographs.
    pub frames: usize,
    /// Pixels across and down.
    pub resolution: usize,
    /// Sensor noise, see [`Shooting::noise`].
    pub noise: f32,
    /// Seed of the lamps' places.
    pub scene: u64,
    /// Seed of the sensor's noise.
    pub seed: u64,
}

impl Setup {
    /// What studies vary one thing of: in full.
    pub const BASE: Self = Self {
        object: Object::Balls,
        lamp: 12.0,
        alpha: None,
        person: Some(1.0),
        frames: 16,
        resolution: 40,
        noise: 0.005,
        scene: 0,
        seed: 0,
    };

    /// The same with what a scale has time for: a photograph costs as much as its part of the solve.
    pub fn of(scale: Scale) -> Self {
        let (frames, resolution) = match scale {
            Scale::Glance => (6, 16),
            Scale::Quick => (Self::BASE.frames, 32),
            Scale::Full => (Self::BASE.frames, Self::BASE.resolution),
        };
        Self {
            frames,
            resolution,
            ..Self::BASE
        }
    }

    /// The same in as many pixels as a moving shadow takes to tell of the light: in each it is little, and in sixteen photographs of 32 x
    /// 32 pixels somebody in the light was no help.
    pub fn telling(scale: Scale) -> Self {
        let (frames, resolution) = match scale {
            Scale::Glance => (6, 16),
            Scale::Quick => (48, 48),
            Scale::Full => (48, 64),
        };
        Self {
            frames,
            resolution,
            ..Self::BASE
        }
    }

    /// The same for the paper's algorithm, with more noise where there is little time: it is reached in fewer iterations, and errors say
    /// nothing before.
    pub fn noisy(scale: Scale) -> Self {
        let noise = match scale {
            Scale::Glance | Scale::Quick => 0.02,
            Scale::Full => Self::BASE.noise,
        };
        Self {
            noise,
            ..Self::of(scale)
        }
    }

    /// What it is, for whoever waits.
    fn words(&self) -> String {
        let finish = match self.alpha {
            None => "matt".to_owned(),
            Some(alpha) => format!("α {alpha}"),
        };
        let person = match self.person {
            None => "nobody".to_owned(),
            Some(height) => format!("somebody of height {height}"),
        };
        format!(
            "{} ({finish}), lamps of {}°, {person}, {} photographs of {} pixels, noise {}, seed {}",
            self.object.name(),
            self.lamp,
            self.frames,
            self.resolution,
            self.noise,
            self.seed
        )
    }

    /// The capture with its truth. The bench keeps what its cameras see for those that follow.
    ///
    /// # Errors
    /// A scene that cannot be rendered, or the caller's stop.
    pub fn trial(&self, bench: &Bench<'_>, name: &str) -> Result<Trial, StudyError> {
        let light = lamps(self.lamp, self.scene);
        let scene = Scene {
            mesh: self.object.mesh(),
            environment: light.clone(),
            model: match self.alpha {
                None => Model::Lambertian,
                Some(_) => Model::Microfacet,
            },
            albedo: Pattern {
                mean: [0.55, 0.5, 0.45],
                variation: 0.25,
            },
            alpha: self.alpha.unwrap_or(1.0),
            kappa: if self.alpha.is_some() { KAPPA } else { 0.0 },
            occluders: self.person.map_or(Occluders::None, Occluders::Person),
        };
        let shooting = Shooting {
            frames: self.frames,
            resolution: self.resolution,
            distance: 3.0,
            noise: self.noise,
            seed: self.seed,
        };
        let go_on = |_| !bench.stopped();
        let mut seen = bench.seen.borrow_mut();
        let made = synthesize_seen(&scene, &shooting, Some(&mut seen), go_on);
        let made = made.map_err(|error| match error {
            SynthesizeError::Stopped => StudyError::Stopped,
            error => error.into(),
        })?;
        let albedo = made.albedo.into_iter().zip(&made.capture.frames);
        let truth = Truth {
            environment: Some(light.clone()),
            occluders: (!made.occluders.is_empty()).then_some(made.occluders),
            albedo: albedo
                .map(|(albedo, frame)| TrueAlbedo {
                    albedo,
                    object: frame.mask.data.iter().map(|&m| m > 0.999).collect(),
                })
                .collect(),
            specular: self.alpha.map(|alpha| Specular {
                alpha: alpha.into(),
                kappa: KAPPA.into(),
            }),
        };
        Ok(Trial {
            name: name.to_owned(),
            capture: Rc::new(made.capture),
            truth,
            light,
        })
    }
}

/// Steps of a reconstruction: one at a glance, else the schedule's coarse stage, whose light has texels of 7°.
const STEPS: [u64; 3] = [1, 24, 24];
/// Steps of a reconstruction of a [`Setup::telling`] capture, in the same stage.
const TELLING_STEPS: [u64; 3] = [1, 14, 24];
/// Memory for each in bytes, which divides the surface of so small an object into a few hundred patches, seconds each; fewer at a
/// glance.
const MEMORY: [u64; 3] = [160 << 20, 218 << 20, 218 << 20];
/// What a photograph's mask takes of it: more photographs are not to be paid for in patches.
const MEMORY_A_PHOTOGRAPH: u64 = 2 << 20;

/// Steps of the reconstruction of a small capture.
pub(super) fn steps(bench: &Bench<'_>) -> u64 {
    bench.of_scale(STEPS)
}

/// Steps of the reconstruction of a [`Setup::telling`] capture.
pub(super) fn telling_steps(bench: &Bench<'_>) -> u64 {
    bench.of_scale(TELLING_STEPS)
}

/// How small captures are reconstructed: the same on any machine.
pub(super) fn settings(bench: &Bench<'_>, trial: &Trial, seed: u64) -> Settings {
    Settings {
        time_limit: None,
        iterations: Some(steps(bench)),
        memory: bench.of_scale(MEMORY) + MEMORY_A_PHOTOGRAPH * trial.capture.frames.len() as u64,
        seed,
        ..bench.settings(trial)
    }
}

/// Iterations of the paper's algorithm on a [`Setup::noisy`] capture: until about its noise is left of the photographs.
const ITERATIONS: [u64; 3] = [2, 800, 4800];
/// The size of each: as small as still shows most frames.
pub(super) const BATCH: Batch = Batch {
    pixels: 512,
    rays: 32,
};

/// Iterations of the paper's algorithm on a small capture.
pub(super) fn iterations(bench: &Bench<'_>) -> u64 {
    bench.of_scale(ITERATIONS)
}

/// How small captures are reconstructed by the paper's algorithm: the same on any machine.
pub(super) fn paper_settings(bench: &Bench<'_>, trial: &Trial, seed: u64) -> Settings {
    Settings {
        time_limit: None,
        iterations: Some(iterations(bench)),
        batch: Some(BATCH),
        seed,
        ..bench.settings_of(Preset::Paper, trial)
    }
}

/// What the paper's algorithm leaves of a small capture when it ends, as a variance, over the variance of the photographs' noise:
/// its loss is an unbiased estimate of the former.
pub(super) fn misfit(trial: &Trial, setup: &Setup, solved: &Solved) -> f64 {
    let (mut sum, mut count) = (0.0, 0u64);
    for frame in &trial.capture.frames {
        let pixels = frame.image.data.chunks_exact(3).zip(&frame.mask.data);
        for (pixel, _) in pixels.filter(|(_, mask)| **mask > 0.999) {
            let values = pixel.iter().map(|v| f64::from(v.max(0.0)) + 0.25);
            sum += values.sum::<f64>();
            count += 3;
        }
    }
    let noise = f64::from(setup.noise).powi(2) * sum / count as f64;
    solved.found.curve.last().map_or(f64::NAN, |p| p.loss) / noise
}

/// A [`Setup::telling`] capture, and what is recovered of it with occluders in the model where somebody is in the light; its seed is
/// the solver's as well.
///
/// # Errors
/// A scene that cannot be rendered, a capture that cannot be reconstructed, or the caller's stop.
pub(super) fn solve(bench: &Bench<'_>, setup: Setup) -> Result<(Trial, Solved), StudyError> {
    solve_with(bench, setup, &setup.words(), |bench, trial, seed| {
        Settings {
            iterations: Some(telling_steps(bench)),
            ..settings(bench, trial, seed)
        }
    })
}

/// The same in all steps of the schedule's coarse stage.
///
/// # Errors
/// As [`solve`].
pub(super) fn solve_longer(bench: &Bench<'_>, setup: Setup) -> Result<(Trial, Solved), StudyError> {
    let words = format!("{}, {} steps", setup.words(), steps(bench));
    solve_with(bench, setup, &words, settings)
}

/// The same by the paper's algorithm with so many rays from each surface point.
///
/// # Errors
/// As [`solve`].
pub(super) fn solve_by_rays(
    bench: &Bench<'_>,
    setup: Setup,
    rays: u64,
) -> Result<(Trial, Solved), StudyError> {
    let words = format!("{}, {rays} rays", setup.words());
    solve_with(bench, setup, &words, |bench, trial, seed| Settings {
        batch: Some(Batch { rays, ..BATCH }),
        ..paper_settings(bench, trial, seed)
    })
}

fn solve_with(
    bench: &Bench<'_>,
    setup: Setup,
    words: &str,
    settings: impl Fn(&Bench<'_>, &Trial, u64) -> Settings,
) -> Result<(Trial, Solved), StudyError> {
    let trial = setup.trial(bench, setup.object.name())?;
    let settings = Settings {
        occluders: setup.person.is_some(),
        ..settings(bench, &trial, setup.seed)
    };
    let solved = bench.reconstructed(&trial, words, &settings)?;
    Ok((trial, solved))
}

/// What is photographed, in one material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Object {
    /// Three balls of different sizes that touch.
    Balls,
    /// A body with a head and two arms.
    Figure,
    /// A flat cap on a stem.
    Mushroom,
    /// Balls on a ring, upright.
    Wreath,
}

impl Object {
    /// Each of them.
    pub const ALL: [Self; 4] = [Self::Balls, Self::Figure, Self::Mushroom, Self::Wreath];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Balls => "balls",
            Self::Figure => "figure",
            Self::Mushroom => "mushroom",
            Self::Wreath => "wreath",
        }
    }

    fn mesh(self) -> Mesh {
        let part = |[x, y, z]: [f32; 3], radii: [f32; 3]| {
            ellipsoid(Vec3::new(x, y, z), Vec3::from_array(radii))
        };
        let parts: Vec<Mesh> = match self {
            Self::Balls => vec![
                Mesh::sphere(Vec3::new(-0.42, 0.0, -0.1), 0.5, 32),
                Mesh::sphere(Vec3::new(0.4, 0.15, 0.0), 0.38, 32),
                Mesh::sphere(Vec3::new(0.05, -0.25, 0.5), 0.3, 32),
            ],
            Self::Figure => vec![
                part([0.0, 0.0, -0.2], [0.38, 0.28, 0.6]),
                part([0.0, 0.0, 0.62], [0.25, 0.25, 0.28]),
                part([-0.5, 0.05, 0.0], [0.14, 0.16, 0.42]),
                part([0.5, -0.05, 0.0], [0.14, 0.16, 0.42]),
            ],
            Self::Mushroom => vec![
                part([0.0, 0.0, -0.25], [0.26, 0.22, 0.6]),
                part([0.05, 0.0, 0.35], [0.75, 0.65, 0.28]),
            ],
            Self::Wreath => (0..8)
                .map(|k| {
                    let (sin, cos) = (k as f32 * TAU / 8.0).sin_cos();
                    Mesh::sphere(Vec3::new(0.7 * cos, 0.2 * sin, 0.7 * sin), 0.28, 20)
                })
                .collect(),
        };
        let mut mesh = Mesh::default();
        parts.iter().for_each(|part| mesh.append(part));
        mesh
    }
}

/// A ball that is stretched along the axes.
fn ellipsoid(centre: Vec3, radii: Vec3) -> Mesh {
    let mut mesh = Mesh::sphere(Vec3::ZERO, 1.0, 32);
    for (position, normal) in mesh.positions.iter_mut().zip(&mut mesh.normals) {
        *position = centre + radii * *position;
        *normal = (*normal / radii).normalize();
    }
    mesh
}

/// Lamps of `width` degrees at random places not far below the horizon, of random brightness and colour; their power does not
/// depend on their width.
pub fn lamps(width: f32, seed: u64) -> Image {
    let key = SampleKey {
        seed,
        frame: u32::MAX - 1,
        ..SampleKey::default()
    };
    let mut stream = key.stream();
    let all: Vec<(Vec3, [f32; 3])> = (0..LAMPS)
        .map(|_| {
            let [u, v] = stream.uniform_2d();
            let z = -0.3 + 1.25 * u;
            let (sin, cos) = (TAU * v).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let power = 0.4 + 1.2 * stream.uniform();
            let colour = [0; 3].map(|_| power * (0.7 + 0.6 * stream.uniform()));
            (Vec3::new(across * cos, across * sin, z), colour)
        })
        .collect();
    let grid = LatLong::new(ROWS, 2 * ROWS);
    let sharp = 1.0 / (1.0 - width.to_radians().cos());
    let mut map = Image::filled(grid.columns, grid.rows, 3, 0.0);
    for (texel, pixel) in map.data.chunks_exact_mut(3).enumerate() {
        let d = grid.texel_direction(texel / grid.columns, texel % grid.columns);
        for (place, colour) in &all {
            let near = (sharp * (d.dot(*place) - 1.0)).exp();
            (0..3).for_each(|c| pixel[c] += near * colour[c]);
        }
    }
    let solid = |texel: usize| grid.solid_angle(texel / grid.columns);
    let sum: f32 = (0..grid.len())
        .map(|t| solid(t) * map.data[3 * t..3 * t + 3].iter().sum::<f32>() / 3.0)
        .sum();
    let factor = LAMPLIGHT * 2.0 * TAU / sum;
    map.data
        .iter_mut()
        .for_each(|value| *value = AMBIENT + factor * *value);
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_can_be_rendered_and_are_wound_as_balls_are() {
        let ball = Mesh::sphere(Vec3::ZERO, 1.0, 32);
        let wound = ball
            .face_normal(40)
            .dot(ball.normals[ball.faces[40][0] as usize]);
        for object in Object::ALL {
            let mesh = object.mesh();
            mesh.validate().unwrap();
            assert!(mesh.bounding_radius() < 1.3, "{object:?}");
            assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
            for face in 0..mesh.faces.len() {
                let normal = mesh.face_normal(face);
                let vertex = mesh.normals[mesh.faces[face][0] as usize];
                let outwards = wound.signum() * normal.dot(vertex);
                assert!(outwards > 0.5, "{object:?}, face {face}: {outwards}");
            }
        }
    }

    #[test]
    fn lamps_are_as_bright_together_whatever_their_width() {
        let grid = LatLong::new(ROWS, 2 * ROWS);
        let mean = |width: f32| -> f32 {
            let map = lamps(width, 3);
            let texels = map.data.chunks_exact(3).enumerate();
            let sum: f32 = texels
                .map(|(t, p)| grid.solid_angle(t / grid.columns) * p.iter().sum::<f32>() / 3.0)
                .sum();
            sum / (2.0 * TAU)
        };
        for width in [5.0, 15.0, 40.0] {
            assert!((mean(width) - AMBIENT - LAMPLIGHT).abs() < 1e-3, "{width}");
        }
        let brightest = |width: f32| lamps(width, 3).data.into_iter().fold(0.0, f32::max);
        assert!(brightest(5.0) > 5.0 * brightest(40.0));
    }
}
