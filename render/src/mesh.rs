//! Triangle meshes.

use glam::{DVec3, Vec2, Vec3};
use thiserror::Error;

use crate::lat_long::LatLong;

/// An indexed triangle mesh in the world's frame (right-handed, z up).
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions, in the capture's length unit.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a vertex.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one a vertex, or empty.
    pub uvs: Vec<Vec2>,
    /// Triangles as vertex indices, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
}

/// A mesh that cannot be rendered.
#[derive(Debug, Error, PartialEq)]
pub enum MeshError {
    /// No triangles.
    #[error(
        "the mesh has no faces; expected at least one triangle: export the object's surface, not only its points"
    )]
    NoFaces,
    /// A vertex that is not finite.
    #[error(
        "the mesh's vertex {vertex} is at {position}, which is not finite: repair or re-export the mesh"
    )]
    Position {
        /// Vertex index.
        vertex: usize,
        /// Its position.
        position: Vec3,
    },
    /// A face that names a vertex that is not there.
    #[error(
        "the mesh's face {face} uses vertex {index}, but there are only {vertices} vertices: re-export the mesh"
    )]
    Index {
        /// Face index.
        face: usize,
        /// The vertex index it uses.
        index: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// Per-vertex data of another length than the vertices.
    #[error(
        "the mesh has {found} {what} for {vertices} vertices; expected one a vertex or none: re-export the mesh"
    )]
    Count {
        /// Which data.
        what: &'static str,
        /// Their number.
        found: usize,
        /// Number of vertices.
        vertices: usize,
    },
}

/// What a mesh may lack of a closed surface and still have an inside: the hole's area, of the rest's.
const LARGEST_HOLE: f64 = 0.3;

impl Mesh {
    /// Checks that the mesh can be rendered.
    ///
    /// # Errors
    /// When there are no faces, an index is out of range, a position is not finite, or normals or texture coordinates
    /// are neither absent nor one a vertex.
    pub fn validate(&self) -> Result<(), MeshError> {
        let vertices = self.positions.len();
        if self.faces.is_empty() {
            return Err(MeshError::NoFaces);
        }
        if let Some(vertex) = self.positions.iter().position(|p| !p.is_finite()) {
            return Err(MeshError::Position {
                vertex,
                position: self.positions[vertex],
            });
        }
        for (face, indices) in self.faces.iter().enumerate() {
            if let Some(&index) = indices.iter().find(|&&i| i as usize >= vertices) {
                return Err(MeshError::Index {
                    face,
                    index,
                    vertices,
                });
            }
        }
        for (what, found) in [
            ("normals", self.normals.len()),
            ("texture coordinates", self.uvs.len()),
        ] {
            if found != 0 && found != vertices {
                return Err(MeshError::Count {
                    what,
                    found,
                    vertices,
                });
            }
        }
        Ok(())
    }

    /// A ball of `rows` × 2 `rows` quadrilaterals (triangles at the poles, ±z) with exact normals; its vertices lie on the ball.
    pub fn sphere(centre: Vec3, radius: f32, rows: u32) -> Self {
        let columns = 2 * rows;
        let mut mesh = Self::default();
        for r in 0..=rows {
            for c in 0..columns {
                let normal = LatLong::direction(c as f32 / columns as f32, r as f32 / rows as f32);
                mesh.positions.push(centre + radius * normal);
                mesh.normals.push(normal);
            }
        }
        let at = |r: u32, c: u32| r * columns + c % columns;
        for r in 0..rows {
            for c in 0..columns {
                if r + 1 < rows {
                    mesh.faces.push([at(r, c), at(r + 1, c + 1), at(r + 1, c)]);
                }
                if r > 0 {
                    mesh.faces.push([at(r, c), at(r, c + 1), at(r + 1, c + 1)]);
                }
            }
        }
        mesh
    }

    /// Appends another mesh; texture coordinates are kept only where both have them.
    pub fn append(&mut self, other: &Self) {
        let textured = self.positions.is_empty() || !self.uvs.is_empty();
        let start = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.normals.extend(&other.normals);
        if textured && !other.uvs.is_empty() {
            self.uvs.extend(&other.uvs);
        } else {
            self.uvs.clear();
        }
        let faces = other.faces.iter().map(|face| face.map(|i| start + i));
        self.faces.extend(faces);
    }

    /// The corners of the axis-aligned bounding box: least and greatest coordinates (zero for an empty mesh).
    pub fn bounds(&self) -> [Vec3; 2] {
        let first = self.positions.first().copied().unwrap_or(Vec3::ZERO);
        self.positions
            .iter()
            .fold([first, first], |[low, high], &p| [low.min(p), high.max(p)])
    }

    /// The largest distance of a vertex from the origin.
    pub fn bounding_radius(&self) -> f32 {
        self.positions
            .iter()
            .map(|p| p.length())
            .fold(0.0, f32::max)
    }

    /// The three corners of a face.
    pub fn triangle(&self, face: usize) -> [Vec3; 3] {
        self.faces[face].map(|i| self.positions[i as usize])
    }

    /// The area of each face.
    pub fn areas(&self) -> Vec<f32> {
        (0..self.faces.len())
            .map(|f| 0.5 * self.face_cross(f).length())
            .collect()
    }

    /// The unit normal of a face by its winding (zero for a degenerate face).
    pub fn face_normal(&self, face: usize) -> Vec3 {
        self.face_cross(face).normalize_or_zero()
    }

    /// Computes vertex normals when there are none: the mean of the adjoining faces' normals weighted by their angle at
    /// the vertex (Thürmer & Wüthrich 1998), which does not depend on how a flat part is cut into triangles. They face out of a
    /// body: see [`face_outwards`](Self::face_outwards).
    pub fn ensure_normals(&mut self) {
        if self.normals.len() == self.positions.len() {
            return;
        }
        self.normals = vec![Vec3::ZERO; self.positions.len()];
        for (face, indices) in self.faces.iter().enumerate() {
            let normal = self.face_normal(face);
            let corners = self.triangle(face);
            for k in 0..3 {
                let a = corners[(k + 1) % 3] - corners[k];
                let b = corners[(k + 2) % 3] - corners[k];
                let angle = if a.length_squared() * b.length_squared() > 0.0 {
                    a.angle_between(b)
                } else {
                    0.0
                };
                self.normals[indices[k] as usize] += angle * normal;
            }
        }
        for normal in &mut self.normals {
            *normal = normal.try_normalize().unwrap_or(Vec3::Z);
        }
        self.face_outwards();
    }

    /// Turns the normals of a body that is inside out, and says whether it was: some files wind their faces the other way. A mesh
    /// with large holes has no inside, and keeps its normals.
    pub fn face_outwards(&mut self) -> bool {
        let middle = self.bounds()[0].midpoint(self.bounds()[1]);
        // The volume and the vectors of area add up to those of a closed body, whose vectors add up to nothing.
        let (mut volume, mut area, mut vectors) = (0.0f64, 0.0f64, DVec3::ZERO);
        for (face, corners) in self.faces.iter().enumerate() {
            let cross = self.face_cross(face);
            let normals = corners.map(|i| self.normals[i as usize]);
            let side = if cross.dot(normals.iter().sum()) < 0.0 {
                -1.0
            } else {
                1.0
            };
            let cross = side * cross.as_dvec3();
            let corner = self.positions[corners[0] as usize] - middle;
            volume += corner.as_dvec3().dot(cross) / 6.0;
            area += 0.5 * cross.length();
            vectors += 0.5 * cross;
        }
        let inside_out = volume < 0.0 && vectors.length() < LARGEST_HOLE * area;
        if inside_out {
            self.normals
                .iter_mut()
                .for_each(|normal| *normal = -*normal);
        }
        inside_out
    }

    fn face_cross(&self, face: usize) -> Vec3 {
        let [a, b, c] = self.triangle(face);
        (b - a).cross(c - a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> Mesh {
        let positions = (0..8)
            .map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32))
            .collect();
        let quads = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let faces = quads
            .iter()
            .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
            .collect();
        Mesh {
            positions,
            faces,
            ..Mesh::default()
        }
    }

    #[test]
    fn a_cube_has_its_bounds_area_and_normals_along_the_diagonals() {
        let mut mesh = cube();
        mesh.ensure_normals();
        assert_eq!(mesh.validate(), Ok(()));
        assert_eq!(mesh.bounds(), [Vec3::ZERO, Vec3::ONE]);
        assert!((mesh.areas().iter().sum::<f32>() - 6.0).abs() < 1e-5);
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            let diagonal = (*p - Vec3::splat(0.5)).normalize();
            assert!((*n - diagonal).length() < 1e-5, "{p} {n}");
        }
    }

    #[test]
    fn a_body_that_is_inside_out_is_turned() {
        let outwards = |mesh: &Mesh| {
            let both = mesh.positions.iter().zip(&mesh.normals);
            both.filter(|(p, n)| (**p - Vec3::splat(0.5)).dot(**n) > 0.0)
                .count()
        };
        let turned = |mesh: &Mesh| Mesh {
            faces: mesh.faces.iter().map(|&[a, b, c]| [a, c, b]).collect(),
            ..mesh.clone()
        };
        // Wound the other way, without normals and with such as its faces have.
        let mut mesh = turned(&cube());
        mesh.ensure_normals();
        assert_eq!(outwards(&mesh), 8);
        assert!(!mesh.face_outwards());
        mesh.normals.iter_mut().for_each(|n| *n = -*n);
        assert!(mesh.face_outwards());
        assert_eq!(outwards(&mesh), 8);
        // A box without its lid has an inside, one side of a box has none.
        let mut open = turned(&cube());
        open.faces.drain(2..4);
        open.ensure_normals();
        assert_eq!(outwards(&open), 8);
        open.faces.truncate(2);
        open.normals.clear();
        open.ensure_normals();
        let of_faces = open.face_normal(0);
        assert!(
            open.faces[0]
                .iter()
                .all(|&i| open.normals[i as usize].dot(of_faces) > 0.9)
        );
    }

    #[test]
    fn a_ball_is_wound_as_its_normals_say() {
        let ball = Mesh::sphere(Vec3::new(3.0, 0.0, 1.0), 2.0, 6);
        for (face, corners) in ball.faces.iter().enumerate() {
            assert!(
                ball.face_normal(face)
                    .dot(ball.normals[corners[1] as usize])
                    > 0.5
            );
        }
    }

    #[test]
    fn unusable_meshes_are_named() {
        assert_eq!(Mesh::default().validate(), Err(MeshError::NoFaces));
        let mut mesh = cube();
        mesh.faces[3][1] = 8;
        assert_eq!(
            mesh.validate(),
            Err(MeshError::Index {
                face: 3,
                index: 8,
                vertices: 8
            })
        );
        let mut mesh = cube();
        mesh.positions[2].y = f32::NAN;
        assert!(matches!(
            mesh.validate(),
            Err(MeshError::Position { vertex: 2, .. })
        ));
        let mesh = Mesh {
            uvs: vec![Vec2::ZERO; 3],
            ..cube()
        };
        assert!(matches!(
            mesh.validate(),
            Err(MeshError::Count { found: 3, .. })
        ));
    }
}
