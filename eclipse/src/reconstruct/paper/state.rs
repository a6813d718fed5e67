//! Everything an iteration changes, as plain arrays: a checkpoint of it continues bit for bit.

use std::collections::BTreeMap;

use render::{estimator::Unknowns, materials::MaterialNetwork};

use super::{plan::Plan, rates::Shares};
use crate::{
    checkpoint::{Array, Checkpoint, CheckpointError},
    reconstruct::adam::Adam,
    reconstruction::CurvePoint,
};

/// Learning rate of the environment and the network (Sec. 4.5).
const RATE: f32 = 3e-3;
/// Learning rate of the occluders' coefficients at the paper's batch.
const OCCLUDER_RATE: f32 = 1.0;
/// How much of the reported loss an iteration replaces: one alone is too noisy to be read.
const SMOOTHING: f64 = 0.05;

/// Unknowns, moments and counters.
#[derive(Clone, Debug)]
pub struct State {
    /// What is solved for.
    pub unknowns: Unknowns,
    /// Moments of environment, occluders and network.
    pub moments: [Adam; 3],
    /// Size of an iteration, kept when a run goes on with other limits.
    pub plan: Plan,
    /// Iterations done.
    pub iteration: u64,
    /// Roughness that material samples follow, of each cell of the surface.
    pub roughness: Vec<f32>,
    /// The loss per value, smoothed over iterations.
    pub loss: f64,
    /// Points of the loss curve.
    pub curve: Vec<CurvePoint>,
}

/// Names of the arrays of each group in a checkpoint.
const GROUPS: [&str; 3] = ["environment", "occluders", "network"];

impl State {
    /// Before the first iteration, for a surface of `cells`.
    pub fn new(unknowns: Unknowns, plan: Plan, cells: usize) -> Self {
        let network = flatten(&unknowns.network);
        let lengths = [
            unknowns.environment.len(),
            unknowns.occluders.len(),
            network.len(),
        ];
        Self {
            unknowns,
            moments: lengths.map(Adam::new),
            plan,
            iteration: 0,
            roughness: vec![0.5; cells],
            loss: f64::NAN,
            curve: Vec::new(),
        }
    }

    /// Takes a step of Adam along `gradients`, at these shares of the learning rates, and notes the batch's loss.
    pub fn step(&mut self, gradients: &Unknowns, shares: Shares, loss: f64) {
        self.iteration += 1;
        let step = self.iteration;
        let [environment, occluders, network] = &mut self.moments;
        let unknowns = &mut self.unknowns;
        environment.step(
            &mut unknowns.environment,
            &gradients.environment,
            RATE * shares.own,
            step,
        );
        occluders.step(
            &mut unknowns.occluders,
            &gradients.occluders,
            OCCLUDER_RATE * shares.occluders,
            step,
        );
        let mut weights = flatten(&unknowns.network);
        network.step(
            &mut weights,
            &flatten(&gradients.network),
            RATE * shares.own,
            step,
        );
        unflatten(&weights, &mut unknowns.network);
        self.loss = if self.loss.is_nan() {
            loss
        } else {
            // The first iterations are averaged evenly: their loss falls too fast for a long memory.
            self.loss + SMOOTHING.max(1.0 / step as f64) * (loss - self.loss)
        };
    }

    /// The arrays of a checkpoint.
    pub fn arrays(&self) -> BTreeMap<String, Array> {
        let network = flatten(&self.unknowns.network);
        let values = [
            &self.unknowns.environment,
            &self.unknowns.occluders,
            &network,
        ];
        let mut arrays = BTreeMap::new();
        for ((group, values), moments) in GROUPS.iter().zip(values).zip(&self.moments) {
            arrays.insert((*group).to_owned(), Array::F32(values.clone()));
            arrays.insert(format!("{group} first"), Array::F32(moments.first.clone()));
            arrays.insert(
                format!("{group} second"),
                Array::F32(moments.second.clone()),
            );
        }
        arrays.insert("curve".to_owned(), Array::curve(&self.curve));
        arrays.insert("loss".to_owned(), Array::F64(vec![self.loss]));
        arrays.insert("roughness".to_owned(), Array::F32(self.roughness.clone()));
        let Plan {
            pixels,
            rays,
            cells,
            side,
        } = self.plan;
        let counters = vec![pixels, rays, cells, side, self.curve.len() as u64];
        arrays.insert("counters".to_owned(), Array::U64(counters));
        arrays
    }

    /// Takes the place of `self`, whose arrays have the lengths expected.
    ///
    /// # Errors
    /// When the checkpoint lacks an array or has one of another length.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
        let mut network = flatten(&self.unknowns.network);
        let unknowns = &mut self.unknowns;
        let values = [
            &mut unknowns.environment,
            &mut unknowns.occluders,
            &mut network,
        ];
        for ((group, values), moments) in GROUPS.iter().zip(values).zip(&mut self.moments) {
            let read = |name: &str, into: &mut Vec<f32>| {
                let found = checkpoint.f32s(name, into.len())?;
                into.copy_from_slice(found);
                Ok::<(), CheckpointError>(())
            };
            read(group, values)?;
            read(&format!("{group} first"), &mut moments.first)?;
            read(&format!("{group} second"), &mut moments.second)?;
        }
        unflatten(&network, &mut unknowns.network);
        self.plan = plan(checkpoint)?;
        let cells = self.roughness.len();
        self.roughness = checkpoint.f32s("roughness", cells)?.to_vec();
        let points = checkpoint.u64s("counters", COUNTERS)?[COUNTERS - 1];
        self.curve = checkpoint.curve(points as usize)?;
        self.loss = checkpoint.f64s("loss", 1)?[0];
        self.iteration = checkpoint.iteration;
        Ok(())
    }
}

/// Numbers of a plan, and the length of the curve.
const COUNTERS: usize = 5;

/// The plan of the run that wrote a checkpoint.
///
/// # Errors
/// When the checkpoint is of another preset.
pub fn plan(checkpoint: &Checkpoint) -> Result<Plan, CheckpointError> {
    let counters = checkpoint.u64s("counters", COUNTERS)?;
    Ok(Plan {
        pixels: counters[0],
        rays: counters[1],
        cells: counters[2],
        side: counters[3],
    })
}

/// All weights and biases in the order of the layers.
pub fn flatten(network: &MaterialNetwork) -> Vec<f32> {
    let layers = network.weights.iter().zip(&network.biases);
    layers
        .flat_map(|(weights, biases)| weights.iter().chain(biases))
        .copied()
        .collect()
}

/// The inverse of [`flatten`].
pub fn unflatten(values: &[f32], network: &mut MaterialNetwork) {
    let layers = network.weights.iter_mut().zip(&mut network.biases);
    let all = layers.flat_map(|(weights, biases)| weights.iter_mut().chain(biases));
    all.zip(values).for_each(|(weight, value)| *weight = *value);
}
