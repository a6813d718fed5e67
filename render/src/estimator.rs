//! The paper's estimator as a whole: unknowns → tables and network → two independent renders → loss → gradients.
//!
//! One program serves all iterations; each brings its own paths.

use autodiff::{Graph, GraphError, Program, RunError, Sizes};
use glam::Vec3;

use crate::bsdf::Model;
use crate::lat_long::LatLong;
use crate::loss::{LossForm, two_sample};
use crate::materials::{MaterialNetwork, Network};
use crate::path::{Lookup, PathBatch};
use crate::pyramid::Pyramid;
use crate::radiance::{
    Shading, batch_sizes, bind_batch, bind_values, record_environment, record_masks,
    record_radiance, table_sizes,
};

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
    /// `[coefficient][frame]`: harmonics of the masks' logits.
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
    program: Program,
}

/// Names of the two renders on the tape.
const RENDERS: [&str; 2] = ["first", "second"];

impl EstimatorOptions {
    /// The start of the paper: a map of ones, masks of transmittance σ(`logit`), materials near ½.
    pub fn start(&self, logit: f32, seed: u64, radius: f32) -> Unknowns {
        let coefficients = (self.degree + 1).pow(2);
        let mut occluders = vec![0.0; coefficients * self.frames];
        // Y₀₀ = 1/√(4π) everywhere.
        occluders[..self.frames].fill(logit * (4.0 * std::f32::consts::PI).sqrt());
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
        let g = Graph::new();
        let pixel = g.domain("pixel");
        let environment = record_environment(&g, &options.pyramid);
        let masks = (options.frames > 0)
            .then(|| record_masks(&g, options.degree, options.mask_grid, options.frames));
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
        Ok(Self { options, program })
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
        let mut sizes =
            table_sizes(Sizes::new(), pyramid, *degree, *mask_grid, *frames).lanes("pixel", pixels);
        for (name, render) in RENDERS.iter().zip(&renders) {
            sizes = batch_sizes(sizes, name, render.batch);
        }
        let mut ws = self.program.workspace::<f32>(&sizes)?;
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
        Ok((f64::from(ws.output("loss")?[0]), gradients))
    }
}
