//! Light samples.

use glam::Vec3;

use crate::lat_long::LatLong;

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
        let cell = self.cell(u);
        let [u, v] = self.coordinates(cell);
        LightSample {
            direction: LatLong::direction(u, v),
            coordinates: [u, v],
            texel: (cell.row as usize * self.grid.columns + cell.column as usize) as u32,
        }
    }

    /// The texel at `u` of [0, 1)², and the place within it.
    #[inline]
    pub(crate) fn cell(&self, u: [f32; 2]) -> Cell {
        let columns = self.grid.columns;
        let (row, y) = invert(&self.rows, &self.row_guide, u[1]);
        let cumulative = &self.columns[row * columns..][..columns];
        let guide = &self.column_guide[row * columns..][..columns];
        let (column, x) = invert(cumulative, guide, u[0]);
        Cell {
            row: row as u32,
            column: column as u32,
            place: [x, y],
        }
    }

    /// The grid coordinates that a cell's texel is drawn at.
    #[inline(always)]
    pub(crate) fn coordinates(&self, cell: Cell) -> [f32; 2] {
        let LatLong { rows, columns } = self.grid;
        let [x, y] = cell.place;
        // Next to a pole there is nothing to interpolate with: the outer half of the tent is flat.
        let top = (cell.row == 0) & (y < 0.5);
        let bottom = (cell.row + 1 == rows as u32) & (y >= 0.5);
        let down = if top | bottom { y - 0.5 } else { tent(y) };
        let u = (cell.column as i32 as f32 + 0.5 + tent(x)) / columns as f32;
        let v = (cell.row as i32 as f32 + 0.5 + down) / rows as f32;
        let turns = if u < 0.0 { 1.0 } else { 0.0 } - if u >= 1.0 { 1.0 } else { 0.0 };
        [u + turns, v]
    }

    /// The density per solid angle (1/sr) of drawing a unit direction, by whichever texel.
    pub fn density(&self, direction: Vec3) -> f32 {
        self.grid.bilinear(direction).gather(&self.mass) * self.per_solid_angle(direction)
    }

    /// The probability of each texel.
    pub fn mass(&self) -> &[f32] {
        &self.mass
    }

    /// Texels per solid angle at a direction.
    #[inline(always)]
    pub(crate) fn per_solid_angle(&self, direction: Vec3) -> f32 {
        use std::f32::consts::PI;
        let sin_theta = (direction.x * direction.x + direction.y * direction.y)
            .sqrt()
            .max(1e-6);
        self.grid.len() as f32 / (2.0 * PI * PI) / sin_theta
    }
}

/// A texel and a place of [0, 1)² (across, down) by which it is drawn from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cell {
    pub(crate) row: u32,
    pub(crate) column: u32,
    pub(crate) place: [f32; 2],
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
#[inline(always)]
fn tent(u: f32) -> f32 {
    let rising = u < 0.5;
    let root = (2.0 * if rising { u } else { 1.0 - u }).sqrt();
    if rising { root - 1.0 } else { 1.0 - root }
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
