//! Albedo over a synthetic object.

use glam::Vec3;
use render::{bvh::Bvh, camera::Camera, image::Image};

/// A mean colour with smooth patches around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pattern {
    /// Mean albedo, linear RGB in [0, 1].
    pub mean: [f32; 3],
    /// Largest departure from the mean; the result is kept within [0, 1].
    pub variation: f32,
}

impl Pattern {
    /// The albedo at a point scaled to the unit ball.
    pub fn at(&self, point: Vec3) -> [f32; 3] {
        std::array::from_fn(|channel| {
            // Waves of incommensurable directions, different for each channel, repeat nowhere on the object.
            let shift = channel as f32 * 2.1;
            let wave =
                |direction: Vec3, frequency: f32| (frequency * direction.dot(point) + shift).sin();
            let patches = wave(Vec3::new(0.8, 0.36, 0.48), 5.0)
                + wave(Vec3::new(-0.28, 0.96, 0.1), 7.3)
                + wave(Vec3::new(0.1, -0.6, 0.79), 11.7);
            (self.mean[channel] + self.variation * patches / 3.0).clamp(0.0, 1.0)
        })
    }
}

/// The mean albedo of what each pixel sees of the object, black elsewhere.
pub(super) fn through(
    bvh: &Bvh,
    camera: &Camera,
    side: usize,
    albedo: impl Fn(Vec3) -> [f32; 3],
) -> Image {
    let mut image = Image::filled(camera.width, camera.height, 3, 0.0);
    for (index, pixel) in image.data.chunks_exact_mut(3).enumerate() {
        let (x, y) = ((index % camera.width) as f32, (index / camera.width) as f32);
        let mut seen = 0.0;
        for part in 0..side * side {
            let across = ((part % side) as f32 + 0.5) / side as f32;
            let down = ((part / side) as f32 + 0.5) / side as f32;
            if let Some((point, _)) = bvh.seen(camera, x + across, y + down) {
                let albedo = albedo(point.position);
                (0..3).for_each(|channel| pixel[channel] += albedo[channel]);
                seen += 1.0;
            }
        }
        pixel
            .iter_mut()
            .for_each(|value| *value /= f32::max(seen, 1.0));
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_vary_within_their_bounds() {
        let pattern = Pattern {
            mean: [0.5, 0.2, 0.9],
            variation: 0.3,
        };
        let samples: Vec<[f32; 3]> = (0..1000)
            .map(|i| {
                pattern.at(Vec3::new(
                    (i as f32).sin(),
                    (2.3 * i as f32).cos(),
                    (0.7 * i as f32).sin(),
                ))
            })
            .collect();
        for channel in 0..3 {
            let values = samples.iter().map(|sample| sample[channel]);
            let (low, high) = (
                values.clone().fold(1.0, f32::min),
                values.fold(0.0, f32::max),
            );
            assert!(
                low >= 0.0 && high <= 1.0 && high - low > 0.25,
                "{low} {high}"
            );
        }
        let plain = Pattern {
            variation: 0.0,
            ..pattern
        };
        assert_eq!(plain.at(Vec3::X), plain.mean);
    }
}
