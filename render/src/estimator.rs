//! The paper's estimator as a whole: unknowns → tables and network → two independent renders → loss → gradients.
//!
//! One program serves all iterations; each brings its own paths.

use std::sync::{Mutex, PoisonError};

use autodiff::{Graph, GraphError, Program, RunError, Sizes, Workspace};
use glam::Vec3;

use crate::bsdf::Model;
use crate::lat_long::LatLong;
use crate::loss::{LossForm, two_sample};
use crate::materials::{MaterialNetwork, Network};
use crate::path::{Lookup, PathBatch};
use crate::pyramid::Pyramid;
use crate::radiance::{
    Shading, batch_sizes, bind_batch, bind_values, free_table_sizes, record_environment,
    record_free_masks, record_masks, record_radiance, table_sizes,
};

/// What the logits of masks are expressed in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskBasis {
    /// Spherical harmonics (Eq. 6).
    #[default]
    Harmonics,
    /// A value of its own for every texel and frame, which the paper compares with (Table 1).
    Texels,
}

/// What the estimator models.
#[derive(Clone, Debug)]
pub struct EstimatorOptions {
    /// Which reflectance.
    pub model: Model,
    /// The environment's pyramid.
    pub pyramid: Pyramid,
    /// Grid of the masks.
    pub mask_grid: LatLong,
    /// Degree of the masks' harmonics.
    pub degree: usize,
    /// Number of frames, each with a mask; 0 for no occluders.
    pub frames: usize,
    /// How samples read the tables.
    pub lookup: Lookup,
    /// How the loss is recorded.
    pub form: LossForm,
}

/// The unknowns, or gradients with respect to them.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknowns {
    /// `[channel][pyramid value]`: logarithmic radiance by levels.
    pub environment: Vec<f32>,
    /// `[coefficient][frame]`: harmonics of the masks' logits; `[texel][frame]` where each has its own.
    pub occluders: Vec<f32>,
    /// The material network.
    pub network: MaterialNetwork,
}

/// One of the two renders of the same pixels: a point a pixel, and its paths.
#[derive(Clone, Copy, Debug)]
pub struct RenderSample<'a> {
    /// Positions of the points, in the order of the batch.
    pub positions: &'a [Vec3],
    /// Their paths.
    pub batch: &'a PathBatch,
}

/// A compiled estimator.
pub struct Estimator {
    options: EstimatorOptions,
    masks: MaskBasis,
    program: Program,
    /// Of the last batch: the next has nearly as many samples.
    workspace: Mutex<Option<Workspace<f32>>>,
}

/// Names of the two renders on the tape.
const RENDERS: [&str; 2] = ["first", "second"];

impl EstimatorOptions {
    /// The start of the paper: a map of ones, masks of transmittance σ(`logit`), materials near ½.
    pub fn start(&self, logit: f32, seed: u64, radius: f32) -> Unknowns {
        self.start_in(MaskBasis::Harmonics, logit, seed, radius)
    }

    /// The same with masks in another basis.
    pub fn start_in(&self, masks: MaskBasis, logit: f32, seed: u64, radius: f32) -> Unknowns {
        let occluders = match masks {
            MaskBasis::Harmonics => {
                let coefficients = (self.degree + 1).pow(2);
                let mut occluders = vec![0.0; coefficients * self.frames];
                // Y₀₀ = 1/√(4π) everywhere.
                occluders[..self.frames].fill(logit * (4.0 * std::f32::consts::PI).sqrt());
                occluders
            }
            MaskBasis::Texels => vec![logit; self.mask_grid.len() * self.frames],
        };
        Unknowns {
            environment: vec![0.0; 3 * self.pyramid.len()],
            occluders,
            network: MaterialNetwork::new(seed, radius),
        }
    }
}

impl Estimator {
    /// Records and compiles the program.
    ///
    /// # Errors
    /// When the recorded formulas do not fit together.
    pub fn new(options: EstimatorOptions) -> Result<Self, GraphError> {
        Self::with_masks(options, MaskBasis::Harmonics)
    }

    /// The same with masks in another basis; of harmonics the options then tell nothing.
    ///
    /// # Errors
    /// As [`Estimator::new`].
    pub fn with_masks(options: EstimatorOptions, basis: MaskBasis) -> Result<Self, GraphError> {
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let environment = record_environment(&g, &options.pyramid);
        let masks = (options.frames > 0).then(|| match basis {
            MaskBasis::Harmonics => {
                record_masks(&g, options.degree, options.mask_grid, options.frames)
            }
            MaskBasis::Texels => record_free_masks(&g),
        });
        let network = Network::record(&g);
        let renders = RENDERS.map(|name| {
            let Shading {
                albedo,
                alpha,
                kappa,
            } = network.evaluate(&g, name, &pixel);
            let shading = Shading {
                albedo,
                alpha,
                kappa,
            };
            record_radiance(
                &g,
                name,
                &pixel,
                options.model,
                options.lookup,
                &environment,
                masks.as_ref(),
                &shading,
            )
        });
        let photograph = g.input("photograph", &pixel, 3);
        let loss = two_sample(&renders[0], &renders[1], &photograph, options.form);
        let program = g.compile(&[
            ("loss", &loss),
            ("first", &renders[0]),
            ("second", &renders[1]),
        ])?;
        Ok(Self {
            options,
            masks: basis,
            program,
            workspace: Mutex::new(None),
        })
    }

    /// The loss and its gradients at `unknowns` for one batch of pixels.
    ///
    /// `photographs` is `[channel][pixel]`. For [`LossForm::HalfBackward`] the value is twice the product's.
    ///
    /// # Errors
    /// When the renders, the photographs and the unknowns are not of the sizes of the options.
    pub fn gradients(
        &self,
        unknowns: &Unknowns,
        renders: [RenderSample; 2],
        photographs: &[f32],
    ) -> Result<(f64, Unknowns), RunError> {
        let EstimatorOptions {
            model,
            pyramid,
            mask_grid,
            degree,
            frames,
            ..
        } = &self.options;
        let pixels = renders[0].batch.points();
        let tables = match self.masks {
            MaskBasis::Harmonics => {
                table_sizes(Sizes::new(), pyramid, *degree, *mask_grid, *frames)
            }
            MaskBasis::Texels => free_table_sizes(Sizes::new(), pyramid, *mask_grid, *frames),
        };
        let mut sizes = tables.lanes("pixel", pixels);
        for (name, render) in RENDERS.iter().zip(&renders) {
            sizes = batch_sizes(sizes, name, render.batch);
        }
        let last = || {
            self.workspace
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let kept = last().take();
        let mut ws = match kept {
            Some(mut ws) => {
                self.program.resize(&mut ws, &sizes)?;
                ws
            }
            None => self.program.workspace::<f32>(&sizes)?,
        };
        ws.set("environment", &unknowns.environment)?;
        if *frames > 0 {
            ws.set("occluders", &unknowns.occluders)?;
        }
        unknowns.network.bind(&mut ws)?;
        bind_values(&mut ws, "photograph", photographs)?;
        for (name, render) in RENDERS.iter().zip(&renders) {
            bind_batch(&mut ws, name, *model, *frames > 0, render.batch)?;
            ws.set(
                &format!("{name} encoding"),
                &unknowns.network.encode(render.positions),
            )?;
        }
        self.program.vjp(&mut ws, "loss")?;
        let mut gradients = unknowns.clone();
        gradients
            .environment
            .copy_from_slice(ws.gradient("environment")?);
        if *frames > 0 {
            gradients
                .occluders
                .copy_from_slice(ws.gradient("occluders")?);
        }
        for (layer, (weight, bias)) in unknowns.network.names().iter().enumerate() {
            gradients.network.weights[layer].copy_from_slice(ws.gradient(weight)?);
            gradients.network.biases[layer].copy_from_slice(ws.gradient(bias)?);
        }
        let loss = f64::from(ws.output("loss")?[0]);
        *last() = Some(ws);
        Ok((loss, gradients))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        bvh::Bvh,
        camera::Camera,
        environment::LightDistribution,
        mesh::Mesh,
        path::{PathScene, PathSettings, ShadingPoint},
        visibility::Visibility,
    };

    /// Loss and gradients of a few pixels of a ball in two frames, whose masks all have the transmittance σ(`logit`); with no
    /// `frames` there are no masks.
    fn gradients(basis: MaskBasis, frames: usize, logit: f32) -> (f64, Unknowns) {
        let grid = LatLong::new(8, 16);
        let bvh = Bvh::new(&Mesh::sphere(Vec3::ZERO, 1.0, 12)).unwrap();
        let camera = Camera::look_at(8, 8, 0.6, 4.0 * Vec3::X, Vec3::ZERO);
        let points: Vec<ShadingPoint> = (18..46)
            .step_by(3)
            .filter_map(|pixel: u32| {
                let (x, y) = ((pixel % 8) as f32 + 0.5, (pixel / 8) as f32 + 0.5);
                let (surface, outgoing) = bvh.seen(&camera, x, y)?;
                Some(ShadingPoint {
                    surface,
                    outgoing,
                    frame: pixel % 2,
                    pixel,
                    cached: 0,
                    alpha: 0.5,
                })
            })
            .collect();
        assert!(points.len() > 4, "{}", points.len());
        let options = EstimatorOptions {
            model: Model::Lambertian,
            pyramid: Pyramid::new(grid, 3),
            mask_grid: grid,
            degree: 2,
            frames,
            lookup: Lookup::Bilinear,
            form: LossForm::Product,
        };
        let unknowns = options.start_in(basis, logit, 1, 1.0);
        let lights = LightDistribution::new(grid, &vec![1.0; grid.len()]);
        let scene = PathScene {
            bvh: &bvh,
            visibility: Visibility::Rays,
            model: options.model,
            lights: &lights,
            environment_grid: grid,
            mask_grid: grid,
            radii: &[4.0, 4.2],
        };
        let batches = [0, 1].map(|render| {
            let settings = PathSettings {
                light_samples: 4,
                material_samples: 4,
                seed: 3,
                iteration: 0,
                lookup: options.lookup,
                render,
            };
            PathBatch::sample(&scene, &points, &settings)
        });
        let positions: Vec<Vec3> = points.iter().map(|p| p.surface.position).collect();
        let renders = [&batches[0], &batches[1]].map(|batch| RenderSample {
            positions: &positions,
            batch,
        });
        let photographs = vec![0.2; 3 * points.len()];
        let estimator = Estimator::with_masks(options, basis).unwrap();
        estimator
            .gradients(&unknowns, renders, &photographs)
            .unwrap()
    }

    #[test]
    fn a_mask_of_one_value_is_the_same_in_either_basis() {
        let (loss, harmonics) = gradients(MaskBasis::Harmonics, 2, 0.7);
        let (free_loss, texels) = gradients(MaskBasis::Texels, 2, 0.7);
        assert!(
            (free_loss / loss - 1.0).abs() < 1e-4,
            "{free_loss} for {loss}"
        );
        // The coefficient of Y₀₀ moves all texels of its frame alike.
        assert_eq!(texels.occluders.len(), 2 * 8 * 16);
        let constant = 1.0 / (4.0 * std::f64::consts::PI).sqrt();
        for frame in 0..2 {
            let of_frame = texels.occluders.iter().skip(frame).step_by(2);
            let sum = constant * of_frame.map(|&g| f64::from(g)).sum::<f64>();
            let expected = f64::from(harmonics.occluders[frame]);
            assert!(expected.abs() > 1e-6);
            assert!((sum / expected - 1.0).abs() < 1e-3, "{sum} for {expected}");
        }
        for (free, other) in texels.environment.iter().zip(&harmonics.environment) {
            assert!((free - other).abs() < 1e-4 * (1.0 + other.abs()));
        }
    }

    #[test]
    fn no_masks_are_masks_that_light_passes() {
        let (clear, unknowns) = gradients(MaskBasis::Texels, 2, 40.0);
        assert!(unknowns.occluders.iter().all(|g| g.abs() < 1e-12));
        for basis in [MaskBasis::Harmonics, MaskBasis::Texels] {
            let (loss, gradients) = gradients(basis, 0, 40.0);
            assert!(gradients.occluders.is_empty());
            assert!((loss / clear - 1.0).abs() < 1e-5, "{loss} for {clear}");
        }
    }
}
