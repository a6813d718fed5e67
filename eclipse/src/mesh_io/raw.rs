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

/// Which vertices of a file a mesh has.
pub(super) struct Origins {
    /// How many the file has.
    pub all: usize,
    /// Those of the mesh, ascending.
    pub kept: Vec<u32>,
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

    /// Checks positions and indices, drops degenerate faces and what vertices no face names, and completes the normals.
    pub fn finish(self) -> Result<Mesh, MeshParseError> {
        self.finish_with_origins().map(|(mesh, _)| mesh)
    }

    /// [`finish`](Self::finish), and which vertices of the file the mesh has.
    pub fn finish_with_origins(mut self) -> Result<(Mesh, Origins), MeshParseError> {
        let vertices = self.positions.len();
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
        let kept = self.named();
        let position = |vertex: &&u32| self.positions[**vertex as usize];
        let mut bad = kept.iter().filter(|vertex| !position(vertex).is_finite());
        if let Some(&first) = bad.next() {
            return Err(MeshParseError::NotFinite {
                count: 1 + bad.count(),
                first: first as usize,
            });
        }
        self.keep(&kept);
        let origins = Origins {
            all: vertices,
            kept,
        };
        Ok((self.completed()?, origins))
    }

    /// The vertices that faces name, ascending.
    fn named(&self) -> Vec<u32> {
        let mut named = vec![false; self.positions.len()];
        for &index in self.faces.iter().flatten() {
            named[index as usize] = true;
        }
        let vertices = 0..self.positions.len() as u32;
        vertices.filter(|&vertex| named[vertex as usize]).collect()
    }

    /// Leaves these vertices, ascending, which are all that faces name: others would count in the bounds of the object.
    fn keep(&mut self, vertices: &[u32]) {
        let all = self.positions.len();
        if vertices.len() == all {
            return;
        }
        let mut places = vec![0; all];
        for (place, &vertex) in vertices.iter().enumerate() {
            places[vertex as usize] = place as u32;
        }
        for index in self.faces.iter_mut().flatten() {
            *index = places[*index as usize];
        }
        choose(&mut self.positions, all, vertices);
        choose(&mut self.normals, all, vertices);
        choose(&mut self.uvs, all, vertices);
    }

    /// The mesh with normals, of which all is checked but its extent.
    fn completed(mut self) -> Result<Mesh, MeshParseError> {
        let vertices = self.positions.len();
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

/// Leaves the values of these vertices, if there is one for each of `all`; those that are not so many are none.
fn choose<T: Copy>(values: &mut Vec<T>, all: usize, vertices: &[u32]) {
    if values.len() == all {
        *values = vertices.iter().map(|&v| values[v as usize]).collect();
    } else {
        values.clear();
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
    fn vertices_that_no_face_names_are_left_out_of_all_that_is_kept_of_vertices() {
        let raw = RawMesh {
            // What is far away, or nowhere, is no part of the object.
            positions: vec![
                Vec3::splat(1e6),
                Vec3::ZERO,
                Vec3::X,
                Vec3::splat(f32::NAN),
                Vec3::Y,
                Vec3::Z,
            ],
            normals: vec![Vec3::X, Vec3::Z, Vec3::Z, Vec3::X, Vec3::Z, Vec3::X],
            uvs: (0..6).map(|i| Vec2::new(i as f32, 0.5)).collect(),
            // The last vertex is only that of a face without area.
            faces: vec![[5, 5, 1], [1, 2, 4]],
        };
        let (mesh, origins) = raw.finish_with_origins().unwrap();
        assert_eq!((origins.all, origins.kept), (6, vec![1, 2, 4]));
        assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
        assert_eq!(mesh.normals, [Vec3::Z; 3]);
        assert_eq!(mesh.faces, [[0, 1, 2]]);
        let across: Vec<f32> = mesh.uvs.iter().map(|uv| uv.x).collect();
        assert_eq!(across, [1.0, 2.0, 4.0]);
        assert_eq!(mesh.bounds()[1], Vec3::new(1.0, 1.0, 0.0));
    }

    #[test]
    fn what_is_wrong_with_a_vertex_is_told_by_its_place_in_the_file() {
        let raw = RawMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::splat(f32::NAN)],
            faces: vec![[1, 2, 3]],
            ..RawMesh::default()
        };
        let message = raw.finish().unwrap_err().to_string();
        assert!(message.contains("the first is number 3"), "{message}");
    }

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
