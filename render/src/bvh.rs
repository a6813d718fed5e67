//! Ray casting against the object (obvhs, eight-wide compressed hierarchy).
//!
//! Closest hits shade camera rays; occlusion rays find the object's own shadows. Queries take `&self` and keep no
//! state: any thread may cast any ray.

mod packet;
mod sight;

use std::time::Duration;

use glam::{Vec2, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray as ObvhsRay, RayHit};
use obvhs::triangle::Triangle;

use crate::camera::{Camera, Ray};
use crate::mesh::{Mesh, MeshError};

use packet::PacketTree;
pub use packet::Rays;
pub use sight::Sight;

/// The object's triangles in a bounding volume hierarchy.
pub struct Bvh {
    tree: Tree,
    packets: PacketTree,
    /// In the order of the tree's leaves.
    triangles: Vec<Triangle>,
    /// The mesh's face of each of them.
    faces: Vec<u32>,
    mesh: Mesh,
}

/// The wide tree casts shadow rays about 1.6 times as fast, but walks with a stack of 32 entries; a tree deeper than that
/// (triangles piled on one another) is walked as a binary one, whose stack grows.
enum Tree {
    Wide(CwBvh),
    Binary(Bvh2),
}

/// Depth of wide trees that is surely within their stack.
const MAX_WIDE_DEPTH: usize = 30;

/// Where a ray meets the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray.
    pub t: f32,
    /// The face met.
    pub face: u32,
    /// Barycentric coordinates of the face's second and third vertex.
    pub barycentric: Vec2,
}

/// A point of the surface, with all that lighting it needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in the world.
    pub position: Vec3,
    /// Unit shading normal, interpolated from the vertices.
    pub normal: Vec3,
    /// Unit normal of the triangle, on the shading normal's side.
    pub geometric_normal: Vec3,
}

impl Bvh {
    /// Builds the hierarchy; vertex normals are computed when absent.
    ///
    /// # Errors
    /// When the mesh does not [`validate`](Mesh::validate).
    pub fn new(mesh: &Mesh) -> Result<Self, MeshError> {
        mesh.validate()?;
        let mut mesh = mesh.clone();
        mesh.ensure_normals();
        let all: Vec<Triangle> = (0..mesh.faces.len())
            .map(|f| {
                let [v0, v1, v2] = mesh.triangle(f).map(Vec3A::from);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let params = BvhBuildParams {
            pre_split: false,
            ..BvhBuildParams::medium_build()
        };
        let binary = build_bvh2_from_tris(&all, params, &mut Duration::default());
        let packets = PacketTree::new(&binary, |i| {
            let Triangle { v0, v1, v2 } = all[i];
            [v0, v1, v2].map(Vec3::from)
        });
        let wide = build_cwbvh_from_tris(&all, params, &mut Duration::default());
        let (tree, faces) = if depth(&wide.compute_parents()) <= MAX_WIDE_DEPTH {
            let faces = wide.primitive_indices.clone();
            (Tree::Wide(wide), faces)
        } else {
            let faces = binary.primitive_indices.clone();
            (Tree::Binary(binary), faces)
        };
        let triangles = faces.iter().map(|&f| all[f as usize]).collect();
        Ok(Self {
            tree,
            packets,
            triangles,
            faces,
            mesh,
        })
    }

    /// The mesh, with its normals.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The first intersection of a ray.
    pub fn closest(&self, ray: Ray) -> Option<Hit> {
        let ray = ObvhsRay::new_inf(ray.origin.into(), ray.direction.into());
        let mut hit = RayHit::none();
        let intersect = |ray: &ObvhsRay, i: usize| self.triangles[i].intersect(ray);
        let found = match &self.tree {
            Tree::Wide(tree) => tree.ray_traverse(ray, &mut hit, intersect),
            Tree::Binary(tree) => tree.ray_traverse(ray, &mut hit, intersect),
        };
        if !found {
            return None;
        }
        let i = hit.primitive_id as usize;
        let barycentric = barycentric(&self.triangles[i], ray.origin + hit.t * ray.direction);
        Some(Hit {
            t: hit.t,
            face: self.faces[i],
            barycentric,
        })
    }

    /// Whether the object itself hides `direction` (unit) from a surface point.
    ///
    /// Directions below the triangle's plane are hidden: they start inside the object.
    #[inline]
    pub fn occluded(&self, point: &SurfacePoint, direction: Vec3) -> bool {
        if direction.dot(point.geometric_normal) <= 0.0 {
            return true;
        }
        self.blocked(offset_origin(point), direction)
    }

    /// Whether anything lies along a half line, at any distance. See [`offset_origin`] for starting on the surface.
    #[inline]
    pub fn blocked(&self, origin: Vec3, direction: Vec3) -> bool {
        let ray = ObvhsRay::new_inf(origin.into(), direction.into());
        let intersect = |ray: &ObvhsRay, i: usize| self.triangles[i].intersect(ray);
        !match &self.tree {
            Tree::Wide(tree) => tree.ray_traverse_miss(ray, intersect),
            Tree::Binary(tree) => tree.ray_traverse_miss(ray, intersect),
        }
    }

    /// [`blocked`](Self::blocked) for many half lines from one place, several at once: those that meet anything are closed.
    pub fn close_blocked(&self, origin: Vec3, rays: Rays<'_>) {
        self.packets.cast(origin, rays);
    }

    /// The surface at a hit of a ray with `direction`.
    ///
    /// Normals face the side that the ray comes from as a whole: the shading normal is turned only when the triangle is
    /// seen from behind, never because interpolation tilted it past the horizon.
    pub fn surface_point(&self, hit: &Hit, direction: Vec3) -> SurfacePoint {
        let indices = self.mesh.faces[hit.face as usize].map(|i| i as usize);
        let weights = [
            1.0 - hit.barycentric.x - hit.barycentric.y,
            hit.barycentric.x,
            hit.barycentric.y,
        ];
        let blend = |values: &[Vec3]| {
            (0..3)
                .map(|k| weights[k] * values[indices[k]])
                .sum::<Vec3>()
        };
        let geometric = self.mesh.face_normal(hit.face as usize);
        let side = if geometric.dot(direction) > 0.0 {
            -1.0
        } else {
            1.0
        };
        let mut normal = blend(&self.mesh.normals)
            .try_normalize()
            .unwrap_or(geometric);
        // A mesh whose winding and vertex normals disagree is lit by the side that the vertex normals name.
        let agree = if geometric.dot(normal) < 0.0 {
            -1.0
        } else {
            1.0
        };
        normal *= side * agree;
        SurfacePoint {
            position: blend(&self.mesh.positions),
            normal,
            geometric_normal: geometric * side,
        }
    }

    /// The surface seen through a place (x, y) of a camera's image, in pixels, with the unit direction towards the camera.
    pub fn seen(&self, camera: &Camera, x: f32, y: f32) -> Option<(SurfacePoint, Vec3)> {
        let ray = camera.ray(x, y);
        let hit = self.closest(ray)?;
        Some((self.surface_point(&hit, ray.direction), -ray.direction))
    }

    /// The share of each pixel that the object covers, by `side` × `side` rays a pixel, row-major.
    pub fn coverage(&self, camera: &Camera, side: usize) -> Vec<f32> {
        use rayon::prelude::*;
        let cell = 1.0 / side as f32;
        let row = |j: usize| {
            (0..camera.width).map(move |i| {
                let hits = (0..side * side).filter(|s| {
                    let x = i as f32 + ((s % side) as f32 + 0.5) * cell;
                    let y = j as f32 + ((s / side) as f32 + 0.5) * cell;
                    let ray = camera.ray(x, y);
                    self.blocked(ray.origin, ray.direction)
                });
                hits.count() as f32 * cell * cell
            })
        };
        (0..camera.height)
            .into_par_iter()
            .flat_map_iter(row)
            .collect()
    }
}

/// A starting place for rays that leave a surface point, safely off its triangle.
///
/// Steps along the triangle's normal by a few hundred units in the last place of the position (the idea of Wächter &
/// Binder, Ray Tracing Gems 2019, ch. 6), which covers the rounding of the intersection.
#[inline]
pub fn offset_origin(point: &SurfacePoint) -> Vec3 {
    let scale = point.position.abs().max_element().max(1e-3);
    point.position + point.geometric_normal * (scale * 512.0 * f32::EPSILON)
}

/// The depth of a tree from the parent of every node; parents come before their children, the root is its own.
fn depth(parents: &[u32]) -> usize {
    let mut depths = vec![0; parents.len()];
    for node in 1..parents.len() {
        depths[node] = depths[parents[node] as usize] + 1;
    }
    depths.into_iter().max().unwrap_or(0)
}

/// Barycentric coordinates of the second and third vertex for a point in a triangle's plane.
fn barycentric(triangle: &Triangle, point: Vec3A) -> Vec2 {
    let (e1, e2, p) = (
        triangle.v1 - triangle.v0,
        triangle.v2 - triangle.v0,
        point - triangle.v0,
    );
    let (d11, d12, d22) = (e1.dot(e1), e1.dot(e2), e2.dot(e2));
    let (p1, p2) = (p.dot(e1), p.dot(e2));
    let determinant = d11 * d22 - d12 * d12;
    if determinant <= 0.0 {
        return Vec2::ZERO;
    }
    let b = Vec2::new(d22 * p1 - d12 * p2, d11 * p2 - d12 * p1) / determinant;
    b.clamp(Vec2::ZERO, Vec2::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lat_long::LatLong;

    fn sphere() -> Mesh {
        let (rows, columns) = (48_u32, 96_u32);
        let mut mesh = Mesh::default();
        for r in 0..=rows {
            for c in 0..columns {
                let d = LatLong::direction(c as f32 / columns as f32, r as f32 / rows as f32);
                mesh.positions.push(d);
                mesh.normals.push(d);
            }
        }
        for r in 0..rows {
            for c in 0..columns {
                let at = |r: u32, c: u32| r * columns + c % columns;
                mesh.faces.push([at(r, c), at(r + 1, c), at(r + 1, c + 1)]);
                mesh.faces.push([at(r, c), at(r + 1, c + 1), at(r, c + 1)]);
            }
        }
        mesh
    }

    #[test]
    fn a_sphere_is_met_where_it_is_with_its_normal() {
        let bvh = Bvh::new(&sphere()).unwrap();
        let origin = Vec3::new(2.0, -3.0, 1.0);
        for target in [Vec3::ZERO, Vec3::new(0.3, 0.2, -0.4)] {
            let ray = Ray {
                origin,
                direction: (target - origin).normalize(),
            };
            let hit = bvh.closest(ray).unwrap();
            let point = bvh.surface_point(&hit, ray.direction);
            assert!((point.position - (origin + hit.t * ray.direction)).length() < 1e-5);
            assert!((point.position.length() - 1.0).abs() < 2e-3);
            assert!(point.normal.dot(point.position) > 0.999);
            assert!(point.geometric_normal.dot(ray.direction) < 0.0);
        }
        assert!(
            bvh.closest(Ray {
                origin,
                direction: Vec3::Z
            })
            .is_none()
        );
    }

    #[test]
    fn a_convex_object_hides_exactly_its_own_side() {
        let bvh = Bvh::new(&sphere()).unwrap();
        let camera = Camera::look_at(32, 32, 0.8, Vec3::new(3.0, 2.0, 1.0), Vec3::ZERO);
        let grid = LatLong::new(20, 40);
        for i in 0..32 {
            let Some((point, _)) = bvh.seen(&camera, i as f32 + 0.5, 15.5) else {
                continue;
            };
            for r in 0..20 {
                for c in 0..40 {
                    let d = grid.texel_direction(r, c);
                    let cosine = d.dot(point.geometric_normal);
                    // Neighbouring facets rise by their 4° tilt; beyond it the answer is certain.
                    if cosine.abs() > 0.07 {
                        assert_eq!(bvh.occluded(&point, d), cosine < 0.0);
                    }
                }
            }
        }
        let coverage = bvh.coverage(&camera, 4);
        assert!(coverage[0] == 0.0 && coverage[15 * 32 + 15] == 1.0);
        let radius = (1.0_f32 / 14.0_f32.sqrt()).asin().tan() * camera.focal[0];
        let area: f32 = coverage.iter().sum();
        assert!(
            (area / (std::f32::consts::PI * radius * radius) - 1.0).abs() < 0.02,
            "{area}"
        );
    }
}
