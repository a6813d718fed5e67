//! Distant illumination: an equirectangular map of radiance, and sampling in proportion to it (paper S8).

mod light;

use glam::Vec3;
use thiserror::Error;

pub(crate) use light::Cell;
pub use light::{LightDistribution, LightSample};

use crate::image::Image;
use crate::lat_long::LatLong;

/// A map that cannot light a scene.
#[derive(Debug, Error, PartialEq)]
pub enum EnvironmentError {
    /// Wrong channels or size.
    #[error(
        "the environment map is {width} x {height} with {channels} channels and {values} values; \
         expected at least 1 x 1 pixels of 3 channels: convert it to RGB"
    )]
    Shape {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Values per pixel.
        channels: usize,
        /// Values in all.
        values: usize,
    },
    /// Radiance that is negative, infinite or not a number.
    #[error(
        "the environment map's pixel in column {x} of row {y} is {value}; radiance must be finite and not negative: \
         repair the map or clamp it"
    )]
    Radiance {
        /// Column.
        x: usize,
        /// Row from the top.
        y: usize,
        /// The value found.
        value: f32,
    },
}

/// Radiance arriving from every direction, RGB, on the grid of [`LatLong`], with a distribution to draw light from.
#[derive(Clone, Debug)]
pub struct EnvironmentMap {
    image: Image,
    grid: LatLong,
    distribution: LightDistribution,
}

impl EnvironmentMap {
    /// A map from an RGB image in the convention of [`LatLong`].
    ///
    /// # Errors
    /// When the image is not RGB, empty, or holds a value that is negative or not finite.
    pub fn new(image: Image) -> Result<Self, EnvironmentError> {
        let Image {
            width,
            height,
            channels,
            ref data,
        } = image;
        if channels != 3 || width == 0 || height == 0 || data.len() != width * height * 3 {
            return Err(EnvironmentError::Shape {
                width,
                height,
                channels,
                values: data.len(),
            });
        }
        if let Some(i) = data.iter().position(|v| !v.is_finite() || *v < 0.0) {
            return Err(EnvironmentError::Radiance {
                x: i / 3 % width,
                y: i / 3 / width,
                value: data[i],
            });
        }
        let grid = LatLong::new(height, width);
        let brightness: Vec<f32> = data.chunks_exact(3).map(|rgb| rgb.iter().sum()).collect();
        let distribution = LightDistribution::new(grid, &brightness);
        Ok(Self {
            image,
            grid,
            distribution,
        })
    }

    /// The map's pixels.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// The map's grid.
    pub fn grid(&self) -> LatLong {
        self.grid
    }

    /// Radiance from a unit direction, interpolated bilinearly.
    pub fn radiance(&self, direction: Vec3) -> [f32; 3] {
        let lookup = self.grid.bilinear(direction);
        let mut rgb = [0.0; 3];
        for k in 0..4 {
            let texel = &self.image.data[3 * lookup.index[k] as usize..][..3];
            for c in 0..3 {
                rgb[c] += lookup.weight[k] * texel[c];
            }
        }
        rgb
    }

    /// The distribution of light samples.
    pub fn distribution(&self) -> &LightDistribution {
        &self.distribution
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> EnvironmentMap {
        let mut image = Image::filled(16, 8, 3, 0.1);
        image.pixel_mut(3, 2).copy_from_slice(&[5.0, 4.0, 1.0]);
        image.pixel_mut(12, 6).copy_from_slice(&[0.0, 0.0, 0.0]);
        EnvironmentMap::new(image).unwrap()
    }

    #[test]
    fn densities_of_samples_agree_and_integrate_to_one() {
        let map = map();
        let set = crate::sampler::Stratified::new(4096);
        for i in 0..4096 {
            let (direction, density) = map.distribution().sample(set.point(i, [0.37, 0.61]));
            assert!((map.distribution().density(direction) / density - 1.0).abs() < 1e-3);
        }
        let fine = LatLong::new(200, 400);
        let mut integral = 0.0;
        for r in 0..200 {
            for c in 0..400 {
                integral +=
                    map.distribution().density(fine.texel_direction(r, c)) * fine.solid_angle(r);
            }
        }
        assert!((integral - 1.0).abs() < 2e-3, "{integral}");
    }

    #[test]
    fn texels_are_chosen_by_their_masses_and_read_by_interpolation() {
        let map = map();
        let mut counts = vec![0.0; 128];
        let n = 1 << 16;
        let set = crate::sampler::Stratified::new(n);
        let mut stream = crate::sampler::SampleKey::default().stream();
        for i in 0..n {
            let light = map
                .distribution()
                .sample_texel(set.point(i, stream.uniform_2d()));
            counts[light.texel as usize] += 1.0 / n as f32;
            let [u, v] = light.coordinates;
            assert!((0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v));
            assert!(
                map.grid().bilinear_at(u, v).index.contains(&light.texel),
                "{light:?}"
            );
        }
        for (count, mass) in counts.iter().zip(map.distribution().mass()) {
            assert!(
                (count - mass).abs() < 5.0 * (mass / n as f32).sqrt(),
                "{count} {mass}"
            );
        }
    }

    #[test]
    fn bad_maps_are_refused() {
        assert!(matches!(
            EnvironmentMap::new(Image::filled(4, 2, 1, 1.0)),
            Err(EnvironmentError::Shape { .. })
        ));
        let mut image = Image::filled(4, 2, 3, 1.0);
        image.pixel_mut(2, 1)[1] = f32::NAN;
        let error = EnvironmentMap::new(image).unwrap_err().to_string();
        assert!(error.contains("column 2 of row 1"), "{error}");
    }
}
