//! A tetrahedron as mesh files hold it.

use base64::{Engine, prelude::BASE64_STANDARD};
use glam::Vec3;
use render::mesh::Mesh;
use serde_json::{Value, json};

/// A tetrahedron with a corner at the origin, its faces seen from outside.
pub const OBJ: &str = "# a comment\nmtllib none.mtl\no tetrahedron\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 2 \\\n 0\nv 0 0 3\n\
    f 1 3 2\nf 1// 2// 4//\nf -4 -1 -2\ns off\nf 2 3 4\n";
/// Its faces, of [`CORNERS`].
pub const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
/// Its corners.
pub const CORNERS: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 2.0, 0.0],
    [0.0, 0.0, 3.0],
];

/// The corners of every face.
pub fn triangles(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    (0..mesh.faces.len())
        .map(|face| mesh.triangle(face))
        .collect()
}

/// [`triangles`] of the tetrahedron.
pub fn tetrahedron() -> Vec<[Vec3; 3]> {
    FACES
        .iter()
        .map(|face| face.map(|index| CORNERS[index as usize].into()))
        .collect()
}

/// The JSON of a glTF file of the tetrahedron in glTF's axes, its buffer apart.
pub fn gltf(buffer: &str, node: Value) -> (Value, Vec<u8>) {
    let mut data: Vec<u8> = Vec::new();
    for [x, y, z] in CORNERS {
        data.extend([x, z, -y].iter().flat_map(|v| v.to_le_bytes()));
    }
    data.extend(
        FACES
            .iter()
            .flatten()
            .flat_map(|&index| (index as u16).to_le_bytes()),
    );
    let json = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "buffers": [{ "byteLength": 72, "uri": buffer }],
        "bufferViews": [{ "buffer": 0, "byteLength": 48 }, { "buffer": 0, "byteOffset": 48, "byteLength": 24 }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, -2], "max": [1, 3, 0] },
            { "bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR" },
        ],
    });
    (json, data)
}

/// The same with its buffer within.
pub fn embedded(node: Value) -> Value {
    let (mut json, data) = gltf("", node);
    let encoded = BASE64_STANDARD.encode(data);
    json["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{encoded}"));
    json
}
