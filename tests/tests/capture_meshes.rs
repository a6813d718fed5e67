//! Mesh files: every format gives the same mesh, what is written is read back, and nothing makes a parser panic.

use std::{fs, path::Path};

use base64::{Engine, prelude::BASE64_STANDARD};
use eclipse::mesh_io::{
    GlbSurface, GlbTextures, Load, MAX_FACES, MAX_FILE, MeshParseError, MeshSurface, encode_glb,
    parse_glb, parse_gltf, parse_obj, parse_ply, parse_surfaced_glb, read_mesh,
};
use eclipse_tests::small_capture::boxes;
use glam::{Mat4, Vec2, Vec3};
use proptest::prelude::*;
use render::{image::Image, mesh::Mesh};
use serde_json::{Value, json};

/// A tetrahedron with a corner at the origin, its faces seen from outside.
const OBJ: &str = "# a comment\nmtllib none.mtl\no tetrahedron\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 2 \\\n 0\nv 0 0 3\n\
    f 1 3 2\nf 1// 2// 4//\nf -4 -1 -2\ns off\nf 2 3 4\n";
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
const CORNERS: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 2.0, 0.0],
    [0.0, 0.0, 3.0],
];

fn triangles(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    (0..mesh.faces.len())
        .map(|face| mesh.triangle(face))
        .collect()
}

fn tetrahedron() -> Vec<[Vec3; 3]> {
    FACES
        .iter()
        .map(|face| face.map(|index| CORNERS[index as usize].into()))
        .collect()
}

/// A PLY file of the tetrahedron, one quad aside, with properties and an element that are to be passed over.
fn ply(format: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n\
         property uchar red\nelement camera 1\nproperty list uchar short sizes\nproperty int id\nelement face 4\n\
         property list uchar int vertex_indices\nproperty uchar flag\nend_header\n"
    )
    .into_bytes();
    if format == "ascii" {
        for [x, y, z] in CORNERS {
            bytes.extend(format!("{x} {y} {z} 255\n").bytes());
        }
        bytes.extend(b"2 640 480 7\n");
        for [a, b, c] in FACES {
            bytes.extend(format!("3 {a} {b} {c} 1\n").bytes());
        }
        return bytes;
    }
    let mut put = |value: Vec<u8>| {
        let big = format == "binary_big_endian";
        bytes.extend(if big {
            value.into_iter().rev().collect()
        } else {
            value
        });
    };
    for [x, y, z] in CORNERS {
        put(f64::from(x).to_le_bytes().into());
        put(y.to_le_bytes().into());
        put(z.to_le_bytes().into());
        put(vec![255]);
    }
    put(vec![2]);
    put(640_i16.to_le_bytes().into());
    put(480_i16.to_le_bytes().into());
    put(7_i32.to_le_bytes().into());
    for face in FACES {
        put(vec![3]);
        face.iter()
            .for_each(|index| put(index.to_le_bytes().into()));
        put(vec![1]);
    }
    bytes
}

/// The JSON of a glTF file of the tetrahedron in glTF's axes, its buffer apart.
fn gltf(buffer: &str, node: Value) -> (Value, Vec<u8>) {
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

fn embedded(node: Value) -> Value {
    let (mut json, data) = gltf("", node);
    let encoded = BASE64_STANDARD.encode(data);
    json["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{encoded}"));
    json
}

#[test]
fn all_formats_hold_the_same_triangles() {
    assert_eq!(
        triangles(&parse_obj(OBJ.as_bytes()).unwrap()),
        tetrahedron()
    );
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        assert_eq!(
            triangles(&parse_ply(&ply(format)).unwrap()),
            tetrahedron(),
            "{format}"
        );
    }
    let json = embedded(json!({ "mesh": 0 })).to_string();
    assert_eq!(
        triangles(&parse_glb(json.as_bytes()).unwrap()),
        tetrahedron()
    );
}

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
fn normals_are_transformed_by_the_inverse_transpose() {
    let bytes = encode_glb(&boxes(), &GlbSurface::default()).unwrap();
    // The writer's JSON is compact, so a node can be given a matrix by replacing the padding-free text.
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let mut json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let matrix = Mat4::from_cols_array(&[
        1.0, 0.0, 0.0, 0.0, 0.7, 3.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 1.0, 2.0, 3.0, 1.0,
    ]);
    json["nodes"][0]["matrix"] = json!(matrix.to_cols_array());
    json["buffers"][0]["uri"] = json!("blob");
    let blob = bytes[28 + length..].to_vec();
    let mesh = parse_gltf(json.to_string().as_bytes(), &mut |_, _| Ok(blob.clone())).unwrap();
    for (face, corners) in mesh.faces.iter().enumerate() {
        for &index in corners {
            let normal = mesh.normals[index as usize];
            assert!(
                normal.dot(mesh.face_normal(face)) > 0.9999,
                "boxes stay flat: {normal}"
            );
        }
    }
}

#[test]
fn written_meshes_come_back_with_their_surface() {
    let mut mesh = boxes();
    let count = mesh.positions.len();
    mesh.uvs = (0..count)
        .map(|i| Vec2::new(i as f32 / count as f32, 0.25))
        .collect();
    let colors: Vec<[f32; 3]> = (0..count)
        .map(|i| [i as f32 / count as f32, 0.5, 0.25])
        .collect();
    let (roughness, specular) = (vec![0.5; count], vec![0.08; count]);
    let picture = |channels| Image::filled(4, 2, channels, 0.5);
    let [base_color, grey, kappa] = [picture(3), picture(1), picture(1)];
    let textures = GlbTextures {
        base_color: &base_color,
        roughness: &grey,
        specular: &kappa,
    };
    for textures in [None, Some(textures)] {
        let surface = GlbSurface {
            vertex_colors: Some(&colors),
            vertex_roughness: Some(&roughness),
            vertex_specular: Some(&specular),
            vertex_albedo_deviation: Some(&colors),
            textures,
        };
        let bytes = encode_glb(&mesh, &surface).unwrap();
        let read = parse_glb(&bytes).unwrap();
        assert_eq!(read.positions, mesh.positions);
        assert_eq!(read.faces, mesh.faces);
        assert_eq!(read.uvs, mesh.uvs);
        assert!(
            read.normals
                .iter()
                .zip(&mesh.normals)
                .all(|(a, b)| (*a - *b).length() < 1e-6)
        );
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let attributes = json["meshes"][0]["primitives"][0]["attributes"]
            .as_object()
            .unwrap();
        assert!(attributes.contains_key("COLOR_0"));
        // Of one type: Blender's reader mixes others up.
        for name in [
            "_ROUGHNESS",
            "_SPECULAR",
            "_ALBEDO_SD_R",
            "_ALBEDO_SD_G",
            "_ALBEDO_SD_B",
        ] {
            let accessor = attributes[name].as_u64().unwrap() as usize;
            assert_eq!(json["accessors"][accessor]["type"], "SCALAR", "{name}");
        }
        let own = attributes.keys().filter(|name| name.starts_with('_'));
        assert_eq!(own.count(), 5);
        let material = &json["materials"][0];
        let specular = material["extensions"]["KHR_materials_specular"]["specularColorFactor"][0]
            .as_f64()
            .unwrap();
        // κ = .04 × factor: twice .04 for vertices, .5 in the texture.
        let expected = if textures.is_some() { 0.5 / 0.04 } else { 2.0 };
        assert!((specular - expected).abs() < 1e-5);
        assert_eq!(
            json["images"].as_array().map_or(0, Vec::len),
            if textures.is_some() { 3 } else { 0 }
        );
    }
}

#[test]
fn surfaces_that_do_not_fit_are_refused() {
    let mesh = boxes();
    let error = encode_glb(
        &mesh,
        &GlbSurface {
            vertex_roughness: Some(&[0.5]),
            ..GlbSurface::default()
        },
    )
    .unwrap_err();
    assert!(
        error.contains("1 roughness values for 72 vertices"),
        "{error}"
    );
    let image = Image::filled(1, 1, 3, 0.5);
    let textures = Some(GlbTextures {
        base_color: &image,
        roughness: &image,
        specular: &image,
    });
    let error = encode_glb(
        &mesh,
        &GlbSurface {
            textures,
            ..GlbSurface::default()
        },
    )
    .unwrap_err();
    assert!(
        error.contains("need a mesh with texture coordinates"),
        "{error}"
    );
}

#[test]
fn polygons_texture_coordinates_and_missing_normals() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 0.25\nf 1/1 2/2 3/3 4/4\n";
    let mesh = parse_obj(text.as_bytes()).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.uvs[3], Vec2::new(0.0, 0.75), "v grows downwards");
    assert!(mesh.normals.iter().all(|normal| *normal == Vec3::Z));
    // A seam splits vertices, but not their normals.
    let seam = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 3/2 4/2\n";
    let mesh = parse_obj(seam.as_bytes()).unwrap();
    assert_eq!(mesh.positions.len(), 6);
    assert_eq!(mesh.normals[0], mesh.normals[3]);
    let given = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 2\nvn 0 3 4\nvn 0 0 0\nf 1//1 2//2 3//3\n";
    let mesh = parse_obj(given.as_bytes()).unwrap();
    assert_eq!(
        mesh.normals,
        [Vec3::Z, Vec3::new(0.0, 0.6, 0.8), Vec3::Z],
        "unit, and computed where it is zero"
    );
}

#[test]
fn comments_of_an_obj_end_with_their_line() {
    let text =
        "# from C:\\models\\\nv 0 0 0\nv 1 0 \\\n0 # x \\\nv 0 1 0\nf 1 2 3 # all \\\nf 1 3 2\n";
    let mesh = parse_obj(text.as_bytes()).unwrap();
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 1]]);
}

#[test]
fn counts_beyond_the_file_are_refused_at_once() {
    let huge = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000000\nproperty float x\nproperty float y\n\
        property float z\nend_header\n0000";
    assert!(matches!(
        parse_ply(huge.as_bytes()),
        Err(MeshParseError::Syntax(_))
    ));
    let empty = "ply\nformat ascii 1.0\nelement face 18446744073709551615\nend_header\n";
    assert!(parse_ply(empty.as_bytes()).is_err());
    let mut json = embedded(json!({ "mesh": 0 }));
    json["accessors"][0]["count"] = json!(4_000_000_000_000_u64);
    let message = parse_glb(json.to_string().as_bytes())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("accessor 0 reaches beyond its buffer"),
        "{message}"
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

#[test]
fn wrong_headers_are_described() {
    let message = |bytes: &[u8]| parse_ply(bytes).unwrap_err().to_string();
    assert!(message(b"plx\n").contains("does not begin with \"ply\""));
    assert!(message(b"ply\nformat ascii 1.0\n").contains("no end_header"));
    assert!(message(b"ply\nend_header\n").contains("names no format"));
    assert!(
        message(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
            .contains("lack a property x, y or z")
    );
    assert!(message(&ply("ascii")[..330]).contains("is damaged or truncated"));
    assert!(
        parse_obj(b"v 1 2\n")
            .unwrap_err()
            .to_string()
            .contains("line 1: 3 numbers are expected")
    );
    assert!(
        parse_obj(b"v 1 2 x\n")
            .unwrap_err()
            .to_string()
            .contains("\"x\" is not a number")
    );
    assert!(
        read_mesh(Path::new("nowhere.obj"))
            .unwrap_err()
            .to_string()
            .contains("cannot read the mesh nowhere.obj")
    );
}

proptest! {
    #[test]
    fn altered_files_never_panic(at in any::<prop::sample::Index>(), byte: u8, cut in any::<prop::sample::Index>()) {
        let glb = encode_glb(&boxes(), &GlbSurface::default()).unwrap();
        let gltf = embedded(json!({ "mesh": 0 })).to_string().into_bytes();
        for original in [OBJ.as_bytes().to_vec(), ply("ascii"), ply("binary_little_endian"), glb, gltf] {
            let mut altered = original.clone();
            altered[at.index(original.len())] = byte;
            for bytes in [&original[..cut.index(original.len())], &altered] {
                let _ = parse_obj(bytes);
                let _ = parse_ply(bytes);
                let _ = parse_glb(bytes);
            }
        }
    }

    #[test]
    fn indices_in_range_always_parse(faces in prop::collection::vec([0_u32..5, 0_u32..5, 0_u32..5], 1..20)) {
        let mut text = String::new();
        for i in 0..5 {
            text += &format!("v {i} {} {}\n", i * i, i % 2);
        }
        for [a, b, c] in &faces {
            text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        }
        let proper = faces.iter().filter(|[a, b, c]| a != b && b != c && c != a).count();
        match parse_obj(text.as_bytes()) {
            Ok(mesh) => {
                prop_assert_eq!(mesh.faces.len(), proper);
                prop_assert!(mesh.normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-4));
            }
            Err(MeshParseError::NoFaces { .. }) => prop_assert_eq!(proper, 0),
            Err(error) => prop_assert!(false, "{}", error),
        }
    }
}
