//! From what a mesh file holds to a checked mesh.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use render::mesh::Mesh;

use super::MeshParseError;

/// A mesh as read, unchecked. Normals and UVs are one a vertex, or are dropped.
#[derive(Default)]
pub(super) struct RawMesh {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub faces: Vec<[u32; 3]>,
}

impl RawMesh {
    /// Checks positions and indices, drops degenerate faces and completes the normals.
    pub fn finish(mut self) -> Result<Mesh, MeshParseError> {
        let vertices = self.positions.len();
        let mut bad = (0..vertices).filter(|&vertex| !self.positions[vertex].is_finite());
        if let Some(first) = bad.next() {
            return Err(MeshParseError::NotFinite {
                count: 1 + bad.count(),
                first,
            });
        }
        for (face, corners) in self.faces.iter().enumerate() {
            if let Some(&index) = corners.iter().find(|&&index| index as usize >= vertices) {
                return Err(MeshParseError::Index {
                    face,
                    index: index.into(),
                    vertices,
                });
            }
        }
        self.faces.retain(|[a, b, c]| a != b && b != c && c != a);
        if self.faces.is_empty() {
            return Err(MeshParseError::NoFaces { vertices });
        }
        let corner = |index: u32| self.positions[index as usize];
        let first = corner(self.faces[0][0]);
        if self
            .faces
            .iter()
            .flatten()
            .all(|&index| corner(index) == first)
        {
            return Err(MeshParseError::NoExtent);
        }
        let usable = |normal: &Vec3| normal.is_finite() && normal.length_squared() > 0.0;
        if self.normals.len() != vertices || !self.normals.iter().all(usable) {
            let computed = vertex_normals(&self.positions, &self.faces);
            if self.normals.len() == vertices {
                for (own, computed) in self.normals.iter_mut().zip(computed) {
                    *own = if usable(own) { *own } else { computed };
                }
            } else {
                self.normals = computed;
            }
        }
        // By the largest component first: squares of tiny normals underflow.
        let unit = |normal: &Vec3| (*normal / normal.abs().max_element()).normalize();
        let normals = self.normals.iter().map(unit).collect();
        if self.uvs.len() != vertices || !self.uvs.iter().all(|uv| uv.is_finite()) {
            self.uvs.clear();
        }
        Ok(Mesh {
            positions: self.positions,
            normals,
            uvs: self.uvs,
            faces: self.faces,
        })
    }
}

/// Normals from the faces, shared by all vertices at one position so that texture seams do not show as creases.
fn vertex_normals(positions: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
    let mut slots = HashMap::new();
    let mut welded = Mesh::default();
    let slot_of: Vec<u32> = positions
        .iter()
        .map(|position| {
            *slots
                .entry(position.to_array().map(f32::to_bits))
                .or_insert_with(|| {
                    welded.positions.push(*position);
                    welded.positions.len() as u32 - 1
                })
        })
        .collect();
    welded.faces = faces
        .iter()
        .map(|face| face.map(|index| slot_of[index as usize]))
        .collect();
    welded.ensure_normals();
    slot_of
        .into_iter()
        .map(|slot| welded.normals[slot as usize])
        .collect()
}
