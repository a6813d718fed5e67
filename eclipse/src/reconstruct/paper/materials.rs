//! The material network in bulk: evaluated at many places, and fitted to given materials.

use autodiff::{Detached, Graph, GraphError, Program, RunError, Sizes, Var};
use glam::Vec3;
use render::{
    bsdf::Material,
    materials::{MaterialNetwork, Network, OUTPUTS},
    radiance::bind_values,
    sampler::SampleKey,
};

use super::state::{flatten, unflatten};
use crate::reconstruct::adam::Adam;

/// Places evaluated at once: bounds the memory.
const BLOCK: usize = 1 << 14;
/// Steps of a fit, and places of each.
const STEPS: u64 = 400;
const PLACES: usize = 1024;
/// Learning rate of a fit.
const RATE: f32 = 3e-3;

/// A compiled network.
pub struct MaterialEvaluator {
    program: Program,
}

impl MaterialEvaluator {
    /// Records and compiles.
    ///
    /// # Errors
    /// When the recorded formulas do not fit together.
    pub fn new() -> Result<Self, GraphError> {
        let g = Graph::new();
        let place = g.domain("place");
        let shading = Network::record(&g).evaluate(&g, "place", &place);
        let materials = Var::stack(&[&shading.albedo, &shading.alpha, &shading.kappa]);
        let target: Detached = g.input("target", &place, OUTPUTS);
        let loss = (&materials - &target).square().sum();
        let program = g.compile(&[("materials", &materials), ("loss", &loss)])?;
        Ok(Self { program })
    }

    /// The materials at all `positions`.
    ///
    /// # Errors
    /// When memory does not suffice for a block of places.
    pub fn evaluate(
        &self,
        network: &MaterialNetwork,
        positions: &[Vec3],
    ) -> Result<Vec<Material>, RunError> {
        let mut all = Vec::with_capacity(positions.len());
        for block in positions.chunks(BLOCK) {
            let count = block.len();
            let mut ws = self.workspace(network, block)?;
            ws.set("target", &vec![0.0; OUTPUTS * count])?;
            self.program.forward(&mut ws)?;
            let found = ws.output("materials")?;
            all.extend((0..count).map(|p| Material {
                albedo: [found[p], found[count + p], found[2 * count + p]],
                alpha: found[3 * count + p],
                kappa: found[4 * count + p],
            }));
        }
        Ok(all)
    }

    /// Fits `network` to the materials at `places` by least squares, with Adam on random places.
    ///
    /// # Errors
    /// As [`MaterialEvaluator::evaluate`].
    pub fn fit(
        &self,
        network: &mut MaterialNetwork,
        places: &[(Vec3, Material)],
        seed: u64,
    ) -> Result<(), RunError> {
        if places.is_empty() {
            return Ok(());
        }
        let mut weights = flatten(network);
        let mut adam = Adam::new(weights.len());
        for step in 1..=STEPS {
            let mut stream = SampleKey {
                seed,
                sample: step as u32,
                ..SampleKey::default()
            }
            .stream();
            let chosen: Vec<&(Vec3, Material)> = (0..PLACES.min(places.len()))
                .map(|_| &places[(stream.uniform() * places.len() as f32) as usize % places.len()])
                .collect();
            let positions: Vec<Vec3> = chosen.iter().map(|(position, _)| *position).collect();
            let value = |c: usize, m: &Material| match c {
                3 => m.alpha,
                4 => m.kappa,
                _ => m.albedo[c],
            };
            let target: Vec<f32> = (0..OUTPUTS)
                .flat_map(|c| chosen.iter().map(move |(_, m)| value(c, m)))
                .collect();
            let mut ws = self.workspace(network, &positions)?;
            bind_values(&mut ws, "target", &target)?;
            self.program.vjp(&mut ws, "loss")?;
            let mut gradient = Vec::with_capacity(weights.len());
            for (weight, bias) in network.names() {
                gradient.extend_from_slice(ws.gradient(&weight)?);
                gradient.extend_from_slice(ws.gradient(&bias)?);
            }
            let rate = RATE * super::rates::share(step as f64 / STEPS as f64, false);
            adam.step(&mut weights, &gradient, rate, step);
            unflatten(&weights, network);
        }
        Ok(())
    }

    fn workspace(
        &self,
        network: &MaterialNetwork,
        positions: &[Vec3],
    ) -> Result<autodiff::Workspace<f32>, RunError> {
        let sizes = Sizes::new().lanes("place", positions.len());
        let mut ws = self.program.workspace::<f32>(&sizes)?;
        network.bind(&mut ws)?;
        ws.set("place encoding", &network.encode(positions))?;
        Ok(ws)
    }
}
