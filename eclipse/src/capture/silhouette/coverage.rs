//! Silhouettes at low resolution: which pixel centres some triangle covers.

use std::collections::{HashMap, HashSet};

use glam::Vec3;
use render::{camera::Camera, image::Image, mesh::Mesh};

/// Intersection over union of the silhouette with `mask` (inverted if asked) in an image whose longer side is `side`
/// pixels. Triangles that reach behind the camera are left out.
pub(super) fn overlap(
    positions: &[Vec3],
    faces: &[[u32; 3]],
    camera: &Camera,
    mask: &Image,
    inverted: bool,
    side: usize,
) -> f32 {
    let (covered, size) = silhouette(positions, faces, camera, [mask.width, mask.height], side);
    let scale = [
        size[0] as f32 / mask.width as f32,
        size[1] as f32 / mask.height as f32,
    ];
    let (mut both, mut either) = (0, 0);
    for (index, &covered) in covered.iter().enumerate() {
        let column = ((index % size[0]) as f32 + 0.5) / scale[0];
        let row = ((index / size[0]) as f32 + 0.5) / scale[1];
        let (column, row) = (
            (column as usize).min(mask.width - 1),
            (row as usize).min(mask.height - 1),
        );
        let masked = (mask.pixel(column, row)[0] > 0.5) != inverted;
        both += usize::from(covered && masked);
        either += usize::from(covered || masked);
    }
    if either == 0 {
        0.0
    } else {
        both as f32 / either as f32
    }
}

/// The pixels whose centres the mesh covers, row-major, and the size of their image: the longer side of `full` reduced to
/// `side`. Triangles that reach behind the camera are left out.
pub(super) fn silhouette(
    positions: &[Vec3],
    faces: &[[u32; 3]],
    camera: &Camera,
    full: [usize; 2],
    side: usize,
) -> (Vec<bool>, [usize; 2]) {
    let scale = (side as f32 / full[0].max(full[1]) as f32).min(1.0);
    let size = full.map(|pixels| ((pixels as f32 * scale).round() as usize).max(1));
    let scale = [
        size[0] as f32 / full[0] as f32,
        size[1] as f32 / full[1] as f32,
    ];
    let project = |&point: &Vec3| {
        camera
            .project(point)
            .map(|[x, y]| [x * scale[0], y * scale[1]])
    };
    let corners: Vec<Option<[f32; 2]>> = positions.iter().map(project).collect();
    let mut covered = vec![false; size[0] * size[1]];
    for face in faces {
        if let [Some(a), Some(b), Some(c)] = face.map(|index| corners[index as usize]) {
            fill(&mut covered, size, [a, b, c]);
        }
    }
    (covered, size)
}

/// Marks the pixels whose centres lie in the triangle, whichever way it is wound.
fn fill(covered: &mut [bool], [width, height]: [usize; 2], corners: [[f32; 2]; 3]) {
    let range = |axis: usize, limit: usize| {
        let values = corners.map(|corner| corner[axis]);
        let low = values.into_iter().fold(f32::INFINITY, f32::min);
        let high = values.into_iter().fold(f32::NEG_INFINITY, f32::max);
        // Float to integer casts saturate, so that far corners stay within the image.
        ((low - 0.5).ceil().max(0.0) as usize)..((high + 0.5).ceil().max(0.0) as usize).min(limit)
    };
    let edge = |from: [f32; 2], to: [f32; 2], x: f32, y: f32| {
        (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0])
    };
    let [a, b, c] = corners;
    for row in range(1, height) {
        for column in range(0, width) {
            let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
            let sides = [edge(a, b, x, y), edge(b, c, x, y), edge(c, a, x, y)];
            if sides.iter().all(|&side| side >= 0.0) || sides.iter().all(|&side| side <= 0.0) {
                covered[row * width + column] = true;
            }
        }
    }
}

/// A mesh simplified by merging the vertices of each cell of a grid: its silhouette stays within a cell.
pub(super) struct Coarse {
    pub positions: Vec<Vec3>,
    pub faces: Vec<[u32; 3]>,
}

impl Coarse {
    /// Merges over `cells` cells along the longest side of the bounding box.
    pub fn new(mesh: &Mesh, cells: usize) -> Self {
        let [low, high] = mesh.bounds();
        let cell = ((high - low).max_element() / cells as f32).max(f32::MIN_POSITIVE);
        let mut slots = HashMap::new();
        let mut positions = Vec::new();
        let slot_of: Vec<u32> = mesh
            .positions
            .iter()
            .map(|&position| {
                *slots
                    .entry(((position - low) / cell).as_ivec3())
                    .or_insert_with(|| {
                        positions.push(position);
                        positions.len() as u32 - 1
                    })
            })
            .collect();
        let mut seen = HashSet::new();
        let mut faces = Vec::new();
        for face in &mesh.faces {
            let mut face = face.map(|index| slot_of[index as usize]);
            face.sort_unstable();
            if face[0] != face[1] && face[1] != face[2] && seen.insert(face) {
                faces.push(face);
            }
        }
        Self { positions, faces }
    }
}
