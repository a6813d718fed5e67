//! Shadow rays of one point, as many at once as a vector holds.
//!
//! Rays from one place share all that depends on the place alone: a box's planes and a triangle's two cross products are
//! computed once for the packet, and each ray is left with dot products ("Fast, Minimum Storage Ray/Triangle Intersection", Möller
//! and Trumbore 1997, with the origin's terms taken out). A ray's answer is its own: it meets only triangles whose boxes it meets
//! itself, whoever else is in the packet.

use glam::Vec3;
use obvhs::bvh2::Bvh2;
use pulp::{Arch, Simd, WithSimd};

/// Directions of rays and what is known of them, a value an array. Lengths are equal.
pub struct Rays<'a> {
    /// x, y and z of unit directions.
    pub direction: [&'a [f32]; 3],
    /// Which rays are cast; those that are blocked are taken out.
    pub open: &'a mut [bool],
}

/// A binary hierarchy, laid out for packets.
pub(super) struct PacketTree {
    nodes: Vec<Node>,
    triangles: Vec<Corner>,
    depth: usize,
}

/// A box, with two boxes or some triangles in it.
#[derive(Clone, Copy)]
struct Node {
    least: Vec3,
    most: Vec3,
    first: u32,
    /// Triangles; 0 for an inner node.
    count: u32,
}

/// A triangle: a vertex and the edges from it.
#[derive(Clone, Copy)]
struct Corner {
    vertex: Vec3,
    edges: [Vec3; 2],
}

impl PacketTree {
    /// Of a hierarchy over triangles given by their vertices.
    pub(super) fn new(tree: &Bvh2, vertices: impl Fn(usize) -> [Vec3; 3]) -> Self {
        let nodes: Vec<Node> = tree
            .nodes
            .iter()
            .map(|node| Node {
                least: node.aabb.min.into(),
                most: node.aabb.max.into(),
                first: node.first_index,
                count: node.prim_count,
            })
            .collect();
        let triangles = tree.primitive_indices.iter().map(|&i| {
            let [a, b, c] = vertices(i as usize);
            Corner {
                vertex: a,
                edges: [b - a, c - a],
            }
        });
        Self {
            depth: depth(&nodes),
            triangles: triangles.collect(),
            nodes,
        }
    }

    /// Closes those of the open rays from `origin` that meet anything.
    pub(super) fn cast(&self, origin: Vec3, rays: Rays<'_>) {
        if !self.nodes.is_empty() {
            Arch::new().dispatch(Cast {
                tree: self,
                origin,
                rays,
            });
        }
    }
}

/// The most nodes on a way down from the first.
fn depth(nodes: &[Node]) -> usize {
    let (mut deepest, mut stack) = (0, vec![(0usize, 1usize)]);
    while let Some((node, depth)) = stack.pop() {
        deepest = deepest.max(depth);
        if let Some(node) = nodes.get(node).filter(|node| node.count == 0) {
            let first = node.first as usize;
            stack.extend([(first, depth + 1), (first + 1, depth + 1)]);
        }
    }
    deepest
}

struct Cast<'a, 'b> {
    tree: &'a PacketTree,
    origin: Vec3,
    rays: Rays<'b>,
}

/// A direction's component is at least this, so that its reciprocal times any distance is a number.
const LEAST: f32 = 1e-20;
/// Far sides of boxes are this much farther: rounding must not lose a hit in a flat box.
const WIDER: f32 = 1.0 + 1e-6;

impl WithSimd for Cast<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tree, origin, rays } = self;
        let width = S::F32_LANES;
        let mut stack = Vec::with_capacity(tree.depth + 1);
        let [x, y, z] = rays.direction;
        let packets = x.chunks(width).zip(y.chunks(width)).zip(z.chunks(width));
        for (((x, y), z), open) in packets.zip(rays.open.chunks_mut(width)) {
            let mut asked = [0.0f32; 64];
            for (asked, open) in asked.iter_mut().zip(open.iter()) {
                *asked = f32::from(u8::from(*open));
            }
            let zero = simd.splat_f32s(0.0);
            let wanted = simd.greater_than_f32s(simd.partial_load_f32s(&asked[..width]), zero);
            if simd.first_true_m32s(wanted) == width {
                continue;
            }
            let direction = [x, y, z].map(|d| simd.partial_load_f32s(d));
            let blocked = packet(simd, tree, origin, direction, wanted, &mut stack);
            let mut hit = [0.0f32; 64];
            let one = simd.splat_f32s(1.0);
            let values = simd.select_f32s(blocked, one, zero);
            simd.partial_store_f32s(&mut hit[..width], values);
            for (open, hit) in open.iter_mut().zip(hit) {
                *open &= hit == 0.0;
            }
        }
    }
}

/// Which of the wanted rays meet anything.
#[inline(always)]
fn packet<S: Simd>(
    simd: S,
    tree: &PacketTree,
    origin: Vec3,
    direction: [S::f32s; 3],
    wanted: S::m32s,
    stack: &mut Vec<u32>,
) -> S::m32s {
    let splat = |value: f32| simd.splat_f32s(value);
    let zero = splat(0.0);
    let inverse = direction.map(|d| {
        let tiny = simd.less_than_f32s(simd.abs_f32s(d), splat(LEAST));
        simd.div_f32s(splat(1.0), simd.select_f32s(tiny, splat(LEAST), d))
    });
    // Rays that still have to be followed.
    let mut left = wanted;
    let mut blocked = simd.less_than_f32s(zero, zero);
    stack.clear();
    stack.push(0);
    while let Some(node) = stack.pop() {
        let node = &tree.nodes[node as usize];
        let [least, most] = [node.least - origin, node.most - origin].map(|v| v.to_array());
        let (mut enter, mut leave) = (zero, splat(f32::INFINITY));
        for axis in 0..3 {
            let one = simd.mul_f32s(splat(least[axis]), inverse[axis]);
            let other = simd.mul_f32s(splat(most[axis]), inverse[axis]);
            enter = simd.max_f32s(enter, simd.min_f32s(one, other));
            leave = simd.min_f32s(leave, simd.max_f32s(one, other));
        }
        let leave = simd.mul_f32s(leave, splat(WIDER));
        let inside = simd.and_m32s(left, simd.less_than_or_equal_f32s(enter, leave));
        if simd.first_true_m32s(inside) == S::F32_LANES {
            continue;
        }
        if node.count == 0 {
            stack.extend([node.first, node.first + 1]);
            continue;
        }
        for triangle in &tree.triangles[node.first as usize..][..node.count as usize] {
            let met = simd.and_m32s(inside, meets(simd, triangle, origin, direction));
            blocked = simd.or_m32s(blocked, met);
        }
        left = simd.and_m32s(wanted, simd.not_m32s(blocked));
        if simd.first_true_m32s(left) == S::F32_LANES {
            break;
        }
    }
    blocked
}

/// Which rays from `origin` meet a triangle, from either side.
#[inline(always)]
fn meets<S: Simd>(simd: S, triangle: &Corner, origin: Vec3, direction: [S::f32s; 3]) -> S::m32s {
    let zero = simd.splat_f32s(0.0);
    let [first, second] = triangle.edges;
    let from = origin - triangle.vertex;
    let across = from.cross(first);
    let dot = |v: Vec3| {
        let [x, y, z] = v.to_array().map(|c| simd.splat_f32s(c));
        let [dx, dy, dz] = direction;
        simd.mul_add_f32s(dx, x, simd.mul_add_f32s(dy, y, simd.mul_f32s(dz, z)))
    };
    // Determinant, barycentric coordinates and distance, each times the determinant; turned so that it is positive.
    let determinant = dot(second.cross(first));
    let (u, v) = (dot(second.cross(from)), dot(across));
    let distance = simd.splat_f32s(second.dot(across));
    let negative = simd.less_than_f32s(determinant, zero);
    let turned = |x: S::f32s| simd.select_f32s(negative, simd.neg_f32s(x), x);
    let [determinant, u, v, distance] = [determinant, u, v, distance].map(turned);
    let inside = simd.less_than_or_equal_f32s(simd.add_f32s(u, v), determinant);
    let inside = simd.and_m32s(inside, simd.greater_than_or_equal_f32s(u, zero));
    let inside = simd.and_m32s(inside, simd.greater_than_or_equal_f32s(v, zero));
    let ahead = simd.and_m32s(
        simd.greater_than_f32s(determinant, zero),
        simd.greater_than_or_equal_f32s(distance, zero),
    );
    simd.and_m32s(inside, ahead)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::Bvh;
    use crate::mesh::Mesh;
    use crate::sampler::SampleKey;

    /// Which of the rays that are asked for stay open.
    fn open_of(
        bvh: &Bvh,
        origin: Vec3,
        directions: &[Vec3],
        asked: impl Fn(usize) -> bool,
    ) -> Vec<bool> {
        let along =
            [0, 1, 2].map(|axis| -> Vec<f32> { directions.iter().map(|d| d[axis]).collect() });
        let [x, y, z] = &along;
        let mut open: Vec<bool> = (0..directions.len()).map(asked).collect();
        let rays = Rays {
            direction: [x, y, z],
            open: &mut open,
        };
        bvh.close_blocked(origin, rays);
        open
    }

    /// Two balls, one with faces turned inside out, from many places: as one ray at a time says, but for rays along edges.
    #[test]
    fn packets_say_what_single_rays_say() {
        let mut mesh = Mesh::sphere(Vec3::ZERO, 1.0, 24);
        let mut other = Mesh::sphere(Vec3::new(1.5, 0.2, 0.4), 0.7, 17);
        let first = mesh.positions.len() as u32;
        other.faces.iter_mut().for_each(|face| face.swap(0, 1));
        mesh.positions.append(&mut other.positions);
        let faces = other.faces.iter().map(|face| face.map(|i| first + i));
        mesh.faces.extend(faces);
        mesh.normals.clear();
        let bvh = Bvh::new(&mesh).unwrap();
        let mut stream = SampleKey::default().stream();
        let mut number = || 2.0 * stream.uniform() - 1.0;
        let (mut differ, mut hits, mut cast) = (0, 0, 0);
        for round in 0..200 {
            let origin = 2.5 * Vec3::new(number(), number(), number());
            // Lengths that leave lanes over, directions along axes, rays that are not asked for.
            let count = 1 + 7 * round % 50;
            let directions: Vec<Vec3> = (0..count)
                .map(|i| match i {
                    3 => Vec3::X,
                    8 => Vec3::NEG_Z,
                    _ => Vec3::new(number(), number(), number()).normalize_or(Vec3::Y),
                })
                .collect();
            let asked = |i: usize| i % 5 != 2;
            let open = open_of(&bvh, origin, &directions, asked);
            for (i, direction) in directions.iter().enumerate() {
                if !asked(i) {
                    assert!(!open[i]);
                    continue;
                }
                let blocked = bvh.blocked(origin, *direction);
                differ += usize::from(blocked == open[i]);
                hits += usize::from(blocked);
                cast += 1;
            }
        }
        assert!(hits > cast / 10 && hits < cast * 9 / 10, "{hits} of {cast}");
        assert!(differ <= cast / 1000, "{differ} of {cast}");
    }

    /// What a ray says does not depend on the rays beside it.
    #[test]
    fn rays_of_a_packet_are_strangers() {
        let bvh = Bvh::new(&Mesh::sphere(Vec3::ZERO, 1.0, 12)).unwrap();
        let origin = Vec3::new(0.3, -1.8, 0.9);
        let all: Vec<Vec3> = (0..97)
            .map(|i| {
                Vec3::new((0.7 * i as f32).sin(), 1.5, (0.3 * i as f32).cos() - 0.5).normalize()
            })
            .collect();
        let ask = |directions: &[Vec3]| open_of(&bvh, origin, directions, |_| true);
        let together = ask(&all);
        let alone: Vec<bool> = all.iter().map(|d| ask(&[*d])[0]).collect();
        assert_eq!(together, alone);
        assert!(together.contains(&true) && together.contains(&false));
    }
}
