//! An object in another light, with another finish, through a capture's cameras.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bsdf::{Material, Model},
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    environment::EnvironmentMap,
    image::Image,
    lat_long::LatLong,
    reference::Reference,
};

use crate::studies::{
    small::KAPPA,
    trial::{Solved, Trial},
};

/// Every so many pixels across and down; all of the pixels of the first view's pictures.
const STEP: usize = 4;
/// Rows of the grid on which light is integrated.
const ROWS: usize = 25;

/// What is done to the surface before it is relit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Finish {
    /// As it is.
    Own,
    /// Without its lobe.
    Matt,
    /// With a lobe of this α.
    Shiny(f32),
}

impl Finish {
    /// What it is called.
    pub(super) fn words(self) -> String {
        match self {
            Self::Own => "own finish".into(),
            Self::Matt => "matt".into(),
            Self::Shiny(alpha) => format!("α {alpha}"),
        }
    }

    /// The material with this finish, and how it reflects.
    fn of(self, albedo: [f32; 3], lobe: Option<[f32; 2]>) -> (Model, Material) {
        let lobe = match self {
            Self::Own => lobe,
            Self::Matt => None,
            Self::Shiny(alpha) => Some([alpha, KAPPA]),
        };
        let model = match lobe {
            Some(_) => Model::Microfacet,
            None => Model::Lambertian,
        };
        let [alpha, kappa] = lobe.unwrap_or([1.0, 0.0]);
        (
            model,
            Material {
                albedo: albedo.map(|a| a.clamp(0.0, 1.0)),
                alpha,
                kappa,
            },
        )
    }
}

/// Radiance of chosen pixels under another light.
pub(super) struct Relit(Vec<[f32; 3]>);

impl Relit {
    /// Of what was recovered, or of the truth.
    pub(super) fn new(
        bvh: &Bvh,
        light: &EnvironmentMap,
        finish: Finish,
        trial: &Trial,
        views: &[usize],
        solved: Option<&Solved>,
    ) -> Self {
        let mut all = Vec::new();
        for &view in views {
            let surface = Surface::new(trial, view, solved);
            let reference = reference(bvh, light, surface.model(finish));
            let frame = &trial.capture.frames[view];
            let camera = &frame.camera;
            let pixels: Vec<[usize; 2]> = (0..camera.height)
                .step_by(STEP)
                .flat_map(|y| (0..camera.width).step_by(STEP).map(move |x| [x, y]))
                .filter(|[x, y]| frame.mask.pixel(*x, *y)[0] > 0.999)
                .collect();
            let values: Vec<[f32; 3]> = pixels
                .par_iter()
                .map(|&pixel| {
                    let material = |point: &SurfacePoint| surface.material(camera, point, finish);
                    let [r, g, b, _] = reference.pixel(camera, pixel, None, material);
                    [r, g, b]
                })
                .collect();
            all.extend(values);
        }
        Self(all)
    }

    /// Relative RMSE, without any alignment beyond that of the albedo.
    pub(super) fn error(&self, truth: &Self) -> f64 {
        let (mut off, mut all) = (0.0, 0.0);
        for (a, b) in self.0.iter().flatten().zip(truth.0.iter().flatten()) {
            off += f64::from(a - b).powi(2);
            all += f64::from(*b).powi(2);
        }
        (off / all).sqrt()
    }
}

/// All of a view under another light.
pub(super) fn picture(
    bvh: &Bvh,
    light: &EnvironmentMap,
    finish: Finish,
    trial: &Trial,
    view: usize,
    solved: Option<&Solved>,
) -> Image {
    let surface = Surface::new(trial, view, solved);
    let camera = &trial.capture.frames[view].camera;
    let material = |point: &SurfacePoint| surface.material(camera, point, finish);
    let rgba = reference(bvh, light, surface.model(finish)).frame(camera, None, material);
    Image {
        channels: 3,
        data: rgba
            .data
            .chunks_exact(4)
            .flat_map(|p| [p[0], p[1], p[2]])
            .collect(),
        ..rgba
    }
}

fn reference<'a>(bvh: &'a Bvh, light: &EnvironmentMap, model: Model) -> Reference<'a> {
    let grid = LatLong::new(ROWS, 2 * ROWS);
    Reference::with_radiance(bvh, grid, |d: Vec3| light.radiance(d), model, 2)
}

/// Materials as a camera sees them.
struct Surface<'a> {
    albedo: Image,
    object: &'a [bool],
    lobe: Option<[f32; 2]>,
}

impl<'a> Surface<'a> {
    fn new(trial: &'a Trial, view: usize, solved: Option<&Solved>) -> Self {
        let truth = &trial.truth.albedo[view];
        let (albedo, lobe) = match solved {
            None => {
                let lobe = trial.truth.specular;
                let lobe = lobe.map(|s| [s.alpha as f32, s.kappa as f32]);
                (truth.albedo.clone(), lobe)
            }
            Some(solved) => {
                let of = &solved.found.vertex_materials;
                let lobe = of.first().filter(|_| trial.truth.specular.is_some());
                (
                    solved.albedo_through(view),
                    lobe.map(|m| [m.alpha, m.kappa]),
                )
            }
        };
        Self {
            albedo,
            object: &truth.object,
            lobe,
        }
    }

    fn model(&self, finish: Finish) -> Model {
        finish.of([0.5; 3], self.lobe).0
    }

    /// The material of the pixel that a point is seen in; of the nearest of the object beside it on silhouettes.
    fn material(&self, camera: &Camera, point: &SurfacePoint, finish: Finish) -> Material {
        let [x, y] = camera.project(point.position).unwrap_or_default();
        let within = |v: f32, most: usize| (v.max(0.0) as usize).min(most - 1);
        let (x, y) = (within(x, self.albedo.width), within(y, self.albedo.height));
        let around = [[0i32, 0], [1, 0], [-1, 0], [0, 1], [0, -1]];
        let pixel = around
            .iter()
            .map(|[dx, dy]| {
                let x = x
                    .saturating_add_signed(*dx as isize)
                    .min(self.albedo.width - 1);
                let y = y
                    .saturating_add_signed(*dy as isize)
                    .min(self.albedo.height - 1);
                y * self.albedo.width + x
            })
            .find(|&p| self.object[p])
            .unwrap_or(y * self.albedo.width + x);
        let albedo = &self.albedo.data[self.albedo.channels * pixel..];
        finish.of([albedo[0], albedo[1], albedo[2]], self.lobe).1
    }
}
