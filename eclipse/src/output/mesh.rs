//! The object with the recovered materials baked in.

use std::path::Path;

use render::mesh::Mesh;

use super::bake::bake;
use crate::{
    capture::Capture,
    mesh_io::{GlbSurface, GlbTextures, MeshIoError, write_glb},
    reconstruction::Reconstruction,
};

/// Writes the capture's mesh, in the capture's own frame, with a material a vertex where there is one.
pub(super) fn write(
    path: &Path,
    capture: &Capture,
    reconstruction: &Reconstruction,
) -> Result<(), MeshIoError> {
    let mesh = own_frame(capture);
    let mut materials = reconstruction.vertex_materials.clone();
    if reconstruction.settings.lambertian {
        // Programs take a surface for glossy unless they are told otherwise.
        for material in &mut materials {
            (material.alpha, material.kappa) = (1.0, 0.0);
        }
    }
    let albedo: Vec<[f32; 3]> = materials.iter().map(|material| material.albedo).collect();
    // glTF's roughness is the square root of the lobe's α.
    let roughness: Vec<f32> = materials
        .iter()
        .map(|material| material.alpha.max(0.0).sqrt())
        .collect();
    let specular: Vec<f32> = materials.iter().map(|material| material.kappa).collect();
    let uncertainty = reconstruction.uncertainty.as_ref();
    let deviation = uncertainty.map(|uncertainty| uncertainty.vertex_albedo.as_slice());
    let deviation = deviation.filter(|deviation| deviation.len() == mesh.positions.len());
    let surface = if materials.is_empty() {
        GlbSurface::default()
    } else {
        GlbSurface {
            vertex_colors: Some(&albedo),
            vertex_roughness: Some(&roughness),
            vertex_specular: Some(&specular),
            vertex_albedo_deviation: deviation,
            textures: None,
        }
    };
    // Programs prefer textures to vertex colours, which would be multiplied with them.
    let textures = (!materials.is_empty() && mesh.uvs.len() == mesh.positions.len())
        .then(|| bake(&mesh, &materials))
        .flatten();
    let surface = match &textures {
        None => surface,
        Some(textures) => GlbSurface {
            vertex_colors: None,
            textures: Some(GlbTextures {
                base_color: &textures.base_color,
                roughness: &textures.roughness,
                specular: &textures.specular,
            }),
            ..surface
        },
    };
    write_glb(path, &mesh, &surface)
}

fn own_frame(capture: &Capture) -> Mesh {
    let mut mesh = capture.mesh.clone();
    for position in &mut mesh.positions {
        *position += capture.centre;
    }
    mesh
}
