//! Meshes with fewer triangles, by merging vertices in cells of a grid (Rossignac & Borrel, 1993).

use glam::Vec3;
use render::mesh::Mesh;

use crate::reconstruction::VertexMaterial;

/// Cells along the longest side to begin with.
const FINEST: f32 = 1024.0;
/// By how much cells grow until few enough triangles are left.
const GROWTH: f32 = 1.2;

/// The mesh with at most `most` triangles, without texture coordinates: itself where it has no more.
pub(super) fn thinned(
    mesh: &Mesh,
    materials: &[VertexMaterial],
    most: usize,
) -> (Mesh, Vec<VertexMaterial>) {
    let mut cells = FINEST;
    let mut result = (
        Mesh {
            uvs: Vec::new(),
            ..mesh.clone()
        },
        materials.to_vec(),
    );
    while result.0.faces.len() > most {
        result = merged(mesh, materials, cells);
        cells /= GROWTH;
    }
    result
}

/// One vertex for each of the cells that have any, the mean of theirs.
fn merged(mesh: &Mesh, materials: &[VertexMaterial], cells: f32) -> (Mesh, Vec<VertexMaterial>) {
    let [low, high] = mesh.bounds();
    let side = (high - low).max_element().max(f32::MIN_POSITIVE) / cells;
    let cell = |position: &Vec3| ((*position - low) / side).to_array().map(|x| x as u32);
    let keys: Vec<[u32; 3]> = mesh.positions.iter().map(cell).collect();
    let mut sorted = keys.clone();
    sorted.sort_unstable();
    sorted.dedup();
    let of: Vec<u32> = keys
        .iter()
        .map(|key| sorted.binary_search(key).unwrap_or_default() as u32)
        .collect();
    let mut sums = vec![(Vec3::ZERO, Vec3::ZERO, [0.0f32; 5], 0.0f32); sorted.len()];
    for (vertex, &target) in of.iter().enumerate() {
        let (position, normal, values, count) = &mut sums[target as usize];
        *position += mesh.positions[vertex];
        *normal += mesh.normals.get(vertex).copied().unwrap_or_default();
        let VertexMaterial {
            albedo: [r, g, b],
            alpha,
            kappa,
        } = materials[vertex];
        for (sum, value) in values.iter_mut().zip([r, g, b, alpha, kappa]) {
            *sum += value;
        }
        *count += 1.0;
    }
    let mut faces: Vec<[u32; 3]> = mesh
        .faces
        .iter()
        .map(|face| face.map(|index| of[index as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    // Two sides of one triangle are kept; copies of it are not.
    for face in &mut faces {
        let first = (0..3).min_by_key(|&k| face[k]).unwrap_or(0);
        face.rotate_left(first);
    }
    faces.sort_unstable();
    faces.dedup();
    let normals = if mesh.normals.len() == mesh.positions.len() {
        sums.iter().map(|sum| sum.1.normalize_or(Vec3::Z)).collect()
    } else {
        Vec::new()
    };
    let material = |(_, _, values, count): &(Vec3, Vec3, [f32; 5], f32)| {
        let [r, g, b, alpha, kappa] = values.map(|value| value / count);
        VertexMaterial {
            albedo: [r, g, b],
            alpha,
            kappa,
        }
    };
    let mesh = Mesh {
        positions: sums.iter().map(|sum| sum.0 / sum.3).collect(),
        normals,
        uvs: Vec::new(),
        faces,
    };
    (mesh, sums.iter().map(material).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of `n` × `n` cells in the plane z = 0, redder along x.
    fn square(n: u32) -> (Mesh, Vec<VertexMaterial>) {
        let corner = |k: u32| Vec3::new((k % (n + 1)) as f32, (k / (n + 1)) as f32, 0.0) / n as f32;
        let positions: Vec<Vec3> = (0..(n + 1) * (n + 1)).map(corner).collect();
        let cell = |k: u32| {
            let a = k / n * (n + 1) + k % n;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        };
        let material = |position: &Vec3| VertexMaterial {
            albedo: [position.x, 0.5, 0.2],
            alpha: 0.3,
            kappa: 0.04,
        };
        let materials = positions.iter().map(material).collect();
        let mesh = Mesh {
            normals: vec![Vec3::Z; positions.len()],
            positions,
            faces: (0..n * n).flat_map(cell).collect(),
            uvs: Vec::new(),
        };
        (mesh, materials)
    }

    #[test]
    fn few_triangles_stay_as_they_are() {
        let (mesh, materials) = square(4);
        let (same, kept) = thinned(&mesh, &materials, 32);
        assert_eq!((same.positions, same.faces), (mesh.positions, mesh.faces));
        assert_eq!(kept, materials);
    }

    #[test]
    fn many_become_no_more_than_asked_for_and_cover_the_same() {
        let (mesh, materials) = square(60);
        let (few, kept) = thinned(&mesh, &materials, 1000);
        assert_eq!(few.validate(), Ok(()));
        assert!(
            (300..=1000).contains(&few.faces.len()),
            "{}",
            few.faces.len()
        );
        let area: f32 = few.areas().iter().sum();
        assert!((area - 1.0).abs() < 0.15, "{area}");
        for (face, normal) in (0..few.faces.len()).map(|face| (face, few.face_normal(face))) {
            assert!(normal.z > 0.99, "face {face} turned over: {normal}");
        }
        for (position, material) in few.positions.iter().zip(&kept) {
            assert!((material.albedo[0] - position.x).abs() < 1e-5);
            assert!((material.alpha - 0.3).abs() < 1e-6);
        }
    }
}
