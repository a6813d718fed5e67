//! A sphere of radius 1 that hides nothing of itself, in closed form: matt or a rough mirror, under any map of light and an
//! occluder on a shell.

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bsdf::{Material, Model},
    camera::Camera,
    environment::EnvironmentMap,
    image::Image,
    lat_long::LatLong,
    math::Frame,
    occluder::mask_lookup,
    reference::Mask,
    sampler::Stratified,
    warp::{ggx_visible_normal, ggx_visible_normal_density, reflect},
};

/// Rays that a mirror's lobe is made of.
const RAYS: usize = 64;

/// What the sphere is made of.
#[derive(Clone, Copy, Debug)]
pub(super) enum Surface {
    /// Lambertian, of this albedo.
    Matt(f32),
    /// A metal of this roughness α (S3) that reflects everything at normal incidence.
    Mirror(f32),
}

/// A photograph of the sphere: RGB, black where it is not.
pub(super) fn photograph(
    camera: &Camera,
    surface: Surface,
    light: &EnvironmentMap,
    mask: Option<Mask<'_>>,
) -> Image {
    let mut image = Image::filled(camera.width, camera.height, 3, 0.0);
    let pixels = image.data.par_chunks_exact_mut(3).enumerate();
    pixels.for_each(|(p, out)| {
        if let Some(normal) = seen(camera, p) {
            let outgoing = (camera.centre() - normal).normalize();
            out.copy_from_slice(&match surface {
                Surface::Matt(albedo) => {
                    irradiance(normal, light, mask).map(|e| albedo / std::f32::consts::PI * e)
                }
                Surface::Mirror(alpha) => mirrored(normal, outgoing, alpha, |direction| {
                    let passed = passed(mask, normal, direction);
                    light.radiance(direction).map(|l| l * passed)
                }),
            });
        }
    });
    image
}

/// The normal, and place, of the sphere in the middle of a pixel.
fn seen(camera: &Camera, pixel: usize) -> Option<Vec3> {
    let (x, y) = (pixel % camera.width, pixel / camera.width);
    let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
    let along = ray.origin.dot(ray.direction);
    let inside = along * along - ray.origin.length_squared() + 1.0;
    (inside > 0.0).then(|| ray.origin + (-along - inside.sqrt()) * ray.direction)
}

/// How far the sphere in each pixel faces the camera, n·v; 0 where it is not seen.
pub(super) fn facing(camera: &Camera) -> Vec<f32> {
    let of = |pixel| {
        seen(camera, pixel).map_or(0.0, |normal| {
            normal.dot((camera.centre() - normal).normalize())
        })
    };
    (0..camera.width * camera.height).map(of).collect()
}

/// ∫ L M (n·ω)₊ dω by the light's own grid.
pub(super) fn irradiance(normal: Vec3, light: &EnvironmentMap, mask: Option<Mask<'_>>) -> [f32; 3] {
    let grid = light.grid();
    let mut sum = [0.0; 3];
    for row in 0..grid.rows {
        let solid_angle = grid.solid_angle(row);
        for column in 0..grid.columns {
            let direction = grid.texel_direction(row, column);
            let cosine = normal.dot(direction);
            if cosine > 0.0 {
                let weight = solid_angle * cosine * passed(mask, normal, direction);
                let texel = light.image().pixel(column, row);
                for c in 0..3 {
                    sum[c] += weight * texel[c];
                }
            }
        }
    }
    sum
}

fn passed(mask: Option<Mask<'_>>, point: Vec3, direction: Vec3) -> f32 {
    mask.map_or(1.0, |mask| {
        let map = mask.transmittance;
        let grid = LatLong::new(map.height, map.width);
        mask_lookup(grid, point, direction, mask.radius).gather(&map.data)
    })
}

/// What a mirror of roughness α reflects of `light`, by stratified visible normals.
pub(super) fn mirrored(
    normal: Vec3,
    outgoing: Vec3,
    alpha: f32,
    light: impl Fn(Vec3) -> [f32; 3],
) -> [f32; 3] {
    let material = Material {
        albedo: [0.0; 3],
        alpha,
        kappa: 1.0,
    };
    let frame = Frame::new(normal);
    let local = frame.to_local(outgoing);
    let set = Stratified::new(RAYS);
    let mut sum = [0.0; 3];
    for i in 0..RAYS {
        let half = ggx_visible_normal(set.point(i, [0.5, 0.5]), local, alpha);
        let incident = reflect(local, half);
        if incident.z <= 0.0 {
            continue;
        }
        let density = ggx_visible_normal_density(incident, local, alpha);
        let direction = frame.to_world(incident);
        let reflectance = Model::Microfacet.evaluate(&material, normal, direction, outgoing);
        let radiance = light(direction);
        for c in 0..3 {
            sum[c] += radiance[c] * reflectance[c] * incident.z / (density * RAYS as f32);
        }
    }
    sum
}

/// The normal at which the camera sees the mirror image of a direction; for the few directions that the sphere itself hides
/// from it, the nearest there is.
pub(super) fn mirror_normal(camera: &Camera, direction: Vec3) -> Vec3 {
    let eye = camera.centre();
    let mut outgoing = eye.normalize();
    let mut normal = outgoing;
    for _ in 0..40 {
        normal = (direction + outgoing).try_normalize().unwrap_or(normal);
        outgoing = (eye - normal).normalize();
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::look_at(24, 24, 0.55, Vec3::new(3.0, -2.0, 1.5), Vec3::ZERO)
    }

    fn uniform() -> EnvironmentMap {
        EnvironmentMap::new(Image::filled(100, 50, 3, 0.5)).unwrap()
    }

    #[test]
    fn a_matt_sphere_in_a_furnace_shows_its_albedo() {
        let image = photograph(&camera(), Surface::Matt(0.8), &uniform(), None);
        let centre = image.pixel(12, 12);
        assert!((centre[0] - 0.4).abs() < 2e-3, "{centre:?}");
        assert_eq!(image.pixel(0, 0), [0.0; 3]);
    }

    #[test]
    fn the_camera_sees_a_direction_at_its_mirror_normal() {
        let camera = camera();
        for direction in [Vec3::X, Vec3::Z, Vec3::new(0.3, -0.9, 0.1).normalize()] {
            let normal = mirror_normal(&camera, direction);
            let outgoing = (camera.centre() - normal).normalize();
            assert!((reflect(outgoing, normal) - direction).length() < 1e-4);
        }
    }

    #[test]
    fn a_smooth_mirror_shows_the_light_itself() {
        let camera = camera();
        let direction = Vec3::new(0.6, 0.2, 0.5).normalize();
        let normal = mirror_normal(&camera, direction);
        let outgoing = (camera.centre() - normal).normalize();
        let light = |d: Vec3| [d.x + 2.0, d.y + 2.0, 1.0];
        let [x, y, one] = mirrored(normal, outgoing, 0.02, light);
        assert!((x / one - direction.x - 2.0).abs() < 5e-3);
        assert!((y / one - direction.y - 2.0).abs() < 5e-3);
        assert!(one > 0.7 && one < 1.01, "{one}");
    }
}
