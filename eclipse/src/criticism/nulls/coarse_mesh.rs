//! A mesh with a quarter of the triangles, beside photographs of the whole one.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use render::mesh::Mesh;

use super::{Kind, Structure};
use crate::capture::Capture;

/// Share of the faces that is left at most.
const SHARE: f64 = 0.25;

/// A decimated scan.
pub(super) struct CoarseMesh;

impl Structure for CoarseMesh {
    fn id(&self) -> &'static str {
        "coarse_mesh"
    }

    fn kind(&self) -> Kind {
        Kind::Structured
    }

    fn derive(&self, capture: &mut Capture) {
        let faces = capture.mesh.faces.len();
        let most = (SHARE * faces as f64) as usize;
        let radius = capture.mesh.bounding_radius();
        let mut cell = radius / (faces as f32).sqrt();
        loop {
            let coarse = clustered(&capture.mesh, cell);
            if coarse.faces.len() <= most.max(4) {
                // A body thinner than a cell would vanish: better the mesh as it was.
                if !coarse.faces.is_empty() {
                    capture.mesh = coarse;
                }
                return;
            }
            cell *= 1.1;
        }
    }
}

/// The mesh with all vertices of a cubic cell drawn together into their mean (Rossignac & Borrel 1993), normals too.
fn clustered(mesh: &Mesh, cell: f32) -> Mesh {
    let mut fine = mesh.clone();
    fine.ensure_normals();
    let mut index: HashMap<IVec3, u32> = HashMap::new();
    let mut sums: Vec<(Vec3, Vec3, f32)> = Vec::new();
    let cluster_of: Vec<u32> = mesh
        .positions
        .iter()
        .zip(&fine.normals)
        .map(|(&position, &normal)| {
            let key = (position / cell).floor().as_ivec3();
            let cluster = *index.entry(key).or_insert_with(|| {
                sums.push((Vec3::ZERO, Vec3::ZERO, 0.0));
                sums.len() as u32 - 1
            });
            let (sum, normals, count) = &mut sums[cluster as usize];
            *sum += position;
            *normals += normal;
            *count += 1.0;
            cluster
        })
        .collect();
    let faces = mesh
        .faces
        .iter()
        .map(|face| face.map(|i| cluster_of[i as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    // Both sides of something thin may meet in a cell: any normal is as good as another there.
    let normal = |sum: &Vec3| sum.try_normalize().unwrap_or(Vec3::Z);
    Mesh {
        positions: sums.iter().map(|(sum, _, n)| *sum / *n).collect(),
        normals: sums.iter().map(|(_, normals, _)| normal(normals)).collect(),
        faces,
        ..Mesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coarse_sphere_is_still_about_the_sphere() {
        let mesh = Mesh::sphere(Vec3::ZERO, 1.0, 40);
        let coarse = clustered(&mesh, 0.2);
        assert!(coarse.faces.len() * 4 < mesh.faces.len() && coarse.faces.len() > 100);
        assert!(coarse.validate().is_ok());
        for (position, normal) in coarse.positions.iter().zip(&coarse.normals) {
            assert!((position.length() - 1.0).abs() < 0.05, "{position}");
            assert!(position.normalize().dot(*normal) > 0.9);
        }
    }
}
