//! The object as PLY with its materials at the vertices: `r g b` (linear albedo) and `roughness_x`, which Mitsuba reads as the
//! attributes `vertex_color` and `vertex_roughness`.

use render::bvh::Hit;

use super::y_up;
use crate::{mesh_io::MeshSurface, relight::Object};

/// A binary file, y up, in the object's own frame.
pub(super) fn encode(object: &Object) -> Vec<u8> {
    let mesh = &object.mesh;
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property float r\nproperty float g\nproperty float b\nproperty float roughness_x\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.faces.len()
    )
    .into_bytes();
    let materials = at_vertices(object);
    for (vertex, [r, g, b, roughness]) in materials.into_iter().enumerate() {
        let position = y_up(mesh.positions[vertex] + object.centre);
        let normal = y_up(mesh.normals[vertex]);
        let numbers = position.to_array().into_iter().chain(normal.to_array());
        let numbers = numbers.chain([r, g, b, roughness]);
        bytes.extend(numbers.flat_map(f32::to_le_bytes));
    }
    for face in &mesh.faces {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|index| (*index as i32).to_le_bytes()));
    }
    bytes
}

/// Albedo and roughness of each vertex.
fn at_vertices(object: &Object) -> Vec<[f32; 4]> {
    let flat = |albedo: [f32; 3], alpha: f32| {
        let [r, g, b] = albedo;
        [r, g, b, alpha.max(0.0).sqrt()]
    };
    match &object.surface {
        MeshSurface::Vertices(materials) => materials
            .iter()
            .map(|material| flat(material.albedo, material.alpha))
            .collect(),
        MeshSurface::Maps(maps) => object
            .mesh
            .uvs
            .iter()
            .map(|&uv| maps.at(uv))
            .map(|material| flat(material.albedo, material.alpha))
            .collect(),
    }
}

/// The mean κ over the surface, each triangle by its area.
pub(super) fn mean_kappa(object: &Object) -> f32 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (face, area) in object.mesh.areas().into_iter().enumerate() {
        let centre = Hit {
            t: 0.0,
            face: face as u32,
            barycentric: glam::Vec2::splat(1.0 / 3.0),
        };
        sum += f64::from(area * object.material(&centre).kappa);
        total += f64::from(area);
    }
    if total > 0.0 {
        (sum / total) as f32
    } else {
        0.0
    }
}
