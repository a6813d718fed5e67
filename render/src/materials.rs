//! The material network (Eq. 8): positional encoding, four hidden layers of 128 rectified units, a sigmoid.

use autodiff::{Detached, Domain, Graph, RunError, Scalar, Var, Workspace};
use glam::Vec3;

use crate::bsdf::Material;
use crate::radiance::Shading;
use crate::sampler::SampleKey;

/// Octaves of the encoding: sin and cos of 2ʲ x, j = 0..6.
const OCTAVES: usize = 7;
/// Inputs of the network.
pub const INPUTS: usize = 6 * OCTAVES;
/// Outputs: albedo RGB, α, κ.
pub const OUTPUTS: usize = 5;
/// Widths of all layers, inputs first.
const WIDTHS: [usize; 6] = [INPUTS, 128, 128, 128, 128, OUTPUTS];
/// Outputs start this close to ½. Smaller hidden weights would do the same, and stop their own gradient.
const OUTPUT_SCALE: f32 = 0.01;
/// α of zero would make D infinite.
const MIN_ALPHA: f32 = 0.02;

/// The weights of the network, layer by layer.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialNetwork {
    /// One a layer: a row-major `outputs × inputs` matrix.
    pub weights: Vec<Vec<f32>>,
    /// One a layer.
    pub biases: Vec<Vec<f32>>,
    /// Positions are divided by this radius, so that the object fits the unit ball.
    pub radius: f32,
}

impl MaterialNetwork {
    /// A network whose materials are all close to ½, for an object within `radius` of the origin.
    ///
    /// Hidden weights are uniform with He's variance, the last layer's near zero.
    pub fn new(seed: u64, radius: f32) -> Self {
        let layers = WIDTHS.len() - 1;
        let weights = (0..layers).map(|layer| {
            let mut stream = SampleKey {
                seed,
                dimension: layer as u32,
                ..SampleKey::default()
            }
            .stream();
            let bound = (6.0 / WIDTHS[layer] as f32).sqrt()
                * if layer + 1 == layers {
                    OUTPUT_SCALE
                } else {
                    1.0
                };
            (0..WIDTHS[layer] * WIDTHS[layer + 1])
                .map(|_| bound * (2.0 * stream.uniform() - 1.0))
                .collect()
        });
        let biases = (0..layers).map(|layer| vec![0.0; WIDTHS[layer + 1]]);
        Self {
            weights: weights.collect(),
            biases: biases.collect(),
            radius,
        }
    }

    /// The encoding of many positions, as the tape wants it: `[input][position]`.
    pub fn encode(&self, positions: &[Vec3]) -> Vec<f32> {
        let mut encoded = vec![0.0; INPUTS * positions.len()];
        for (p, position) in positions.iter().enumerate() {
            for (i, value) in self.encoding(*position).into_iter().enumerate() {
                encoded[i * positions.len() + p] = value;
            }
        }
        encoded
    }

    /// The material at a position, in plain numbers.
    pub fn evaluate(&self, position: Vec3) -> Material {
        let mut values = self.encoding(position).to_vec();
        for (layer, (weights, biases)) in self.weights.iter().zip(&self.biases).enumerate() {
            let last = layer + 2 == WIDTHS.len();
            let rows = weights.chunks_exact(WIDTHS[layer]).zip(biases);
            values = rows
                .map(|(row, bias)| {
                    let sum = bias + row.iter().zip(&values).map(|(w, v)| w * v).sum::<f32>();
                    if last {
                        1.0 / (1.0 + (-sum).exp())
                    } else {
                        sum.max(0.0)
                    }
                })
                .collect();
        }
        Material {
            albedo: [values[0], values[1], values[2]],
            alpha: MIN_ALPHA + (1.0 - MIN_ALPHA) * values[3],
            kappa: values[4],
        }
    }

    /// The names of the parameters on the tape: weights and biases of each layer.
    pub fn names(&self) -> Vec<(String, String)> {
        (0..self.weights.len())
            .map(|l| (format!("material weight {l}"), format!("material bias {l}")))
            .collect()
    }

    /// Binds all weights to a workspace of a program that [`Network::record`] was recorded in.
    ///
    /// # Errors
    /// When the program holds no network, or one of other widths.
    pub fn bind<S: Scalar>(&self, ws: &mut Workspace<S>) -> Result<(), RunError> {
        for (layer, (weight, bias)) in self.names().iter().enumerate() {
            crate::radiance::bind_values(ws, weight, &self.weights[layer])?;
            crate::radiance::bind_values(ws, bias, &self.biases[layer])?;
        }
        Ok(())
    }

    fn encoding(&self, position: Vec3) -> [f32; INPUTS] {
        let mut values = [0.0; INPUTS];
        for (axis, x) in (position / self.radius).to_array().into_iter().enumerate() {
            for j in 0..OCTAVES {
                let (sin, cos) = ((1 << j) as f32 * x).sin_cos();
                values[2 * (3 * j + axis)] = sin;
                values[2 * (3 * j + axis) + 1] = cos;
            }
        }
        values
    }
}

/// The network's weights as parameters of a graph: evaluated at as many places as wanted.
pub struct Network {
    layers: Vec<(Var, Var)>,
}

impl Network {
    /// Declares the parameters.
    pub fn record(g: &Graph) -> Self {
        let uniform = g.uniform();
        let layers = (0..WIDTHS.len() - 1).map(|l| {
            let weight = g.param(
                &format!("material weight {l}"),
                &uniform,
                WIDTHS[l] * WIDTHS[l + 1],
            );
            let bias = g.param(&format!("material bias {l}"), &uniform, WIDTHS[l + 1]);
            (weight, bias)
        });
        Self {
            layers: layers.collect(),
        }
    }

    /// Records the materials at encoded positions: the input `{name} encoding` of [`INPUTS`] channels on `domain`.
    pub fn evaluate(&self, g: &Graph, name: &str, domain: &Domain) -> Shading {
        let encoding: Detached = g.input(&format!("{name} encoding"), domain, INPUTS);
        let mut value = encoding.matmul(&self.layers[0].0, Some(&self.layers[0].1));
        for (weight, bias) in &self.layers[1..] {
            value = value.relu().matmul(weight, Some(bias));
        }
        let value = value.sigmoid();
        let channels: Vec<Var> = (0..OUTPUTS).map(|c| value.channel(c)).collect();
        Shading {
            albedo: Var::stack(&[&channels[0], &channels[1], &channels[2]]),
            alpha: channels[3].affine(f64::from(1.0 - MIN_ALPHA), f64::from(MIN_ALPHA)),
            kappa: channels[4].clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_materials_start_near_one_half_and_differ_from_place_to_place() {
        let network = MaterialNetwork::new(3, 2.0);
        let (a, b) = (
            network.evaluate(Vec3::new(0.5, 1.0, -0.3)),
            network.evaluate(Vec3::new(0.5, 1.0, 0.3)),
        );
        for m in [a, b] {
            let values = [m.albedo[0], m.albedo[1], m.albedo[2], m.alpha, m.kappa];
            assert!(values.iter().all(|v| (v - 0.5).abs() < 0.05), "{values:?}");
        }
        assert_ne!(a, b);
    }

    #[test]
    fn the_tape_and_plain_numbers_agree() {
        let network = MaterialNetwork::new(5, 1.5);
        let positions = [
            Vec3::new(0.1, -0.4, 0.9),
            Vec3::new(-1.0, 0.2, 0.3),
            Vec3::ZERO,
        ];
        let g = Graph::new();
        let point = g.domain("point");
        let shading = Network::record(&g).evaluate(&g, "here", &point);
        let all = Var::stack(&[&shading.albedo, &shading.alpha, &shading.kappa]);
        let program = g.compile(&[("materials", &all)]).unwrap();
        let mut ws = program
            .workspace::<f32>(&autodiff::Sizes::new().lanes("point", 3))
            .unwrap();
        network.bind(&mut ws).unwrap();
        ws.set("here encoding", &network.encode(&positions))
            .unwrap();
        program.forward(&mut ws).unwrap();
        let found = ws.output("materials").unwrap();
        for (p, position) in positions.iter().enumerate() {
            let m = network.evaluate(*position);
            for (c, v) in [m.albedo[0], m.albedo[1], m.albedo[2], m.alpha, m.kappa]
                .into_iter()
                .enumerate()
            {
                assert!((found[3 * c + p] - v).abs() < 1e-5);
            }
        }
    }
}
