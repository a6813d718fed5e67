//! From what a mesh file holds to a checked mesh.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use render::mesh::Mesh;

use super::{MAX_FACES, MAX_VERTICES, MeshParseError};

/// A mesh as read, unchecked. Normals and UVs are one a vertex, or are dropped.
#[derive(Default)]
pub(super) struct RawMesh {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub faces: Vec<[u32; 3]>,
}

impl RawMesh {
    /// Refuses more vertices and faces than a mesh may have, before anything is stored for them.
    pub fn room(&self, vertices: usize, faces: usize) -> Result<(), MeshParseError> {
        let wanted = [
            ("vertices", self.positions.len(), vertices, MAX_VERTICES),
            ("faces", self.faces.len(), faces, MAX_FACES),
        ];
        match wanted
            .into_iter()
            .find(|(_, have, more, most)| have.saturating_add(*more) > *most)
        {
            None => Ok(()),
            Some((what, .., most)) => Err(MeshParseError::TooLarge {
                what,
                most: most as u64,
            }),
        }
    }

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
        let mut mesh = Mesh {
            positions: self.positions,
            normals,
            uvs: self.uvs,
            faces: self.faces,
        };
        mesh.face_outwards();
        Ok(mesh)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_has_room_for_so_many_and_no_more() {
        let raw = RawMesh {
            positions: vec![Vec3::ZERO; 3],
            faces: vec![[0, 1, 2]],
            ..RawMesh::default()
        };
        raw.room(MAX_VERTICES - 3, MAX_FACES - 1).unwrap();
        let message = |vertices, faces| raw.room(vertices, faces).unwrap_err().to_string();
        assert!(message(MAX_VERTICES - 2, 0).contains("has more than 67108864 vertices"));
        assert!(message(0, MAX_FACES).contains("has more than 67108864 faces"));
        assert!(message(usize::MAX, 0).contains("vertices"));
    }
}
