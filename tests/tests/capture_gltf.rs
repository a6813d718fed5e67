//! What glTF files may hold besides positions and faces, and what of it is refused.

use std::fs;

use base64::{Engine, prelude::BASE64_STANDARD};
use eclipse::mesh_io::{
    GlbSurface, Load, MAX_FACES, MAX_FILE, MeshSurface, encode_glb, parse_glb, parse_gltf,
    parse_surfaced_glb, read_mesh,
};
use eclipse_tests::{
    small_capture::boxes,
    tetrahedron::{FACES, embedded, gltf, tetrahedron, triangles},
};
use glam::Vec3;
use serde_json::{Value, json};

#[test]
fn gltf_buffers_lie_beside_the_mesh_and_nowhere_else() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("in")).unwrap();
    let path = folder.path().join("in/mesh.gltf");
    let (json, data) = gltf("the%20data.bin", json!({ "mesh": 0 }));
    fs::write(folder.path().join("in/the data.bin"), &data).unwrap();
    fs::write(&path, json.to_string()).unwrap();
    assert_eq!(triangles(&read_mesh(&path).unwrap()), tetrahedron());
    let (json, _) = gltf("../data.bin", json!({ "mesh": 0 }));
    fs::write(folder.path().join("data.bin"), &data).unwrap();
    fs::write(&path, json.to_string()).unwrap();
    let message = read_mesh(&path).unwrap_err().to_string();
    assert!(
        message.contains("lies outside the mesh's folder"),
        "{message}"
    );
    let message = parse_glb(json.to_string().as_bytes())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("a self-contained one is expected"),
        "{message}"
    );
}

#[test]
fn node_transforms_compose_and_mirrors_keep_faces_outward() {
    let mut json = embedded(json!({ "children": [1, 2], "scale": [2.0, 2.0, 2.0] }));
    json["nodes"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "mesh": 0, "translation": [0.0, 5.0, 0.0] }));
    json["nodes"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "mesh": 0, "scale": [-1.0, 1.0, 1.0] }));
    let mesh = parse_glb(json.to_string().as_bytes()).unwrap();
    let [lifted, mirrored] = [&triangles(&mesh)[..4], &triangles(&mesh)[4..]].map(<[_]>::to_vec);
    // Up is y there and z here.
    let expected: Vec<[Vec3; 3]> = tetrahedron()
        .iter()
        .map(|t| t.map(|p| 2.0 * (p + Vec3::new(0.0, 0.0, 5.0))))
        .collect();
    assert_eq!(lifted, expected);
    let inside = Vec3::new(-0.4, 0.4, 0.4);
    for [a, b, c] in mirrored {
        assert!(
            (b - a).cross(c - a).dot(a - inside) > 0.0,
            "the face looks inwards"
        );
    }
    assert!(
        mesh.positions
            .iter()
            .zip(&mesh.normals)
            .skip(5)
            .all(|(p, n)| n.dot(*p - inside) > 0.0)
    );
}

#[test]
fn a_small_gltf_cannot_ask_for_any_amount_of_memory() {
    let message = |json: &Value, load: &mut Load<'_>| {
        let error = parse_gltf(json.to_string().as_bytes(), load).unwrap_err();
        error.to_string()
    };

    // One file, named again and again: what is left for it shrinks until there is no more.
    let (mut json, data) = gltf("data.bin", json!({ "mesh": 0 }));
    let buffer = json["buffers"][0].clone();
    json["buffers"] = json!([buffer, buffer, buffer]);
    let mut asked = Vec::new();
    let mut load = |uri: &str, most: u64| {
        asked.push((uri.to_owned(), most));
        Ok(data.clone())
    };
    parse_gltf(json.to_string().as_bytes(), &mut load).unwrap();
    let most = |read: u64| ("data.bin".to_owned(), MAX_FILE - read);
    assert_eq!(asked, [most(0), most(72), most(144)]);
    let longer = json!({ "byteLength": MAX_FILE + 1, "uri": "data.bin" });
    json["buffers"] = json!([longer]);
    let found = message(&json, &mut |_, _| panic!("it must not be read"));
    let expected = "has more than 2147483648 bytes of buffers, the most that is read";
    assert!(found.contains(expected), "{found}");

    // A binary chunk is one buffer's, however many say that it is theirs.
    let mut bytes = encode_glb(&boxes(), &GlbSurface::default()).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let mut json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let first = json["buffers"][0].clone();
    json["buffers"] = json!([first, first]);
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    bytes.splice(20..20 + length, text.iter().copied());
    bytes[12..16].copy_from_slice(&(text.len() as u32).to_le_bytes());
    let total = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&total.to_le_bytes());
    let found = parse_glb(&bytes).unwrap_err().to_string();
    assert!(found.contains("its buffer 1 has no `uri`"), "{found}");
}

#[test]
fn short_json_of_many_values_is_refused_before_it_is_parsed() {
    // Three bytes a node, which would be hundreds once it is read.
    let nodes = vec!["{}"; 2_100_000].join(",");
    let json = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{nodes}]}}"#);
    let words = [2, 20 + json.len() as u32, json.len() as u32].map(u32::to_le_bytes);
    let binary = [b"glTF", words.as_flattened(), b"JSON", json.as_bytes()].concat();
    for bytes in [json.as_bytes(), &binary] {
        let message = parse_glb(bytes).unwrap_err().to_string();
        assert!(
            message.contains("has more than 4194304 values in its JSON"),
            "{message}"
        );
    }
}

#[test]
fn of_many_faults_a_few_are_told() {
    let mut json = embedded(json!({ "mesh": 0 }));
    let invalid = |json: &Value| {
        parse_glb(json.to_string().as_bytes())
            .unwrap_err()
            .to_string()
    };
    let nodes = |count: usize| {
        let mut nodes = vec![json!({ "mesh": 0 })];
        nodes.resize(1 + count, json!({ "mesh": 99 }));
        nodes
    };
    json["nodes"] = json!(nodes(20));
    let message = invalid(&json);
    assert_eq!(message.matches("nodes[").count(), 20, "{message}");
    assert!(!message.contains("more"), "{message}");
    json["nodes"] = json!(nodes(25));
    let message = invalid(&json);
    assert_eq!(message.matches("nodes[").count(), 20, "{message}");
    assert!(message.contains("; and 5 more"), "{message}");
}

#[test]
fn more_faces_than_are_read_are_refused_before_they_are_stored() {
    let (mut json, data) = gltf("data.bin", json!({ "mesh": 0 }));
    // A strip of bytes: each index after the second is a face. Memory that nobody writes to is none.
    let strip = MAX_FACES + 3;
    json["buffers"][0]["byteLength"] = json!(48 + strip);
    json["bufferViews"][1]["byteLength"] = json!(strip);
    json["accessors"][1]["componentType"] = json!(5121);
    json["accessors"][1]["count"] = json!(strip);
    json["meshes"][0]["primitives"][0]["mode"] = json!(5);
    let mut buffer = vec![0; 48 + strip];
    buffer[..48].copy_from_slice(&data[..48]);
    let error = parse_gltf(json.to_string().as_bytes(), &mut |_, _| {
        Ok(std::mem::take(&mut buffer))
    })
    .unwrap_err()
    .to_string();
    let expected = "has more than 67108864 faces, the most that is read; export only the object";
    assert!(error.contains(expected), "{error}");
}

#[test]
fn extensions_that_are_not_understood_are_named_and_those_of_looks_are_not_missed() {
    let mut json = embedded(json!({ "mesh": 0 }));
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression"] {
        json["extensionsRequired"] = json!(["KHR_materials_sheen", name]);
        let message = parse_glb(json.to_string().as_bytes())
            .unwrap_err()
            .to_string();
        let expected =
            format!("uses the extension {name}, which is not supported; export it without");
        assert_eq!(message, expected);
    }
    json["extensionsRequired"] = json!(["KHR_materials_sheen", "KHR_texture_transform"]);
    parse_glb(json.to_string().as_bytes()).unwrap();
}

#[test]
fn meshes_that_something_else_puts_into_place_are_refused_with_what_to_do() {
    let message = |json: &Value| {
        let error = parse_glb(json.to_string().as_bytes()).unwrap_err();
        error.to_string()
    };
    let mut json = embedded(json!({ "mesh": 0, "skin": 0 }));
    json["skins"] = json!([{ "joints": [0] }]);
    assert_eq!(
        message(&json),
        "is moved by bones (its node 0 has a skin), which is not supported: apply the pose (in Blender: Object, Convert, \
         Mesh), and export it again"
    );
    let mut json = embedded(json!({ "mesh": 0 }));
    // Bones that no mesh hangs on are in nobody's way.
    json["skins"] = json!([{ "joints": [0] }]);
    parse_glb(json.to_string().as_bytes()).unwrap();
    for field in ["extensionsUsed", "extensionsRequired"] {
        json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
        json[field] = json!(["EXT_mesh_gpu_instancing"]);
        let message = message(&json);
        assert!(
            message.contains("has instances (EXT_mesh_gpu_instancing)")
                && message.contains("make them real"),
            "{message}"
        );
    }
}

#[test]
fn quantized_meshes_are_read_as_they_are_meant() {
    // Positions as signed bytes, as they are and normalised, four bytes a vertex; the node brings them to their place.
    let corners: [[i8; 3]; 4] = [[0, 0, 0], [127, 0, 0], [0, 0, -127], [0, 127, 0]];
    let bytes = corners.iter().flat_map(|c| [c[0], c[1], c[2], 0]);
    let mut data: Vec<u8> = bytes.map(|value| value as u8).collect();
    data.extend(FACES.iter().flatten().map(|&index| index as u8));
    let encoded = BASE64_STANDARD.encode(&data);
    for (normalized, unit) in [(false, 1.0 / 127.0), (true, 1.0)] {
        let json = json!({
            "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }],
            "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
            "nodes": [{ "mesh": 0, "scale": [unit, 3.0 * unit, 2.0 * unit] }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
            "buffers": [{
                "byteLength": data.len(), "uri": format!("data:application/octet-stream;base64,{encoded}"),
            }],
            "bufferViews": [
                { "buffer": 0, "byteLength": 16, "byteStride": 4 },
                { "buffer": 0, "byteOffset": 16, "byteLength": 12 },
            ],
            "accessors": [
                {
                    "bufferView": 0, "componentType": 5120, "normalized": normalized, "count": 4, "type": "VEC3",
                    "min": [0, 0, -127], "max": [127, 127, 0],
                },
                { "bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR" },
            ],
        });
        let mesh = parse_glb(json.to_string().as_bytes()).unwrap();
        for (found, expected) in triangles(&mesh).iter().zip(tetrahedron()) {
            for (found, expected) in found.iter().zip(expected) {
                assert!((*found - expected).length() < 1e-5, "{found} {expected}");
            }
        }
    }
}

/// The tetrahedron with accessor 0 changed, and these bytes in the views 2 and 3.
fn changed(accessor: Value, views: [&[u8]; 2]) -> Value {
    let (mut json, mut data) = gltf("", json!({ "mesh": 0 }));
    for (name, value) in accessor.as_object().unwrap() {
        json["accessors"][0][name] = value.clone();
    }
    for bytes in views {
        let view = json!({ "buffer": 0, "byteOffset": data.len(), "byteLength": bytes.len() });
        json["bufferViews"].as_array_mut().unwrap().push(view);
        data.extend(bytes);
    }
    json["buffers"][0]["byteLength"] = json!(data.len());
    let encoded = BASE64_STANDARD.encode(data);
    json["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{encoded}"));
    json
}

fn sparse(count: usize) -> Value {
    json!({
        "count": count, "indices": { "bufferView": 2, "componentType": 5123 }, "values": { "bufferView": 3 },
    })
}

/// Of little-endian floats.
fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn sparse_accessors_and_those_without_data_are_read() {
    let read = |json: &Value| parse_glb(json.to_string().as_bytes());
    // Two corners moved, in glTF's axes.
    let values = bytes(&[2.0, 0.0, 0.0, 0.0, 5.0, 0.0]);
    let json = changed(json!({ "sparse": sparse(2) }), [&[1, 0, 3, 0], &values]);
    let mesh = read(&json).unwrap();
    let corners = [Vec3::ZERO, 2.0 * Vec3::X, 2.0 * Vec3::Y, 5.0 * Vec3::Z];
    let expected: Vec<_> = FACES.map(|face| face.map(|i| corners[i as usize])).to_vec();
    assert_eq!(triangles(&mesh), expected);

    // All but the origin, over zeros.
    let values = bytes(&[2.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 5.0, 0.0]);
    let places = [1, 0, 2, 0, 3, 0];
    let mut json = changed(json!({ "sparse": sparse(3) }), [&places, &values]);
    let accessor = json["accessors"][0].as_object_mut().unwrap();
    accessor.remove("bufferView").unwrap();
    assert_eq!(triangles(&read(&json).unwrap()), expected);

    // Zeros alone are no shape, but normals that are computed instead.
    let normals = json!({ "componentType": 5126, "count": 4, "type": "VEC3" });
    json["accessors"].as_array_mut().unwrap().push(normals);
    json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(2);
    assert_eq!(triangles(&read(&json).unwrap()), expected);
    json["accessors"][0]
        .as_object_mut()
        .unwrap()
        .remove("sparse");
    let message = read(&json).unwrap_err().to_string();
    assert!(message.contains("has no extent"), "{message}");
}

#[test]
fn sparse_accessors_are_checked_as_others_are() {
    let refused = |json: &Value| {
        let error = parse_glb(json.to_string().as_bytes()).unwrap_err();
        error.to_string()
    };
    let values = bytes(&[2.0, 0.0, 0.0, 0.0, 5.0, 0.0]);
    for places in [[1, 0, 4, 0], [3, 0, 1, 0], [1, 0, 1, 0]] {
        let json = changed(json!({ "sparse": sparse(2) }), [&places, &values]);
        let message = refused(&json);
        assert!(
            message.contains("accessor 0 replaces elements that it does not have"),
            "{message}"
        );
    }
    for (places, values) in [(&[1, 0][..], &values[..]), (&[1, 0, 3, 0], &values[..20])] {
        let message = refused(&changed(json!({ "sparse": sparse(2) }), [places, values]));
        assert!(
            message.contains("accessor 0 reaches beyond its buffer"),
            "{message}"
        );
    }
    let mut json = changed(json!({ "count": 4_000_000_000_000_u64 }), [&[0], &[0]]);
    let accessor = json["accessors"][0].as_object_mut().unwrap();
    accessor.remove("bufferView").unwrap();
    let message = refused(&json);
    assert!(
        message.contains("has more than 67108864 values without data"),
        "{message}"
    );
    // What else is missing still is.
    json["bufferViews"][0]["buffer"] = json!(7);
    assert!(refused(&json).contains("invalid glTF"));
}

#[test]
fn colours_may_have_an_opacity() {
    let colors = [0.1, 0.2, 0.3, 1.0, 0.4, 0.5, 0.6, 1.0];
    let data = bytes(&[colors, colors].concat());
    let mut json = changed(json!({}), [&data, &[0]]);
    let colors = json!({ "bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC4" });
    json["accessors"].as_array_mut().unwrap().push(colors);
    json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(2);
    let (_, surface) = parse_surfaced_glb(json.to_string().as_bytes()).unwrap();
    let MeshSurface::Vertices(materials) = surface else {
        panic!("expected a material a vertex");
    };
    assert_eq!(materials[1].albedo, [0.4, 0.5, 0.6]);
    assert_eq!(materials[2].albedo, [0.1, 0.2, 0.3]);
}

#[test]
fn cycles_of_nodes_end() {
    let json = embedded(json!({ "mesh": 0, "children": [0] })).to_string();
    assert!(
        parse_glb(json.as_bytes())
            .unwrap_err()
            .to_string()
            .contains("two parents")
    );
}
