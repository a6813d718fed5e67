//! Reading back what is written on a mesh: albedo, α and κ, at vertices or as maps.

use std::path::Path;

use glam::Vec2;
use gltf::{Document, Material, Semantic, image::Source, texture::Texture};
use render::{image::Image, mesh::Mesh};

use super::{
    MeshParseError,
    gltf_accessor::Buffers,
    gltf_in::{mesh_of, nothing_else, open, syntax},
};
use crate::{
    image_io::{ColorEncoding, decode_raster},
    reconstruction::VertexMaterial,
};

/// Reflectance at normal incidence of a specular factor of 1, by the format.
const UNIT_SPECULAR: f32 = 0.04;

/// The material on a mesh.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshSurface {
    /// One a vertex.
    Vertices(Vec<VertexMaterial>),
    /// Over the texture coordinates.
    Maps(SurfaceMaps),
}

/// Maps over the texture coordinates, row 0 at v = 0, repeating.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMaps {
    /// Linear albedo, three channels.
    pub albedo: Image,
    /// glTF roughness √α, one channel.
    pub roughness: Image,
    /// κ, one channel.
    pub kappa: Image,
}

impl SurfaceMaps {
    /// The material at a texture coordinate, each map interpolated bilinearly.
    pub fn at(&self, uv: Vec2) -> VertexMaterial {
        let [albedo, roughness, kappa] =
            [&self.albedo, &self.roughness, &self.kappa].map(|map| lookup(map, uv));
        VertexMaterial {
            albedo,
            alpha: roughness[0] * roughness[0],
            kappa: kappa[0],
        }
    }
}

/// Up to three channels of a repeating map, centres of texels at halves.
fn lookup(map: &Image, uv: Vec2) -> [f32; 3] {
    let size = Vec2::new(map.width as f32, map.height as f32);
    // The fractional part first: far repeats leave no digits otherwise.
    let place = (uv - uv.floor()) * size - 0.5;
    let low = place.floor();
    let part = place - low;
    let wrapped = |value: f32, size: usize| (value as i64).rem_euclid(size as i64) as usize;
    let mut sum = [0.0; 3];
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let weight = (1.0 - (part.x - dx).abs()) * (1.0 - (part.y - dy).abs());
        let (x, y) = (
            wrapped(low.x + dx, map.width),
            wrapped(low.y + dy, map.height),
        );
        for (sum, value) in sum.iter_mut().zip(map.pixel(x, y)) {
            *sum += weight * value;
        }
    }
    sum
}

/// Parses a binary glTF file of one primitive, as [`write_glb`](super::write_glb) makes them, with its material.
pub fn parse_surfaced_glb(bytes: &[u8]) -> Result<(Mesh, MeshSurface), MeshParseError> {
    let (document, buffers) = open(bytes, &mut nothing_else)?;
    check_images(&document)?;
    let surface = surface_of(&document, &buffers)?;
    let (mesh, origins) = mesh_of(&document, buffers)?;
    match surface {
        MeshSurface::Vertices(materials) if materials.len() != origins.all => Err(syntax(format!(
            "it has {} materials for {} vertices",
            materials.len(),
            origins.all
        ))),
        MeshSurface::Vertices(materials) => {
            let kept = origins.kept.iter().map(|&v| materials[v as usize]);
            Ok((mesh, MeshSurface::Vertices(kept.collect())))
        }
        MeshSurface::Maps(_) if mesh.uvs.is_empty() => Err(MeshParseError::NoMaterials(
            "it has textures without usable texture coordinates",
        )),
        surface => Ok((mesh, surface)),
    }
}

/// The gltf crate takes for granted that an image is somewhere, and what it is where it is embedded.
fn check_images(document: &Document) -> Result<(), MeshParseError> {
    let images = &document.as_json().images;
    let told = |image: &gltf::json::Image| match &image.buffer_view {
        Some(_) => image.mime_type.is_some(),
        None => image.uri.is_some(),
    };
    match images.iter().position(|image| !told(image)) {
        Some(k) => Err(syntax(format!(
            "image {k} has neither `uri` nor `bufferView` with `mimeType`"
        ))),
        None => Ok(()),
    }
}

fn surface_of(document: &Document, buffers: &Buffers) -> Result<MeshSurface, MeshParseError> {
    let mut primitives = document.meshes().flat_map(|mesh| mesh.primitives());
    let (Some(primitive), None) = (primitives.next(), primitives.next()) else {
        return Err(MeshParseError::NoMaterials(
            "it is made of several parts, or of none",
        ));
    };
    let material = primitive.material();
    let base = material.pbr_metallic_roughness();
    if base.base_color_texture().is_some() {
        return maps(&material, buffers);
    }
    let Some(colors) = primitive.get(&Semantic::Colors(0)) else {
        return Err(MeshParseError::NoMaterials(
            "neither textures nor vertex colours",
        ));
    };
    let albedo = buffers.colors(&colors)?;
    let scalars = |name: &str, default: f32| match primitive.get(&Semantic::Extras(name.to_owned()))
    {
        Some(accessor) => buffers.floats::<1>(&accessor),
        None => Ok(vec![[default]; albedo.len()]),
    };
    let roughness = scalars("ROUGHNESS", base.roughness_factor())?;
    let kappa = scalars("SPECULAR", kappa_factor(&material))?;
    if roughness.len() != albedo.len() || kappa.len() != albedo.len() {
        return Err(syntax("its materials differ in number".to_owned()));
    }
    let values = albedo.iter().zip(&roughness).zip(&kappa);
    let materials: Vec<VertexMaterial> = values
        .map(|((&albedo, [roughness]), &[kappa])| VertexMaterial {
            albedo,
            alpha: roughness * roughness,
            kappa,
        })
        .collect();
    let finite = |m: &VertexMaterial| {
        let [r, g, b] = m.albedo;
        [r, g, b, m.alpha, m.kappa].iter().all(|v| v.is_finite())
    };
    match materials.iter().position(|material| !finite(material)) {
        Some(vertex) => Err(syntax(format!(
            "the material of vertex {vertex} is not finite"
        ))),
        None => Ok(MeshSurface::Vertices(materials)),
    }
}

/// κ without its texture.
fn kappa_factor(material: &Material) -> f32 {
    material.specular().map_or(UNIT_SPECULAR, |specular| {
        let color = specular.specular_color_factor();
        UNIT_SPECULAR * specular.specular_factor() * color.iter().sum::<f32>() / 3.0
    })
}

fn maps(material: &Material, buffers: &Buffers) -> Result<MeshSurface, MeshParseError> {
    let base = material.pbr_metallic_roughness();
    let [r, g, b, _] = base.base_color_factor();
    let albedo = match base.base_color_texture() {
        Some(info) => decode(&info.texture(), buffers, ColorEncoding::Srgb)?,
        None => white(),
    };
    let roughness = match base.metallic_roughness_texture() {
        Some(info) => decode(&info.texture(), buffers, ColorEncoding::Linear)?,
        None => white(),
    };
    let specular = material
        .specular()
        .and_then(|specular| specular.specular_texture());
    let specular = match specular {
        Some(info) => decode(&info.texture(), buffers, ColorEncoding::Linear)?,
        None => white(),
    };
    let color = |pixel: &[f32]| match *pixel {
        [red, green, blue, ..] => [red, green, blue],
        _ => [pixel[0]; 3],
    };
    let opacity = |pixel: &[f32]| match *pixel {
        [_, alpha] | [_, _, _, alpha] => alpha,
        _ => 1.0,
    };
    let kappa = kappa_factor(material);
    let factor = base.roughness_factor();
    Ok(MeshSurface::Maps(SurfaceMaps {
        albedo: mapped(&albedo, |pixel| {
            let [red, green, blue] = color(pixel);
            [r * red, g * green, b * blue]
        }),
        roughness: mapped(&roughness, |pixel| [factor * color(pixel)[1]]),
        kappa: mapped(&specular, |pixel| [kappa * opacity(pixel)]),
    }))
}

fn white() -> Image {
    Image::filled(1, 1, 4, 1.0)
}

/// Another image, pixel by pixel.
fn mapped<const N: usize>(image: &Image, pixel: impl Fn(&[f32]) -> [f32; N]) -> Image {
    Image {
        width: image.width,
        height: image.height,
        channels: N,
        data: image
            .data
            .chunks_exact(image.channels)
            .flat_map(pixel)
            .collect(),
    }
}

/// A texture that is embedded in the file.
fn decode(
    texture: &Texture,
    buffers: &Buffers,
    encoding: ColorEncoding,
) -> Result<Image, MeshParseError> {
    let Source::View { view, .. } = texture.source().source() else {
        return Err(MeshParseError::Unsupported(
            "textures in files of their own".into(),
        ));
    };
    let bytes = buffers.view(&view)?;
    decode_raster(bytes, Path::new("the texture"), Some(encoding))
        .map_err(|error| syntax(error.to_string()))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::mesh_io::{GlbSurface, GlbTextures, encode_glb};

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
            faces: vec![[0, 1, 2]],
            ..Mesh::default()
        }
    }

    #[test]
    fn vertex_materials_come_back_as_they_were_written() {
        let surface = GlbSurface {
            vertex_colors: Some(&[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]]),
            vertex_roughness: Some(&[0.5, 0.6, 0.7]),
            vertex_specular: Some(&[0.02, 0.04, 0.08]),
            ..Default::default()
        };
        let bytes = encode_glb(&triangle(), &surface).unwrap();
        let (mesh, MeshSurface::Vertices(materials)) = parse_surfaced_glb(&bytes).unwrap() else {
            panic!("expected a material a vertex");
        };
        assert_eq!(mesh.positions, triangle().positions);
        assert_eq!(materials[1].albedo, [0.4, 0.5, 0.6]);
        assert!((materials[1].alpha - 0.36).abs() < 1e-6);
        assert_eq!(materials[2].kappa, 0.08);
    }

    #[test]
    fn materials_stay_with_their_vertices_where_some_are_of_no_face() {
        let mut mesh = triangle();
        mesh.positions.insert(1, Vec3::splat(9.0));
        mesh.uvs.insert(1, Vec2::ONE);
        mesh.faces = vec![[0, 2, 3]];
        let surface = GlbSurface {
            vertex_colors: Some(&[[0.1; 3], [0.9; 3], [0.2; 3], [0.3; 3]]),
            ..Default::default()
        };
        let bytes = encode_glb(&mesh, &surface).unwrap();
        let (mesh, MeshSurface::Vertices(materials)) = parse_surfaced_glb(&bytes).unwrap() else {
            panic!("expected a material a vertex");
        };
        assert_eq!(mesh.positions, triangle().positions);
        assert_eq!(mesh.uvs, triangle().uvs);
        let albedos: Vec<f32> = materials.iter().map(|m| m.albedo[0]).collect();
        assert_eq!(albedos, [0.1, 0.2, 0.3]);
    }

    #[test]
    fn an_image_that_is_nowhere_is_told() {
        let map = Image::filled(2, 2, 3, 0.5);
        let scalar = Image::filled(2, 2, 1, 0.5);
        let surface = GlbSurface {
            textures: Some(GlbTextures {
                base_color: &map,
                roughness: &scalar,
                specular: &scalar,
            }),
            ..Default::default()
        };
        let bytes = encode_glb(&triangle(), &surface).unwrap();
        assert!(parse_surfaced_glb(&bytes).is_ok());
        for name in ["mimeType", "bufferView"] {
            let field = format!("\"{name}\":");
            let images = bytes.windows(9).position(|w| w == b"\"images\":").unwrap();
            let at = bytes[images..]
                .windows(field.len())
                .position(|w| w == field.as_bytes());
            let mut without = bytes.clone();
            // Any other name: the file keeps its length.
            without[images + at.unwrap() + 1] = b'x';
            let message = parse_surfaced_glb(&without).unwrap_err().to_string();
            assert!(message.contains("image 0 has neither"), "{message}");
        }
    }

    #[test]
    fn maps_come_back_to_the_steps_of_eight_bits_and_are_interpolated() {
        let ramp = |channels: usize, scale: f32| Image {
            width: 4,
            height: 2,
            channels,
            data: (0..8 * channels).map(|i| scale * i as f32).collect(),
        };
        let (albedo, roughness, kappa) = (ramp(3, 0.04), ramp(1, 0.1), ramp(1, 0.01));
        let surface = GlbSurface {
            textures: Some(GlbTextures {
                base_color: &albedo,
                roughness: &roughness,
                specular: &kappa,
            }),
            ..Default::default()
        };
        let bytes = encode_glb(&triangle(), &surface).unwrap();
        let (_, MeshSurface::Maps(maps)) = parse_surfaced_glb(&bytes).unwrap() else {
            panic!("expected maps");
        };
        // The sRGB curve is steepest at 1, where half a step of 1/255 is 0.0045 of light.
        let near = |a: &Image, b: &Image, most: f32| {
            let pairs = a.data.iter().zip(&b.data);
            assert!(
                pairs.clone().count() > 0 && pairs.into_iter().all(|(a, b)| (a - b).abs() < most)
            );
        };
        near(&maps.albedo, &albedo, 0.0046);
        near(&maps.roughness, &roughness, 0.002);
        near(&maps.kappa, &kappa, 0.002 * 0.07);
        // Between two texels' centres of the upper row, and across the seam to the left of the first.
        let middle = maps.at(Vec2::new(0.25, 0.25)).kappa;
        assert!((middle - 0.005).abs() < 3e-4, "{middle}");
        let seam = maps.at(Vec2::new(3.0, 0.25)).kappa;
        assert!((seam - 0.015).abs() < 3e-4, "{seam}");
    }

    #[test]
    fn a_bare_mesh_has_no_materials() {
        let bytes = encode_glb(&triangle(), &GlbSurface::default()).unwrap();
        let error = parse_surfaced_glb(&bytes).unwrap_err().to_string();
        assert!(error.contains("has no materials"), "{error}");
    }
}
