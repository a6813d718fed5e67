//! Environment maps in other layouts.

use glam::Mat3;
use render::{
    convention::{Convention, convert},
    image::Image,
    lat_long::LatLong,
};

/// Our map in the layout of `convention`, on a grid on which nothing of it is lost where there is one.
pub fn laid_out(map: &Image, convention: Convention) -> Image {
    if matches!(convention, Convention::Blender | Convention::ThreeJs) {
        return map.clone();
    }
    // Others begin a quarter of a turn or a half elsewhere: a whole number of columns, or the texels would be mixed.
    let columns = match map.width % 4 {
        0 => map.width,
        _ => 2 * map.width,
    };
    let rows = match convention {
        // Rows at the poles and ours, with one between any two.
        Convention::Mitsuba => 2 * map.height + 1,
        _ => map.height,
    };
    let grid = LatLong::new(rows, columns);
    let ours = Convention::Blender;
    let mut laid = convert(map, ours, convention, grid, Mat3::IDENTITY);
    // Weights may miss one or zero by a rounding error: light stays what it may be.
    laid.data
        .iter_mut()
        .for_each(|value| *value = value.max(0.0));
    laid
}
