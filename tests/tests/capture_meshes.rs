//! Mesh files: every format gives the same mesh, what is written is read back, and nothing makes a parser panic.

use std::path::Path;

use eclipse::mesh_io::{
    GlbSurface, GlbTextures, MeshParseError, encode_glb, parse_glb, parse_gltf, parse_obj,
    parse_ply, read_mesh,
};
use eclipse_tests::{
    small_capture::boxes,
    tetrahedron::{CORNERS, FACES, OBJ, embedded, tetrahedron, triangles},
};
use glam::{Mat4, Vec2, Vec3};
use proptest::prelude::*;
use render::image::Image;
use serde_json::{Value, json};

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
fn wrong_headers_are_described() {
    let message = |bytes: &[u8]| parse_ply(bytes).unwrap_err().to_string();
    assert!(message(b"plx\n").contains("does not begin with \"ply\""));
    assert!(message(b"ply\nformat ascii 1.0\n").contains("no end_header"));
    assert!(message(b"ply\nend_header\n").contains("names no format"));
    let line = "comment of a program\n";
    let with_comments = |count| {
        let text = String::from_utf8(ply("ascii")).unwrap();
        text.replacen("ply\n", &format!("ply\n{}", line.repeat(count)), 1)
    };
    parse_ply(with_comments(3000).as_bytes()).unwrap();
    let endless = [b"ply\ncomment ".to_vec(), vec![b'x'; 1 << 17]].concat();
    for long in [with_comments(3200).into_bytes(), endless] {
        assert!(message(&long).contains("no end_header in its first 65536 bytes"));
    }
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
