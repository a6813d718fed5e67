//! Faces of more than three corners, as triangles: convex ones as fans, others by clipping ears in the plane that fits them best.

use earcut::Earcut;
use glam::{DVec2, DVec3, Vec3};

use super::{MeshParseError, raw::RawMesh};

/// Most corners of a face whose ears are clipped, which may take time with their square. One of more is a fan, whatever its shape.
const MOST_CORNERS: usize = 1 << 14;
/// Sine of the angle by which a corner may turn inwards and still count as straight: rounded positions do so.
const STRAIGHT: f64 = 1e-5;

impl RawMesh {
    /// Adds a face whose corners are these vertices, in order; its triangles turn as it does.
    ///
    /// Of vertices that are not there yet, or lie nowhere, the shape cannot be known: it is a fan then.
    pub fn polygon(&mut self, corners: &[u32]) -> Result<(), MeshParseError> {
        self.room(0, corners.len().saturating_sub(2))?;
        let ears = match corners.len() {
            4..=MOST_CORNERS => flattened(corners, &self.positions)
                .filter(|flat| !is_convex(flat))
                .and_then(|flat| ears(&flat)),
            _ => None,
        };
        match ears {
            Some(ears) => {
                let face = |ear: [usize; 3]| ear.map(|index| corners[index]);
                self.faces.extend(ears.into_iter().map(face));
            }
            None => {
                let face = |i: usize| [corners[0], corners[i - 1], corners[i]];
                self.faces.extend((2..corners.len()).map(face));
            }
        }
        Ok(())
    }
}

/// The corners in the plane that fits them best, where they turn counter-clockwise; `None` where there is no such plane.
fn flattened(corners: &[u32], positions: &[Vec3]) -> Option<Vec<DVec2>> {
    let corner = |&index: &u32| positions.get(index as usize).map(|p| p.as_dvec3());
    let corners: Vec<DVec3> = corners.iter().map(corner).collect::<Option<_>>()?;
    let first = corners[0];
    let arms: Vec<DVec3> = corners.iter().map(|corner| *corner - first).collect();
    // Newell's: twice the area that is seen along each axis.
    let area: DVec3 = arms.windows(2).map(|pair| pair[0].cross(pair[1])).sum();
    let extent = arms.iter().map(|arm| arm.length()).fold(0.0, f64::max);
    let normal = area.try_normalize()?;
    // Also where anything is not finite.
    let has_area = area.length() > 1e-12 * extent * extent;
    let (u, v) = normal.any_orthonormal_pair();
    // By whatever handedness the pair comes in: counter-clockwise as seen against the normal.
    let v = if u.cross(v).dot(normal) > 0.0 { v } else { -v };
    let flat = |arm: &DVec3| DVec2::new(arm.dot(u), arm.dot(v)) / extent;
    has_area.then(|| arms.iter().map(flat).collect())
}

/// Whether no corner turns inwards.
fn is_convex(flat: &[DVec2]) -> bool {
    let next = flat.iter().cycle().skip(1);
    let edges = flat.iter().zip(next).map(|(from, to)| *to - *from);
    // Corners that coincide say nothing of how the others turn.
    let directions: Vec<DVec2> = edges.filter_map(DVec2::try_normalize).collect();
    let next = directions.iter().cycle().skip(1);
    directions
        .iter()
        .zip(next)
        .all(|(edge, next)| edge.perp_dot(*next) > -STRAIGHT)
}

/// Triangles of the corners' numbers, counter-clockwise; `None` where no ear is found at all.
fn ears(flat: &[DVec2]) -> Option<Vec<[usize; 3]>> {
    let mut indices: Vec<usize> = Vec::new();
    let corners: Vec<[f64; 2]> = flat.iter().map(|corner| corner.to_array()).collect();
    Earcut::new().earcut_slice(&corners, &[], &mut indices);
    let turned = |ear: &[usize; 3]| {
        let [a, b, c] = ear.map(|index| flat[index]);
        match (b - a).perp_dot(c - a) < 0.0 {
            true => [ear[0], ear[2], ear[1]],
            false => *ear,
        }
    };
    let (ears, _) = indices.as_chunks();
    (!ears.is_empty()).then(|| ears.iter().map(turned).collect())
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    /// An L, counter-clockwise: three of the four quarters of a square of side 2, a corner straight.
    const L: [[f32; 2]; 7] = [
        [0.0, 0.0],
        [1.0, 0.0],
        [2.0, 0.0],
        [2.0, 1.0],
        [1.0, 1.0],
        [1.0, 2.0],
        [0.0, 2.0],
    ];

    fn triangles(positions: &[Vec3], corners: &[u32]) -> Vec<[u32; 3]> {
        let mut raw = RawMesh {
            positions: positions.to_vec(),
            ..RawMesh::default()
        };
        raw.polygon(corners).unwrap();
        raw.faces
    }

    fn fan(corners: &[u32]) -> Vec<[u32; 3]> {
        let face = |i: usize| [corners[0], corners[i - 1], corners[i]];
        (2..corners.len()).map(face).collect()
    }

    /// Twice the area of a triangle, along its normal.
    fn area(positions: &[Vec3], face: [u32; 3]) -> Vec3 {
        let [a, b, c] = face.map(|index| positions[index as usize]);
        (b - a).cross(c - a)
    }

    #[test]
    fn a_concave_face_is_covered_once_and_nothing_beside_it() {
        let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0);
        let offset = Vec3::new(100.0, -3.0, 7.0);
        let positions = L.map(|[x, y]| turn * Vec3::new(x, y, 0.0) + offset);
        let inside = |centre: Vec3| {
            let local = turn.inverse() * (centre - offset);
            assert!(local.z.abs() < 1e-4, "{local}");
            local.x < 1.0 || local.y < 1.0
        };
        for first in 0..L.len() as u32 {
            for backwards in [false, true] {
                let mut corners: Vec<u32> = (0..L.len() as u32)
                    .map(|i| (first + i) % L.len() as u32)
                    .collect();
                if backwards {
                    corners.reverse();
                }
                let faces = triangles(&positions, &corners);
                assert_eq!(faces.len(), L.len() - 2);
                let normal = turn * if backwards { Vec3::NEG_Z } else { Vec3::Z };
                let areas = faces.iter().map(|face| area(&positions, *face).dot(normal));
                let areas: Vec<f32> = areas.collect();
                let whole: f32 = areas.iter().sum();
                assert!((0.5 * whole - 3.0).abs() < 1e-4, "{first}: {areas:?}");
                assert!(areas.iter().all(|area| *area > -1e-4), "{areas:?}");
                // What has no area covers nothing, wherever it lies.
                let some = faces.iter().zip(&areas).filter(|(_, area)| **area > 1e-4);
                for (face, _) in some {
                    let centre: Vec3 = face.iter().map(|&i| positions[i as usize] / 3.0).sum();
                    assert!(inside(centre), "{first}: {face:?}");
                }
            }
        }
    }

    #[test]
    fn convex_faces_stay_fans_from_their_first_corner() {
        let round = |count: usize| -> Vec<Vec3> {
            let angle = |i: usize| i as f32 / count as f32 * std::f32::consts::TAU;
            let point = |i: usize| Vec3::new(angle(i).cos(), angle(i).sin(), 5.0);
            (0..count).map(point).collect()
        };
        for count in [3, 4, 5, 60] {
            let corners: Vec<u32> = (0..count as u32).collect();
            assert_eq!(triangles(&round(count), &corners), fan(&corners));
        }
        // With a straight corner, one twice, and one a little out of the plane.
        let corners = [0, 1, 2, 2, 3, 4];
        let positions = [
            Vec3::ZERO,
            Vec3::new(0.5, 1e-7, 0.0),
            Vec3::X,
            Vec3::new(1.0, 1.0, 0.1),
            Vec3::Y,
        ];
        assert_eq!(triangles(&positions, &corners), fan(&corners));
        // The two triangles of a bent face.
        let bent = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.8), Vec3::Y];
        assert_eq!(triangles(&bent, &[3, 0, 1, 2]), fan(&[3, 0, 1, 2]));
    }

    #[test]
    fn an_arrowhead_is_cut_from_its_notch() {
        let positions = [
            Vec3::new(0.0, 2.0, 0.0),
            Vec3::new(-1.0, 0.0, 0.0),
            Vec3::new(0.0, 1.0, 0.0),
            Vec3::new(1.0, 0.0, 0.0),
        ];
        // As a fan from the first wing it would cover the notch.
        for first in 0..4 {
            let corners = [0, 1, 2, 3].map(|i| (first + i) % 4);
            let faces = triangles(&positions, &corners);
            assert_eq!(faces.len(), 2);
            assert!(
                faces
                    .iter()
                    .all(|face| face.contains(&0) && face.contains(&2))
            );
            assert!(faces.iter().all(|face| area(&positions, *face).z > 0.0));
        }
    }

    #[test]
    fn files_of_concave_faces_have_their_area() {
        let vertices: String = L.map(|[x, y]| format!("{x} {y} 0\n")).concat();
        let obj: String = vertices.lines().map(|line| format!("v {line}\n")).collect();
        // From a corner whose fan would cover the missing quarter.
        let obj = super::super::parse_obj(format!("{obj}f 4 5 6 7 1 2 3\n").as_bytes());
        let ply = format!(
            "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n{vertices}7 3 4 5 6 0 1 2\n"
        );
        let ply = super::super::parse_ply(ply.as_bytes());
        for mesh in [obj.unwrap(), ply.unwrap()] {
            let areas = mesh.faces.iter().map(|face| area(&mesh.positions, *face));
            let whole: f32 = areas.map(|area| 0.5 * area.length()).sum();
            assert!((whole - 3.0).abs() < 1e-5, "{whole}");
        }
    }

    #[test]
    fn what_has_no_shape_is_a_fan() {
        let corners = [0, 1, 2, 3];
        let line = [0.0, 1.0, 3.0, 2.0].map(Vec3::splat);
        assert_eq!(triangles(&line, &corners), fan(&corners));
        assert_eq!(triangles(&[Vec3::ONE; 4], &corners), fan(&corners));
        // Vertices that follow in the file, or are no numbers: the mesh's checks tell of them.
        assert_eq!(triangles(&[], &corners), fan(&corners));
        let mut bad = L.map(|[x, y]| Vec3::new(x, y, 0.0));
        for value in [f32::NAN, f32::INFINITY, 3e38] {
            bad[5].x = value;
            assert_eq!(triangles(&bad, &[0, 2, 3, 4, 5, 6]).len(), 4);
        }
        assert_eq!(triangles(&line, &[0, 1]), [[0; 3]; 0]);
    }
}
