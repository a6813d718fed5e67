//! What several effects need: image operations, images' values between pixels, coarse grids of directions, lamps that move.

use std::f32::consts::PI;

use glam::Vec3;
use render::image::Image;

use crate::criticism::{
    horizon::{Source, arriving},
    scene::Scene,
    transport::reflect,
};

/// The Gaussian blur of an image by `sigma` pixels; beyond the border there is what is on it.
pub fn blurred(image: &Image, sigma: f32) -> Image {
    let reach = (3.0 * sigma).ceil().max(1.0) as isize;
    let mut kernel: Vec<f32> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp())
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let pass = |image: &Image, dx: isize, dy: isize| {
        let mut out = Image::filled(image.width, image.height, image.channels, 0.0);
        let clamp = |v: isize, size: usize| v.clamp(0, size as isize - 1) as usize;
        for y in 0..image.height {
            for x in 0..image.width {
                for (k, weight) in (-reach..=reach).zip(&kernel) {
                    let i = clamp(x as isize + k * dx, image.width);
                    let j = clamp(y as isize + k * dy, image.height);
                    let source = image.pixel(i, j);
                    out.pixel_mut(x, y)
                        .iter_mut()
                        .zip(source)
                        .for_each(|(o, s)| *o += weight * s);
                }
            }
        }
        out
    };
    pass(&pass(image, 1, 0), 0, 1)
}

/// [`blurred`] for wide kernels: on an image reduced so far that the kernel still spans many of its pixels, then enlarged.
pub fn widely_blurred(image: &Image, sigma: f32) -> Image {
    let step = (sigma / WIDE) as usize;
    if step < 2 {
        return blurred(image, sigma);
    }
    let small = reduced(image, step);
    // Boxes and the lines between their middles blur as well: their variances are not asked for twice.
    let side = step as f32;
    let left = (sigma / side).powi(2) - 1.0 / 12.0 - 1.0 / 6.0;
    let soft = blurred(&small, left.sqrt());
    let mut out = Image::filled(image.width, image.height, image.channels, 0.0);
    for (p, pixel) in out.data.chunks_exact_mut(image.channels).enumerate() {
        let (i, j) = (p % image.width, p / image.width);
        let at = [i, j].map(|k| (k as f32 + 0.5) / side);
        pixel.copy_from_slice(&sample(&soft, at)[..image.channels]);
    }
    out
}

/// Pixels of a reduced image that a wide kernel's standard deviation spans.
const WIDE: f32 = 8.0;

/// Means of squares of `step` pixels; those at the borders hold what there is.
fn reduced(image: &Image, step: usize) -> Image {
    let (width, height) = (image.width.div_ceil(step), image.height.div_ceil(step));
    let mut out = Image::filled(width, height, image.channels, 0.0);
    for y in 0..height {
        for x in 0..width {
            let columns = x * step..((x + 1) * step).min(image.width);
            let rows = y * step..((y + 1) * step).min(image.height);
            let count = (columns.len() * rows.len()) as f32;
            let target = out.pixel_mut(x, y);
            for (i, j) in rows.flat_map(|j| columns.clone().map(move |i| (i, j))) {
                let source = image.pixel(i, j);
                target
                    .iter_mut()
                    .zip(source)
                    .for_each(|(t, s)| *t += s / count);
            }
        }
    }
    out
}

/// The first three channels at the place (x, y), pixel corners at integers, bilinearly.
pub fn sample(image: &Image, at: [f32; 2]) -> [f32; 3] {
    [0, 1, 2].map(between(image, at))
}

/// Each channel at the place (x, y), likewise.
pub fn between(image: &Image, [x, y]: [f32; 2]) -> impl Fn(usize) -> f32 {
    let u = (x - 0.5).clamp(0.0, image.width as f32 - 1.0);
    let v = (y - 0.5).clamp(0.0, image.height as f32 - 1.0);
    let (i, j) = (u as usize, v as usize);
    let (fx, fy) = (u - i as f32, v - j as f32);
    let (i1, j1) = ((i + 1).min(image.width - 1), (j + 1).min(image.height - 1));
    move |c| {
        (1.0 - fy) * ((1.0 - fx) * image.pixel(i, j)[c] + fx * image.pixel(i1, j)[c])
            + fy * ((1.0 - fx) * image.pixel(i, j1)[c] + fx * image.pixel(i1, j1)[c])
    }
}

/// Central differences of an image at a place, across and down.
pub fn gradient(image: &Image, [x, y]: [f32; 2]) -> ([f32; 3], [f32; 3]) {
    let (left, right) = (sample(image, [x - 0.7, y]), sample(image, [x + 0.7, y]));
    let (up, down) = (sample(image, [x, y - 0.7]), sample(image, [x, y + 0.7]));
    (
        [0, 1, 2].map(|c| (right[c] - left[c]) / 1.4),
        [0, 1, 2].map(|c| (down[c] - up[c]) / 1.4),
    )
}

/// The place of a direction on a grid that turns with the camera: azimuth from the camera's, and height, in cells.
///
/// Cells around the camera's own azimuth are narrow. Aside and on the object's other side there are none: whoever moves with the camera
/// holds it, whoever stands opposite is in the picture, and a ring of opacity all round at one height would be nothing but light that is
/// dimmer from there; with most of such a ring, what a pale person adds can be imitated.
#[derive(Clone, Copy, Debug)]
pub struct CameraGrid;

/// Borders of the cells in azimuth from the camera, degrees.
const AZIMUTHS: [f32; 6] = [-45.0, -24.0, -8.0, 8.0, 24.0, 45.0];
/// Their tangents.
const TANGENTS: [f32; AZIMUTHS.len()] = [
    -1.0,
    -0.445_228_7,
    -0.140_540_83,
    0.140_540_83,
    0.445_228_7,
    1.0,
];
/// Borders of the cells in height (sine of elevation).
const HEIGHTS: [f32; 6] = [-1.0, -0.6, -0.25, 0.1, 0.4, 0.75];
/// Cells of one height.
const COLUMNS: usize = AZIMUTHS.len() - 1;

impl CameraGrid {
    /// The number of cells.
    pub const CELLS: usize = COLUMNS * HEIGHTS.len();

    /// The cell that holds a direction seen from the origin, for a camera at the azimuth (cos, sin); `None` away from the camera.
    pub fn cell(direction: Vec3, [cos, sin]: [f32; 2]) -> Option<usize> {
        let along = direction.x * cos + direction.y * sin;
        if along <= 0.0 {
            return None;
        }
        let across = -direction.x * sin + direction.y * cos;
        let column = TANGENTS.iter().rposition(|&t| across >= t * along)?;
        let row = HEIGHTS.iter().rposition(|&h| direction.z >= h).unwrap_or(0);
        (column < COLUMNS).then_some(row * COLUMNS + column)
    }

    /// What a cell is, for people.
    pub fn name(cell: usize) -> String {
        let (row, column) = (cell / COLUMNS, cell % COLUMNS);
        let top = HEIGHTS.get(row + 1).copied().unwrap_or(1.0);
        format!(
            "azimuth {:.0}° to {:.0}° from the camera, elevation {:.0}° to {:.0}°",
            AZIMUTHS[column],
            AZIMUTHS[column + 1],
            HEIGHTS[row].asin().to_degrees(),
            top.asin().to_degrees()
        )
    }

    /// The number of parts of [`part`](Self::part).
    pub const PARTS: usize = 6;

    /// The part that a cell belongs to of where somebody behind the camera would be: left, middle and right, below and above.
    pub fn part(cell: usize) -> Option<usize> {
        let (row, column) = (cell / COLUMNS, cell % COLUMNS);
        let side = match column {
            0 | 1 => 0,
            2 => 1,
            _ => 2,
        };
        match row {
            1 | 2 => Some(side),
            3 | 4 => Some(3 + side),
            _ => None,
        }
    }

    /// What a part is, for people.
    pub fn part_name(part: usize) -> String {
        let side = ["right of", "at", "left of"][part % 3];
        let height = if part < 3 { "below" } else { "above" };
        format!("{side} the camera's azimuth, {height} 6° of elevation")
    }

    /// Whether a cell is where somebody behind the camera would be.
    pub fn behind_camera(cell: usize) -> bool {
        (1..=4).contains(&(cell / COLUMNS))
    }
}

/// The change of every view of frame `frame`, a field, between its lamp at `plus` and at `minus`, over `distance`.
pub fn lamp_slope(
    scene: &Scene<'_>,
    frame: usize,
    plus: &Source,
    minus: &Source,
    distance: f32,
) -> Vec<f32> {
    let ball = scene.capture.lamps.as_ref().is_some_and(|lamps| lamps.ball);
    scene.on_views(|v| {
        let view = &scene.seen.views[v];
        if view.frame as usize != frame {
            return [0.0; 3];
        }
        let site = &scene.seen.sites[view.site as usize].point;
        let outgoing = scene.outgoing(v);
        let albedo = scene.albedo_of(v);
        let [light, other] = [plus, minus].map(|lamp| {
            let arriving = PI * arriving(scene.bvh, ball, lamp, site);
            let (incident, _) = lamp.seen_from(site.position);
            let (d, s) = reflect(scene.lobe, site.normal, incident, outgoing);
            albedo.map(|albedo| arriving * (albedo * d + s))
        });
        [0, 1, 2].map(|c| scene.radiance[3 * frame + c] * (light[c] - other[c]) / distance)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_turn_with_the_camera() {
        let camera = |degrees: f32| [degrees.to_radians().cos(), degrees.to_radians().sin()];
        let at = |azimuth: f32, elevation: f32| {
            let (sin, cos) = azimuth.to_radians().sin_cos();
            let up = elevation.to_radians().sin();
            let level = (1.0 - up * up).sqrt();
            Vec3::new(cos * level, sin * level, up)
        };
        for turned in [0.0, 50.0, -130.0] {
            let columns = [-44.0, -9.0, 7.0, 9.0, 44.0].into_iter().enumerate();
            for (column, from_camera) in columns {
                let cell = CameraGrid::cell(at(turned + from_camera, 0.0), camera(turned));
                assert_eq!(cell, Some(2 * COLUMNS + column), "{turned} {from_camera}");
            }
            let beyond = CameraGrid::cell(at(turned + 46.0, 0.0), camera(turned));
            assert_eq!(beyond, None);
        }
        let cell = CameraGrid::cell(at(9.0, 10.0), camera(0.0)).unwrap();
        assert_eq!(
            CameraGrid::name(cell),
            "azimuth 8° to 24° from the camera, elevation 6° to 24°"
        );
        assert_eq!(CameraGrid::part(cell), Some(5));
    }

    #[test]
    fn a_wide_blur_is_the_blur() {
        let mut image = Image::filled(150, 100, 3, 0.0);
        for (p, pixel) in image.data.chunks_exact_mut(3).enumerate() {
            let (x, y) = (p % 150, p / 150);
            let inside = (40..90).contains(&x) && (30..85).contains(&y);
            // What lies beyond the border is as the last pixel, or as the mean of the last box: the same where it is even.
            let border = !(15..135).contains(&x);
            pixel.fill(match (inside, border) {
                (true, _) => 1.0,
                (false, true) => 0.06,
                (false, false) => 0.02 * (x % 7) as f32,
            });
        }
        for sigma in [12.0, 18.0, 40.0] {
            let (exact, wide) = (blurred(&image, sigma), widely_blurred(&image, sigma));
            let apart = exact.data.iter().zip(&wide.data);
            let most = apart.fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
            assert!(most < 0.01, "{sigma}: {most}");
        }
        // Half a row of boxes at the border still holds a mean.
        assert!((reduced(&image, 40).pixel(3, 0)[0] - 0.06).abs() < 0.01);
    }
}
