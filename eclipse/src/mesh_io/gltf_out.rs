//! Writing binary glTF 2.0: the mesh, turned to y up, with the material that was found on it.

use std::path::Path;

use glam::Vec3;
use render::{image::Image, mesh::Mesh};
use serde_json::{Value, json};

use crate::image_io::{encode_png8, linear_to_srgb};

/// Reflectance at normal incidence of a specular factor of 1, by the format.
const UNIT_SPECULAR: f32 = 0.04;

/// What is written on the mesh beside its shape. glTF roughness is the square root of the GGX α; `specular` is κ, the
/// reflectance at normal incidence.
#[derive(Clone, Debug, Default)]
pub struct GlbSurface<'a> {
    /// Linear base colour, one a vertex (`COLOR_0`).
    pub vertex_colors: Option<&'a [[f32; 3]]>,
    /// Roughness, one a vertex (`_ROUGHNESS`); its mean is the material's factor when there are no textures.
    pub vertex_roughness: Option<&'a [f32]>,
    /// κ, one a vertex (`_SPECULAR`); its mean is the material's factor when there are no textures.
    pub vertex_specular: Option<&'a [f32]>,
    /// Standard deviation of the linear base colour, one a vertex (`_ALBEDO_SD_R`, `…_G`, `…_B`).
    pub vertex_albedo_deviation: Option<&'a [[f32; 3]]>,
    /// Maps over the mesh's texture coordinates, embedded as PNG.
    pub textures: Option<GlbTextures<'a>>,
}

/// Maps over the texture coordinates, row 0 at v = 0.
#[derive(Clone, Copy, Debug)]
pub struct GlbTextures<'a> {
    /// Linear base colour, three channels in [0, 1]; stored with the sRGB curve, as the format asks.
    pub base_color: &'a Image,
    /// Roughness, one channel in [0, 1].
    pub roughness: &'a Image,
    /// κ, one channel.
    pub specular: &'a Image,
}

/// Encodes `mesh` as a binary glTF file.
///
/// # Errors
/// Says what is wrong when the mesh is empty, or when the surface does not fit the mesh.
pub fn encode_glb(mesh: &Mesh, surface: &GlbSurface) -> Result<Vec<u8>, String> {
    let vertices = mesh.positions.len();
    mesh.validate().map_err(|error| error.to_string())?;
    let mut glb = Glb::default();
    let positions: Vec<Vec3> = mesh.positions.iter().map(|&p| y_up(p)).collect();
    let low = positions
        .iter()
        .copied()
        .reduce(Vec3::min)
        .unwrap_or_default();
    let high = positions
        .iter()
        .copied()
        .reduce(Vec3::max)
        .unwrap_or_default();
    let position = glb.floats("VEC3", 3, positions.iter().flat_map(|p| p.to_array()));
    glb.accessors[position]["min"] = json!(low.to_array());
    glb.accessors[position]["max"] = json!(high.to_array());
    let mut attributes = json!({ "POSITION": position });
    if !mesh.normals.is_empty() {
        attributes["NORMAL"] = glb
            .floats(
                "VEC3",
                3,
                mesh.normals.iter().flat_map(|&n| y_up(n).to_array()),
            )
            .into();
    }
    if !mesh.uvs.is_empty() {
        attributes["TEXCOORD_0"] = glb
            .floats("VEC2", 2, mesh.uvs.iter().flat_map(|uv| uv.to_array()))
            .into();
    }
    let check = |what: &str, count: Option<usize>| match count {
        Some(count) if count != vertices => {
            Err(format!("there are {count} {what} for {vertices} vertices"))
        }
        _ => Ok(()),
    };
    check("vertex colours", surface.vertex_colors.map(<[_]>::len))?;
    check("roughness values", surface.vertex_roughness.map(<[_]>::len))?;
    check("specular values", surface.vertex_specular.map(<[_]>::len))?;
    let deviations = surface.vertex_albedo_deviation;
    check("deviations of the albedo", deviations.map(<[_]>::len))?;
    if let Some(colors) = surface.vertex_colors {
        let values = colors.iter().flatten().copied();
        attributes["COLOR_0"] = glb.floats("VEC3", 3, values).into();
    }
    for (name, values) in [
        ("_ROUGHNESS", surface.vertex_roughness),
        ("_SPECULAR", surface.vertex_specular),
    ] {
        if let Some(values) = values {
            attributes[name] = glb.floats("SCALAR", 1, values.iter().copied()).into();
        }
    }
    // Channels one by one: Blender 4.2 mixes attributes up that are its own file's affair and of several types, and fails, at every
    // other start.
    for (c, name) in ["_ALBEDO_SD_R", "_ALBEDO_SD_G", "_ALBEDO_SD_B"]
        .into_iter()
        .enumerate()
    {
        if let Some(values) = deviations {
            let values = values.iter().map(|value| value[c]);
            attributes[name] = glb.floats("SCALAR", 1, values).into();
        }
    }
    let indices = glb.indices(mesh);
    let material = match surface.textures {
        Some(_) if mesh.uvs.is_empty() => {
            return Err("textures need a mesh with texture coordinates".into());
        }
        Some(textures) => textured(&mut glb, &textures)?,
        None => uniform(surface),
    };
    // All lengths of the format are 32 bits wide; the JSON needs far less than a mebibyte.
    if glb.blob.len() > u32::MAX as usize - (1 << 20) {
        return Err(
            "it takes more than the 4 GiB that binary glTF can hold: simplify the mesh".into(),
        );
    }
    Ok(glb.finish(
        &json!({ "attributes": attributes, "indices": indices, "material": 0 }),
        &material,
    ))
}

/// A material of the mean roughness and specular: the format has no per-vertex kind.
fn uniform(surface: &GlbSurface) -> Value {
    let mean = |values: Option<&[f32]>, default: f32| {
        values.map_or(default, |values| {
            values.iter().sum::<f32>() / values.len().max(1) as f32
        })
    };
    let roughness = mean(surface.vertex_roughness, 1.0).clamp(0.0, 1.0);
    let color = mean(surface.vertex_specular, UNIT_SPECULAR).max(0.0) / UNIT_SPECULAR;
    json!({
        "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": roughness },
        "extensions": { "KHR_materials_specular": { "specularColorFactor": [color, color, color] } },
    })
}

fn textured(glb: &mut Glb, textures: &GlbTextures) -> Result<Value, String> {
    let GlbTextures {
        base_color,
        roughness,
        specular,
    } = textures;
    for (what, image, channels) in [
        ("base colour", base_color, 3),
        ("roughness", roughness, 1),
        ("specular", specular, 1),
    ] {
        if image.channels != channels {
            return Err(format!(
                "the {what} texture has {} channels where {channels} are expected",
                image.channels
            ));
        }
    }
    let encoded = Image {
        data: base_color.data.iter().map(|&v| linear_to_srgb(v)).collect(),
        ..(*base_color).clone()
    };
    let map = |image: &Image, channels: usize, pixel: &dyn Fn(f32) -> [f32; 4]| Image {
        channels,
        data: image
            .data
            .iter()
            .flat_map(|&v| pixel(v).into_iter().take(channels))
            .collect(),
        ..*image
    };
    // The format keeps roughness in green (metalness in blue), and the specular factor in alpha.
    let rough = map(roughness, 3, &|v| [0.0, v, 0.0, 0.0]);
    let peak = specular.data.iter().copied().fold(0.0, f32::max);
    let factors = map(specular, 4, &|v| {
        [1.0, 1.0, 1.0, if peak > 0.0 { v / peak } else { 0.0 }]
    });
    let color = peak / UNIT_SPECULAR;
    let [base, rough, factors] = [encoded, rough, factors].map(|image| glb.texture(&image));
    Ok(json!({
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": base? },
            "metallicRoughnessTexture": { "index": rough? },
        },
        "extensions": { "KHR_materials_specular": {
            "specularTexture": { "index": factors? },
            "specularColorFactor": [color, color, color],
        } },
    }))
}

/// A file in the making.
#[derive(Default)]
struct Glb {
    blob: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
}

impl Glb {
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view =
            json!({ "buffer": 0, "byteOffset": self.blob.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.blob.extend_from_slice(bytes);
        // Accessors start at multiples of their component's size.
        self.blob.resize(self.blob.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    fn floats(&mut self, kind: &str, width: usize, values: impl Iterator<Item = f32>) -> usize {
        const ARRAY_BUFFER: u32 = 34962;
        const FLOAT: u32 = 5126;
        let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
        let count = bytes.len() / (4 * width);
        let view = self.view(&bytes, Some(ARRAY_BUFFER));
        self.accessors.push(
            json!({ "bufferView": view, "componentType": FLOAT, "count": count, "type": kind }),
        );
        self.accessors.len() - 1
    }

    fn indices(&mut self, mesh: &Mesh) -> usize {
        const ELEMENT_ARRAY_BUFFER: u32 = 34963;
        const UNSIGNED_INT: u32 = 5125;
        let bytes: Vec<u8> = mesh
            .faces
            .iter()
            .flatten()
            .flat_map(|index| index.to_le_bytes())
            .collect();
        let view = self.view(&bytes, Some(ELEMENT_ARRAY_BUFFER));
        let count = mesh.faces.len() * 3;
        self.accessors.push(
            json!({ "bufferView": view, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR" }),
        );
        self.accessors.len() - 1
    }

    fn texture(&mut self, image: &Image) -> Result<usize, String> {
        let png =
            encode_png8(image, Path::new("the texture")).map_err(|error| error.to_string())?;
        let view = self.view(&png, None);
        self.images
            .push(json!({ "bufferView": view, "mimeType": "image/png" }));
        Ok(self.images.len() - 1)
    }

    fn finish(self, primitive: &Value, material: &Value) -> Vec<u8> {
        let mut root = json!({
            "asset": { "version": "2.0", "generator": "eclipse" },
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0, "name": "object" }],
            "meshes": [{ "primitives": [primitive] }],
            "materials": [material],
            "extensionsUsed": ["KHR_materials_specular"],
            "buffers": [{ "byteLength": self.blob.len() }],
            "bufferViews": self.views,
            "accessors": self.accessors,
        });
        if !self.images.is_empty() {
            root["textures"] = (0..self.images.len())
                .map(|source| json!({ "source": source }))
                .collect();
            root["images"] = self.images.into();
        }
        let mut json = root.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let length = 12 + 8 + json.len() + 8 + self.blob.len();
        let mut bytes = Vec::with_capacity(length);
        bytes.extend_from_slice(b"glTF");
        bytes.extend([2, length as u32].into_iter().flat_map(u32::to_le_bytes));
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &self.blob)] {
            bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
            bytes.extend_from_slice(kind);
            bytes.extend_from_slice(chunk);
        }
        bytes
    }
}

/// From z up to glTF's y up: (x, y, z) here is (x, z, −y) there.
fn y_up(v: Vec3) -> Vec3 {
    Vec3::new(v.x, v.z, -v.y)
}
