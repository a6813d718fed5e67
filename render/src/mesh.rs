//! Triangle meshes.

use glam::{Vec2, Vec3};

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
