//! Small captures that studies make for themselves: three balls that shade each other, lamps of a chosen size around them,
//! somebody in the light or nobody.

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
    settings::Settings,
    synthesize::{Occluders, Pattern, Scene, Shooting, synthesize},
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
    /// Width of each lamp as a standard deviation, in degrees.
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

    /// The capture with its truth.
    ///
    /// # Errors
    /// A scene that cannot be rendered.
    pub fn trial(&self, name: &str) -> Result<Trial, StudyError> {
        let light = lamps(self.lamp, self.scene);
        let scene = Scene {
            mesh: balls(),
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
        let made = synthesize(&scene, &shooting, |_| true)?;
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
/// Memory for each in bytes, which divides the surface of so small an object into a few hundred patches, seconds each; fewer at a
/// glance.
const MEMORY: [u64; 3] = [160 << 20, 218 << 20, 218 << 20];
/// What a photograph's mask takes of it: more photographs are not to be paid for in patches.
const MEMORY_A_PHOTOGRAPH: u64 = 2 << 20;

/// Steps of the reconstruction of a small capture.
pub(super) fn steps(bench: &Bench<'_>) -> u64 {
    bench.of_scale(STEPS)
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

/// A capture, and what is recovered of it with occluders in the model where somebody is in the light; its seed is the solver's
/// as well.
///
/// # Errors
/// A scene that cannot be rendered, a capture that cannot be reconstructed, or the caller's stop.
pub(super) fn solve(bench: &Bench<'_>, setup: Setup) -> Result<(Trial, Solved), StudyError> {
    let trial = setup.trial("balls")?;
    let settings = Settings {
        occluders: setup.person.is_some(),
        ..settings(bench, &trial, setup.seed)
    };
    let solved = bench.reconstructed(&trial, &format!("{setup:?}"), &settings)?;
    Ok((trial, solved))
}

/// Three balls of different sizes that touch.
fn balls() -> Mesh {
    let mut mesh = Mesh::default();
    mesh.append(&Mesh::sphere(Vec3::new(-0.42, 0.0, -0.1), 0.5, 32));
    mesh.append(&Mesh::sphere(Vec3::new(0.4, 0.15, 0.0), 0.38, 32));
    mesh.append(&Mesh::sphere(Vec3::new(0.05, -0.25, 0.5), 0.3, 32));
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
