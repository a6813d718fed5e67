//! Distant illumination: an equirectangular map of radiance, and sampling in proportion to it (paper S8).

use glam::Vec3;
use thiserror::Error;

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

/// Directions drawn in proportion to the interpolated brightness × sin θ.
///
/// S8 takes the nearest texel's brightness; a texel is chosen as it says, but the place is drawn from the tent that bilinear
/// interpolation spreads the texel over. Then a sample's radiance over its density does not vary at all where the light is
/// looked up in the chosen texel alone, and little where it is interpolated.
///
/// Inverts a marginal over rows, then a conditional over columns: unlike an alias table this keeps stratification.
#[derive(Clone, Debug)]
pub struct LightDistribution {
    grid: LatLong,
    /// Cumulative mass up to and including each row.
    rows: Vec<f32>,
    /// Cumulative mass within its row, up to and including each texel.
    columns: Vec<f32>,
    /// Where to start searching `rows`, and each row of `columns`.
    row_guide: Vec<u16>,
    column_guide: Vec<u16>,
    /// Probability of each texel.
    mass: Vec<f32>,
}

/// Texels darker than this share of the mean brightness are drawn as if they had it: interpolation carries a bright
/// neighbour's light into a black texel, which must remain reachable.
const BRIGHTNESS_FLOOR: f64 = 1e-3;

impl LightDistribution {
    /// A distribution from the brightness (sum of the channels, not negative) of each texel.
    pub fn new(grid: LatLong, brightness: &[f32]) -> Self {
        let total: f64 = brightness.iter().map(|&b| f64::from(b)).sum();
        let mean = total / grid.len() as f64;
        let floor = if mean > 0.0 {
            BRIGHTNESS_FLOOR * mean
        } else {
            1.0
        };
        let mut mass = Vec::with_capacity(grid.len());
        for row in 0..grid.rows {
            let sin_theta = ((row as f64 + 0.5) / grid.rows as f64 * std::f64::consts::PI).sin();
            let texels = &brightness[row * grid.columns..][..grid.columns];
            mass.extend(texels.iter().map(|&b| f64::from(b).max(floor) * sin_theta));
        }
        let sum: f64 = mass.iter().sum();
        let mut rows = Vec::with_capacity(grid.rows);
        let mut columns = Vec::with_capacity(grid.len());
        let mut reached = 0.0;
        for texels in mass.chunks_exact(grid.columns) {
            let row_sum: f64 = texels.iter().sum();
            reached += row_sum;
            rows.push((reached / sum) as f32);
            let mut within = 0.0;
            columns.extend(texels.iter().map(|m| {
                within += m;
                (within / row_sum) as f32
            }));
        }
        let mass = mass.iter().map(|m| (m / sum) as f32).collect();
        let row_guide = guide(&rows);
        let column_guide = columns.chunks_exact(grid.columns).flat_map(guide).collect();
        Self {
            row_guide,
            column_guide,
            grid,
            rows,
            columns,
            mass,
        }
    }

    /// The direction at `u` of [0, 1)², and its density per solid angle (1/sr).
    pub fn sample(&self, u: [f32; 2]) -> (Vec3, f32) {
        let light = self.sample_texel(u);
        (light.direction, self.density(light.direction))
    }

    /// The direction at `u` of [0, 1)² together with the texel that was chosen.
    #[inline]
    pub fn sample_texel(&self, u: [f32; 2]) -> LightSample {
        let LatLong { rows, columns } = self.grid;
        let (row, y) = invert(&self.rows, &self.row_guide, u[1]);
        let cumulative = &self.columns[row * columns..][..columns];
        let guide = &self.column_guide[row * columns..][..columns];
        let (column, x) = invert(cumulative, guide, u[0]);
        // Next to a pole there is nothing to interpolate with: the outer half of the tent is flat.
        let down = match (row == 0 && y < 0.5, row + 1 == rows && y >= 0.5) {
            (true, _) | (_, true) => y - 0.5,
            _ => tent(y),
        };
        let u = (column as f32 + 0.5 + tent(x)) / columns as f32;
        let v = (row as f32 + 0.5 + down) / rows as f32;
        let u = if u < 0.0 {
            u + 1.0
        } else if u >= 1.0 {
            u - 1.0
        } else {
            u
        };
        let texel = row * columns + column;
        LightSample {
            direction: LatLong::direction(u, v),
            coordinates: [u, v],
            texel: texel as u32,
        }
    }

    /// The density per solid angle (1/sr) of drawing a unit direction, by whichever texel.
    pub fn density(&self, direction: Vec3) -> f32 {
        self.grid.bilinear(direction).gather(&self.mass) * self.per_solid_angle(direction)
    }

    /// The joint density of a unit direction and a texel over the weight of that texel in the direction's interpolation.
    ///
    /// It is the density to weigh a sample with whose light is looked up in that texel alone, chosen by those weights: they
    /// cancel.
    #[inline]
    pub fn texel_density(&self, texel: u32, direction: Vec3) -> f32 {
        self.mass[texel as usize] * self.per_solid_angle(direction)
    }

    /// The probability of each texel.
    pub fn mass(&self) -> &[f32] {
        &self.mass
    }

    /// Texels per solid angle at a direction.
    #[inline]
    fn per_solid_angle(&self, direction: Vec3) -> f32 {
        use std::f32::consts::PI;
        let sin_theta = (direction.x * direction.x + direction.y * direction.y)
            .sqrt()
            .max(1e-6);
        self.grid.len() as f32 / (2.0 * PI * PI * sin_theta)
    }
}

/// A direction drawn from a [`LightDistribution`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// The unit direction.
    pub direction: Vec3,
    /// Its (u, v) on the grid.
    pub coordinates: [f32; 2],
    /// The texel chosen: one of the four that interpolation reads there.
    pub texel: u32,
}

/// The place of [−1, 1] at which the tent 1 − |x| has accumulated the share `u`.
#[inline]
fn tent(u: f32) -> f32 {
    if u < 0.5 {
        (2.0 * u).sqrt() - 1.0
    } else {
        1.0 - (2.0 - 2.0 * u).sqrt()
    }
}

/// For each k, the first cell whose cumulative mass exceeds k/n: a search that starts there takes about one step where
/// bisection would mispredict seven branches (Chen & Asau 1974).
fn guide(cumulative: &[f32]) -> Vec<u16> {
    let n = cumulative.len();
    let start = |k: usize| {
        cumulative
            .partition_point(|&c| c <= k as f32 / n as f32)
            .min(n - 1)
    };
    (0..n).map(|k| start(k) as u16).collect()
}

/// The cell of a cumulative distribution that holds `u` of [0, 1), and the place of `u` within it, of [0, 1).
#[inline]
fn invert(cumulative: &[f32], guide: &[u16], u: f32) -> (usize, f32) {
    let last = cumulative.len() - 1;
    let mut cell = usize::from(guide[((u * guide.len() as f32) as usize).min(last)]);
    // Rounding of u · n may have started one cell too far.
    while cell > 0 && cumulative[cell - 1] > u {
        cell -= 1;
    }
    while cell < last && cumulative[cell] <= u {
        cell += 1;
    }
    let below = if cell == 0 { 0.0 } else { cumulative[cell - 1] };
    let width = cumulative[cell] - below;
    let place = if width > 0.0 {
        ((u - below) / width).clamp(0.0, 1.0 - f32::EPSILON)
    } else {
        0.5
    };
    (cell, place)
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
