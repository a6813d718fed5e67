//! The material network as a file of the safetensors format: a header in JSON, then the tensors.

use render::materials::MaterialNetwork;
use serde_json::{Map, Value, json};

use crate::reconstruction::Network;

/// Weights (`outputs × inputs`) and biases of every layer in single precision, and in the metadata how to use them.
pub fn safetensors(network: &MaterialNetwork) -> Network {
    let mut header = Map::new();
    header.insert(
        "__metadata__".to_owned(),
        json!({
            "format": "eclipse-materials-1",
            "input": "p = (position - centre of the mesh's bounding box) / radius; \
                      at 2 * (3 * j + axis): sin(2^j p[axis]), then its cos, for j = 0..6",
            "radius": network.radius.to_string(),
            "hidden": "relu",
            "output": "sigmoid: albedo r, g, b, a, kappa; alpha = 0.02 + 0.98 a",
        }),
    );
    let mut data: Vec<u8> = Vec::new();
    let mut tensor = |name: String, shape: Value, values: &[f32]| {
        let begin = data.len();
        data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let entry = json!({ "dtype": "F32", "shape": shape, "data_offsets": [begin, data.len()] });
        header.insert(name, entry);
    };
    for (layer, (weights, biases)) in network.weights.iter().zip(&network.biases).enumerate() {
        let shape = json!([biases.len(), weights.len() / biases.len().max(1)]);
        tensor(format!("{layer}.weight"), shape, weights);
        tensor(format!("{layer}.bias"), json!([biases.len()]), biases);
    }
    let mut header = Value::Object(header).to_string().into_bytes();
    // The format wants the tensors aligned to eight bytes; spaces may end the header.
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    bytes.extend(data);
    Network {
        extension: "safetensors".to_owned(),
        bytes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_finds_every_weight() {
        let network = MaterialNetwork::new(7, 1.5);
        let bytes = safetensors(&network).bytes;
        let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
        let data = &bytes[8 + length..];
        assert_eq!(header["__metadata__"]["radius"], "1.5");
        assert_eq!(header["0.weight"]["shape"], json!([128, 42]));
        let tensor = |name: &str| -> Vec<f32> {
            let at = |i: usize| header[name]["data_offsets"][i].as_u64().unwrap() as usize;
            data[at(0)..at(1)]
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
                .collect()
        };
        for layer in 0..network.weights.len() {
            assert_eq!(tensor(&format!("{layer}.weight")), network.weights[layer]);
            assert_eq!(tensor(&format!("{layer}.bias")), network.biases[layer]);
        }
    }
}
