//! The lights of the two explanations, and what stands in them.

use std::f32::consts::PI;

use glam::Vec3;
use render::{
    camera::Camera,
    environment::EnvironmentMap,
    harmonics::{Harmonics, coefficient},
    image::Image,
};

use super::{
    super::sphere::{irradiance, mirror_normal, mirrored},
    ALBEDO, ALPHA, GRID, LEAST, LOW, OCCLUDER,
};

/// A direction at a height z and an azimuth.
pub(super) fn around(z: f32, azimuth: f32) -> Vec3 {
    let horizontal = (1.0 - z * z).sqrt();
    Vec3::new(horizontal * azimuth.cos(), horizontal * azimuth.sin(), z)
}

/// Turned about the vertical.
pub(super) fn rotated(direction: Vec3, angle: f32) -> Vec3 {
    let azimuth = direction.y.atan2(direction.x) + angle;
    around(direction.z, azimuth)
}

/// Two dozen coloured lamps in a dim room, none larger than the grid's texels allow to be sharp.
pub(super) fn lamps(uniform: &mut impl FnMut() -> f32) -> EnvironmentMap {
    let lamps: Vec<(Vec3, [f32; 3])> = (0..24)
        .map(|_| {
            let direction = around(2.0 * uniform() - 1.0, 2.0 * PI * uniform());
            let power = 4.0 + 16.0 * uniform();
            (direction, [0; 3].map(|_| power * (0.4 + 0.6 * uniform())))
        })
        .collect();
    map(|direction| {
        let mut sum = [0.15; 3];
        for (lamp, power) in &lamps {
            let near = ((direction.dot(*lamp) - 1.0) / 0.008).exp();
            for c in 0..3 {
                sum[c] += power[c] * near;
            }
        }
        sum
    })
}

/// The light in which a mirror looks as the matt sphere does in `sharp`: in each direction what the matt sphere shows where the
/// mirror would reflect it.
pub(super) fn blurred(camera: &Camera, sharp: &EnvironmentMap) -> EnvironmentMap {
    map(|direction| {
        let normal = mirror_normal(camera, direction);
        let outgoing = (camera.centre() - normal).normalize();
        // The model's mirror darkens towards the rim; beyond this it reflects too little to divide by.
        let [reflected, ..] = mirrored(normal, outgoing, ALPHA, |_| [1.0; 3]);
        irradiance(normal, sharp, None).map(|e| ALBEDO / PI * e / reflected.max(LEAST))
    })
}

pub(super) fn disc(axis: Vec3) -> Image {
    let mut mask = Image::filled(GRID.columns, GRID.rows, 1, 1.0);
    for (texel, value) in mask.data.iter_mut().enumerate() {
        let direction = GRID.texel_direction(texel / GRID.columns, texel % GRID.columns);
        if direction.dot(axis) > OCCLUDER.cos() {
            *value = 0.0;
        }
    }
    mask
}

pub(super) fn map(radiance: impl Fn(Vec3) -> [f32; 3]) -> EnvironmentMap {
    let data = (0..GRID.len())
        .flat_map(|t| radiance(GRID.texel_direction(t / GRID.columns, t % GRID.columns)))
        .collect();
    let image = Image {
        width: GRID.columns,
        height: GRID.rows,
        channels: 3,
        data,
    };
    let Ok(map) = EnvironmentMap::new(image) else {
        unreachable!("sums of positive radiance are radiance");
    };
    map
}

/// The share of a map's variance in spherical harmonics above degree [`LOW`].
pub(super) fn detail(map: &Image) -> f64 {
    let harmonics = Harmonics::<f64>::new(LOW, GRID);
    let grey: Vec<f64> = map
        .data
        .chunks_exact(3)
        .map(|p| f64::from(p.iter().sum::<f32>()))
        .collect();
    let weight = |t: usize| f64::from(GRID.solid_angle(t / GRID.columns));
    let weighted: Vec<f64> = grey
        .iter()
        .enumerate()
        .map(|(t, v)| weight(t) * v)
        .collect();
    let mut coefficients = vec![0.0; harmonics.coefficients()];
    harmonics.transpose(&weighted, &mut coefficients, 1);
    let energy: f64 = grey.iter().zip(&weighted).map(|(v, w)| v * w).sum();
    let mean = coefficients[coefficient(0, 0)].powi(2);
    let low: f64 = coefficients.iter().map(|c| c * c).sum();
    (energy - low) / (energy - mean)
}
