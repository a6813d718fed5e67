//! Small scenes with known answers.

use glam::Vec3;
use render::bvh::Bvh;
use render::camera::Camera;
use render::environment::EnvironmentMap;
use render::image::Image;
use render::lat_long::LatLong;
use render::mesh::Mesh;

/// Appends a sphere of `rows` × 2 `rows` quadrilaterals with exact normals.
pub fn add_sphere(mesh: &mut Mesh, centre: Vec3, radius: f32, rows: u32) {
    mesh.append(&Mesh::sphere(centre, radius, rows));
}

/// A convex object: it casts no shadow on its own lit side.
pub fn sphere() -> Bvh {
    let mut mesh = Mesh::default();
    add_sphere(&mut mesh, Vec3::ZERO, 1.0, 64);
    Bvh::new(&mesh).expect("a sphere is a valid mesh")
}

/// Two spheres that shade each other.
pub fn pair() -> Bvh {
    let mut mesh = Mesh::default();
    add_sphere(&mut mesh, Vec3::new(-0.4, 0.0, 0.0), 0.5, 48);
    add_sphere(&mut mesh, Vec3::new(0.45, 0.1, 0.2), 0.4, 48);
    Bvh::new(&mesh).expect("two spheres are a valid mesh")
}

/// A camera that sees the middle of [`pair`] and [`sphere`].
pub fn camera(size: usize) -> Camera {
    Camera::look_at(size, size, 0.6, Vec3::new(1.0, -3.0, 1.2), Vec3::ZERO)
}

/// A map with a smooth sky, a window and a lamp: a few decades of radiance, different in each channel.
pub fn interior(grid: LatLong) -> EnvironmentMap {
    let mut image = Image::filled(grid.columns, grid.rows, 3, 0.0);
    for r in 0..grid.rows {
        for c in 0..grid.columns {
            let d = grid.texel_direction(r, c);
            let window = if d.dot(Vec3::new(0.3, -0.8, 0.4).normalize()) > 0.9 {
                4.0
            } else {
                0.0
            };
            let lamp = if d.dot(Vec3::new(-0.7, -0.2, 0.6).normalize()) > 0.98 {
                30.0
            } else {
                0.0
            };
            let sky = 0.3 + 0.2 * d.z;
            image.pixel_mut(c, r).copy_from_slice(&[
                sky + window + lamp,
                sky + window,
                0.5 * sky + 1.5 * window,
            ]);
        }
    }
    EnvironmentMap::new(image).expect("radiance is finite and positive")
}

/// A map of one radiance from everywhere.
pub fn furnace(radiance: f32) -> EnvironmentMap {
    EnvironmentMap::new(Image::filled(40, 20, 3, radiance))
        .expect("radiance is finite and positive")
}

/// A mask whose blocked region is a soft disc around `axis`.
pub fn disc_mask(grid: LatLong, axis: Vec3) -> Image {
    let mut image = Image::filled(grid.columns, grid.rows, 1, 1.0);
    for r in 0..grid.rows {
        for c in 0..grid.columns {
            let x = 20.0 * (grid.texel_direction(r, c).dot(axis) - 0.8);
            image.pixel_mut(c, r)[0] = 1.0 / (1.0 + x.exp());
        }
    }
    image
}
