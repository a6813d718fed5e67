//! Scenes of our own in which nothing of the table happens, under light finer than any grid of the model.

use glam::Vec3;
use render::{bsdf::Model, image::Image, lat_long::LatLong, mesh::Mesh, sampler::SampleKey};

use crate::synthesize::{Occluders, Pattern, Scene, Shooting};

/// Rows of the light: four times those of the reconstruction's grid.
const LIGHT_ROWS: usize = 200;
/// Rows of the body's vertices.
const BODY_ROWS: u32 = 96;
/// Lumps on the body.
const LUMPS: usize = 9;

/// Another body, light and material for every seed, and how they are photographed.
pub fn scene(seed: u64) -> (Scene, Shooting) {
    let draw = |what: u32, k: usize| {
        let key = SampleKey {
            seed,
            frame: what,
            pixel: k as u32,
            ..SampleKey::default()
        };
        key.stream().uniform()
    };
    let direction = |what: u32, k: usize| {
        let z = 2.0 * draw(what, 2 * k) - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * draw(what, 2 * k + 1)).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    };
    let lumps: Vec<(Vec3, f32)> = (0..LUMPS)
        .map(|k| (direction(0, k), 0.5 * draw(1, k) - 0.15))
        .collect();
    let lamps: Vec<(Vec3, f32, [f32; 3])> = (0..6)
        .map(|k| {
            let size = 0.03 + 0.25 * draw(3, k).powi(2);
            let power = 0.3 * draw(4, k) / (size * size);
            let tint = |c: usize| power * (0.7 + 0.6 * draw(5, 3 * k + c));
            (direction(2, k), size, std::array::from_fn(tint))
        })
        .collect();
    let scene = Scene {
        mesh: body(&lumps),
        environment: light(&lamps, 0.1 + 0.3 * draw(6, 0)),
        model: Model::Microfacet,
        albedo: Pattern {
            mean: std::array::from_fn(|c| 0.3 + 0.35 * draw(7, c)),
            variation: 0.2,
        },
        alpha: 0.3 + 0.4 * draw(8, 0),
        kappa: 0.04,
        occluders: Occluders::None,
    };
    let shooting = Shooting {
        frames: 24,
        resolution: 96,
        distance: 5.0,
        noise: 0.004,
        seed,
    };
    (scene, shooting)
}

/// A ball with lumps and hollows.
fn body(lumps: &[(Vec3, f32)]) -> Mesh {
    let mut mesh = Mesh::sphere(Vec3::ZERO, 1.0, BODY_ROWS);
    for position in &mut mesh.positions {
        let d = *position;
        let lump = |(at, height): &(Vec3, f32)| height * (6.0 * (d.dot(*at) - 1.0)).exp();
        *position = d * (1.0 + lumps.iter().map(lump).sum::<f32>());
    }
    // Those of the ball are no longer right; they are made anew from the faces.
    mesh.normals.clear();
    mesh
}

/// Lamps with sharp edges in a sky that darkens downwards and has fine ripples.
fn light(lamps: &[(Vec3, f32, [f32; 3])], sky: f32) -> Image {
    let grid = LatLong::new(LIGHT_ROWS, 2 * LIGHT_ROWS);
    let mut image = Image::filled(grid.columns, grid.rows, 3, 0.0);
    for (texel, pixel) in image.data.chunks_exact_mut(3).enumerate() {
        let d = grid.texel_direction(texel / grid.columns, texel % grid.columns);
        let ripples = 1.0 + 0.5 * (41.0 * d.x + 23.0 * d.z).sin() * (37.0 * d.y - 11.0 * d.x).sin();
        for c in 0..3 {
            pixel[c] = sky * (0.4 + 0.6 * (0.5 + 0.5 * d.z)) * ripples;
        }
        for (at, size, radiance) in lamps {
            if (d - *at).length() < *size {
                (0..3).for_each(|c| pixel[c] += radiance[c]);
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_can_be_rendered_and_differ() {
        let (first, _) = scene(1);
        let (second, shooting) = scene(2);
        for made in [&first, &second] {
            let mut mesh = made.mesh.clone();
            mesh.ensure_normals();
            mesh.validate().expect("a body without defects");
            let data = &made.environment.data;
            assert!(data.iter().all(|v| v.is_finite() && *v > 0.0));
            let mean = data.iter().sum::<f32>() / data.len() as f32;
            let most = data.iter().fold(0.0f32, |m, v| m.max(*v));
            assert!(most > 3.0 * mean, "lamps stand out: {most} over {mean}");
        }
        assert!(first.mesh.positions != second.mesh.positions);
        assert!(shooting.frames >= 20);
    }
}
