//! The object with the recovered materials baked in.

use std::path::Path;

use render::mesh::Mesh;

use crate::{
    capture::Capture,
    mesh_io::{GlbSurface, MeshIoError, write_glb},
    reconstruction::Reconstruction,
};

/// Writes the capture's mesh, in the capture's own frame, with a material a vertex where there is one.
pub(super) fn write(
    path: &Path,
    capture: &Capture,
    reconstruction: &Reconstruction,
) -> Result<(), MeshIoError> {
    let mesh = own_frame(capture);
    let materials = &reconstruction.vertex_materials;
    let albedo: Vec<[f32; 3]> = materials.iter().map(|material| material.albedo).collect();
    // glTF's roughness is the square root of the lobe's α.
    let roughness: Vec<f32> = materials
        .iter()
        .map(|material| material.alpha.max(0.0).sqrt())
        .collect();
    let specular: Vec<f32> = materials.iter().map(|material| material.kappa).collect();
    let surface = if materials.is_empty() {
        GlbSurface::default()
    } else if reconstruction.settings.lambertian {
        GlbSurface {
            vertex_colors: Some(&albedo),
            ..Default::default()
        }
    } else {
        GlbSurface {
            vertex_colors: Some(&albedo),
            vertex_roughness: Some(&roughness),
            vertex_specular: Some(&specular),
            textures: None,
        }
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
