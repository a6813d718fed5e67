//! What mesh files say of the surface's looks. A capture takes the shape alone and finds the rest by itself; that there was more is worth
//! a word to whoever expects to see it.

use std::collections::BTreeMap;

use serde::{Deserialize, de::IgnoredAny};

use super::{gltf_in::split_glb, ply_header::parse_header};

const TEXTURES: &str = "textures";
const COLOURS: &str = "vertex colours";
const MATERIALS: &str = "materials";

/// The looks that a file with this extension has: `textures`, `vertex colours`, `materials`. One that is not understood has none.
pub fn parse_looks(bytes: &[u8], extension: &str) -> Vec<&'static str> {
    match extension {
        "glb" | "gltf" => of_gltf(bytes).unwrap_or_default(),
        "obj" => of_obj(bytes),
        "ply" => of_ply(bytes),
        _ => Vec::new(),
    }
}

/// The parts of a glTF file that tell of looks.
#[derive(Deserialize)]
struct Gltf {
    #[serde(default)]
    textures: Vec<IgnoredAny>,
    #[serde(default)]
    materials: Vec<IgnoredAny>,
    #[serde(default)]
    meshes: Vec<GltfMesh>,
}

#[derive(Deserialize)]
struct GltfMesh {
    primitives: Vec<GltfPrimitive>,
}

#[derive(Deserialize)]
struct GltfPrimitive {
    attributes: BTreeMap<String, IgnoredAny>,
}

fn of_gltf(bytes: &[u8]) -> Option<Vec<&'static str>> {
    let (json, _) = split_glb(bytes).ok()?;
    let file: Gltf = serde_json::from_slice(json).ok()?;
    let mut primitives = file.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let coloured = primitives.any(|primitive| {
        let mut names = primitive.attributes.keys();
        names.any(|name| name.starts_with("COLOR_"))
    });
    Some(chosen([
        (TEXTURES, !file.textures.is_empty()),
        (COLOURS, coloured),
        (MATERIALS, !file.materials.is_empty()),
    ]))
}

fn of_obj(bytes: &[u8]) -> Vec<&'static str> {
    let text = String::from_utf8_lossy(bytes);
    let (mut coloured, mut materials) = (false, false);
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        match words.next() {
            // Behind x, y and z, where a weight may stand alone.
            Some("v") => coloured |= words.count() >= 6,
            Some("usemtl") => materials = true,
            _ => {}
        }
    }
    chosen([(COLOURS, coloured), (MATERIALS, materials)])
}

fn of_ply(bytes: &[u8]) -> Vec<&'static str> {
    let Ok(header) = parse_header(bytes) else {
        return Vec::new();
    };
    let of_vertices = header.elements.iter().filter(|e| e.name == "vertex");
    let mut properties = of_vertices.flat_map(|element| &element.properties);
    let red = ["red", "diffuse_red", "r"];
    let coloured = properties.any(|property| red.contains(&&*property.name));
    chosen([(COLOURS, coloured)])
}

fn chosen<const N: usize>(found: [(&'static str, bool); N]) -> Vec<&'static str> {
    let there = found.into_iter().filter(|(_, there)| *there);
    there.map(|(name, _)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_are_found_in_every_format() {
        let gltf = r#"{"asset":{"version":"2.0"},"textures":[{}],"materials":[{"name":"paint"}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0,"COLOR_0":1}}]}]}"#;
        let all = [TEXTURES, COLOURS, MATERIALS];
        assert_eq!(parse_looks(gltf.as_bytes(), "gltf"), all);
        let obj = b"mtllib a.mtl\nv 0 0 0 1 0.5 0 # corner\nusemtl a\nf 1 1 1\n";
        assert_eq!(parse_looks(obj, "obj"), [COLOURS, MATERIALS]);
        let ply = b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty uchar red\nend_header\n";
        assert_eq!(parse_looks(ply, "ply"), [COLOURS]);
    }

    #[test]
    fn a_shape_alone_has_none_and_what_is_damaged_neither() {
        let gltf = r#"{"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]}"#;
        let shape = b"v 0 0 0\nv 1 0 0 1\nv 0 1 0\nvt 0 0\nf 1 2 3\n";
        for (bytes, extension) in [
            (gltf.as_bytes(), "gltf"),
            (b"glTF", "glb"),
            (b"{", "gltf"),
            (shape, "obj"),
            (b"ply", "ply"),
            (shape, "stl"),
        ] {
            assert_eq!(parse_looks(bytes, extension), [""; 0], "{extension}");
        }
    }
}
