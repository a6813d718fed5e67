//! Environment maps of any program, brought to our convention.

use std::path::Path;

use glam::Mat3;
use render::{
    convention::{Convention, convert},
    environment::{EnvironmentError, EnvironmentMap},
    image::Image,
    lat_long::LatLong,
};

use super::{
    Clamped, ImageIoError, check_size, clamped::clamp, decode_exr, openexr::MAGIC, read_bytes,
    read_image,
};
use crate::layout::CONVENTION;

/// How an environment map is read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnvironmentOptions {
    /// How the file is laid out, in place of what it says itself; Blender's layout where neither says.
    pub convention: Option<Convention>,
    /// Turns the light about the vertical axis, in degrees, counter-clockwise seen from above.
    pub rotate: f32,
    /// The grid that it is brought to.
    pub rows: Rows,
}

/// How many rows a map is read with; where it is not its own number, columns are twice as many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rows {
    /// As many as the file has.
    #[default]
    Own,
    /// Its own unless they are more.
    AtMost(usize),
    /// This many, averaged over equal parts of the sphere's grid.
    Exactly(usize),
}

/// Reads an equirectangular map as RGB radiance in the convention of [`LatLong`].
///
/// EXR files that we wrote name their convention, which is followed; a grey map is repeated in all channels.
///
/// # Errors
/// [`EnvironmentIoError`] names the file and what is wrong with it.
pub fn read_environment(
    path: &Path,
    options: &EnvironmentOptions,
) -> Result<EnvironmentMap, EnvironmentIoError> {
    let (image, named) = read(path)?;
    laid_out(path, image.to_rgb(), named, options)
}

/// The same of maps that other programs made, in which negative light is taken as none and infinite light as very much; with what was
/// taken so, for whoever should know.
///
/// # Errors
/// As [`read_environment`].
pub fn read_foreign_environment(
    path: &Path,
    options: &EnvironmentOptions,
) -> Result<(EnvironmentMap, Option<Clamped>), EnvironmentIoError> {
    let (image, named) = read(path)?;
    let mut image = image.to_rgb();
    let clamped = clamp(&mut image, path);
    Ok((laid_out(path, image, named, options)?, clamped))
}

/// The light of an RGB image that names a convention, or none.
fn laid_out(
    path: &Path,
    image: Image,
    named: Option<String>,
    options: &EnvironmentOptions,
) -> Result<EnvironmentMap, EnvironmentIoError> {
    // Files that name a convention are ours, and some layouts have other grids.
    let is_sphere = image.width == 2 * image.height
        || options.convention == Some(Convention::Mitsuba) && has_pole_rows(&image);
    if named.is_none() && !is_sphere {
        return Err(EnvironmentIoError::Shape {
            path: path.into(),
            width: image.width,
            height: image.height,
        });
    }
    let named = named.map(|name| {
        name.parse()
            .map_err(|problem| EnvironmentIoError::Convention {
                path: path.into(),
                problem,
            })
    });
    let convention = match (options.convention, named) {
        (Some(convention), _) => convention,
        (None, named) => named.transpose()?.unwrap_or(Convention::Blender),
    };
    // Checked before light is mixed: one bad texel would spread, and its place would be lost.
    let checked = |image| {
        EnvironmentMap::new(image).map_err(|source| EnvironmentIoError::Light {
            path: path.into(),
            source,
        })
    };
    let map = checked(image)?;
    let (own, parts) = (map.grid(), options.rows.parts(map.grid().rows));
    let fine = parts.map_or(own, |(rows, parts)| {
        LatLong::new(rows * parts, 2 * rows * parts)
    });
    if convention == Convention::Blender && options.rotate == 0.0 && fine == own && parts.is_none()
    {
        return Ok(map);
    }
    check_size(path, fine.columns, fine.rows, 3)?;
    let turn = Mat3::from_rotation_z(options.rotate.to_radians());
    let fine = convert(map.image(), convention, Convention::Blender, fine, turn);
    checked(parts.map_or_else(|| fine.clone(), |(_, parts)| mean_of_blocks(&fine, parts)))
}

/// Whether the map has the size of one with rows at both poles, as Mitsuba lays them out: a row more than half its columns, or, as
/// we export them, than its columns.
fn has_pole_rows(image: &Image) -> bool {
    let Image { width, height, .. } = *image;
    width.is_multiple_of(2) && (height == width / 2 + 1 || height == width + 1)
}

impl Rows {
    /// Rows to average to, each over how many; `None` to leave a map of `own` rows as it is.
    fn parts(self, own: usize) -> Option<(usize, usize)> {
        let rows = match self {
            Self::Exactly(rows) => rows,
            Self::AtMost(rows) if own > rows => rows,
            Self::Own | Self::AtMost(_) => return None,
        };
        Some((rows, own.div_ceil(rows.max(1))))
    }
}

/// The image and the convention that it names.
fn read(path: &Path) -> Result<(Image, Option<String>), ImageIoError> {
    let bytes = read_bytes(path)?;
    if !bytes.starts_with(&MAGIC) {
        return Ok((read_image(path, None)?, None));
    }
    let mut file = decode_exr(&bytes, path)?;
    let named = file.metadata.remove(CONVENTION);
    Ok((file.color_image(path)?, named))
}

/// The mean over blocks of `parts` × `parts` pixels, which must fill the image.
fn mean_of_blocks(image: &Image, parts: usize) -> Image {
    let (width, height) = (image.width / parts, image.height / parts);
    let mut mean = Image::filled(width, height, image.channels, 0.0);
    let share = 1.0 / (parts * parts) as f32;
    for y in 0..height * parts {
        for x in 0..width * parts {
            let pixel = image.pixel(x, y);
            let sum = mean.pixel_mut(x / parts, y / parts);
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += share * value;
            }
        }
    }
    mean
}

/// Why an environment map could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnvironmentIoError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// The image does not have the shape of a sphere.
    #[error(
        "{} is {width} × {height}; expected an equirectangular map, twice as wide as high: convert light probes and cube crosses to one",
        path.display()
    )]
    Shape {
        /// The file.
        path: std::path::PathBuf,
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
    },
    /// The file names a convention that is not known.
    #[error("{}: its attribute `{CONVENTION}`: {problem}; or name the layout with --convention", path.display())]
    Convention {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The image is no light.
    #[error("{}: {source}", path.display())]
    Light {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong.
        source: EnvironmentError,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Image {
        let value = |i: usize| (i * i % 13) as f32;
        Image {
            width,
            height,
            channels: 3,
            data: (0..width * height * 3).map(value).collect(),
        }
    }

    #[test]
    fn averaging_keeps_the_sum_and_the_place() {
        let map = ramp(8, 4);
        let mean = mean_of_blocks(&map, 2);
        assert_eq!((mean.width, mean.height), (4, 2));
        let sum = |image: &Image| image.data.iter().sum::<f32>();
        assert!((sum(&map) / 4.0 - sum(&mean)).abs() < 1e-3);
        let first: f32 = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .map(|(x, y)| map.pixel(x, y)[0])
            .iter()
            .sum();
        assert!((mean.pixel(0, 0)[0] - first / 4.0).abs() < 1e-5);
    }

    #[test]
    fn rows_are_kept_limited_or_set() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        super::super::write_exr(&path, &ramp(14, 7), &["R", "G", "B"]).unwrap();
        for (rows, expected) in [
            (Rows::Own, [14, 7]),
            (Rows::AtMost(7), [14, 7]),
            (Rows::AtMost(4), [8, 4]),
            (Rows::Exactly(9), [18, 9]),
        ] {
            let options = EnvironmentOptions {
                rows,
                ..Default::default()
            };
            let map = read_environment(&path, &options).unwrap();
            assert_eq!([map.image().width, map.image().height], expected);
        }
    }

    #[test]
    fn only_maps_of_the_sphere_are_read_and_none_that_would_grow_beyond_bounds() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |name: &str, options: &EnvironmentOptions| {
            let error = read_environment(&folder.path().join(name), options).unwrap_err();
            error.to_string()
        };
        let strip = Image::filled(1, 1 << 16, 1, 0.5);
        super::super::write_png8(&folder.path().join("strip.png"), &strip).unwrap();
        for rows in [Rows::Own, Rows::AtMost(4), Rows::Exactly(9)] {
            let options = EnvironmentOptions {
                rows,
                convention: Some(Convention::OpenExr),
                ..Default::default()
            };
            let error = refused("strip.png", &options);
            assert!(
                error.contains("strip.png is 1 × 65536; expected an equirectangular map"),
                "{error}"
            );
        }

        // A name does not lift the bound on the grid that it would be brought to.
        let named = |name: &str, convention: Convention, map: &Image| {
            let mut options = super::super::ExrOptions::default();
            let value = convention.name().to_owned();
            options.metadata.insert(CONVENTION.to_owned(), value);
            let path = folder.path().join(name);
            super::super::write_exr_with(&path, map, &["R", "G", "B"], &options).unwrap();
            path
        };
        let strip = Image::filled(1, 1 << 16, 3, 0.5);
        named("strip.exr", Convention::OpenExr, &strip);
        let turned = EnvironmentOptions {
            rotate: 90.0,
            rows: Rows::AtMost(4),
            ..Default::default()
        };
        let error = refused("strip.exr", &turned);
        assert!(error.contains("131072 × 65536"), "{error}");

        // What we export for Mitsuba has a row at each pole.
        let mitsuba = named(
            "mitsuba.exr",
            Convention::Mitsuba,
            &Image::filled(16, 17, 3, 0.5),
        );
        let map = read_environment(&mitsuba, &EnvironmentOptions::default()).unwrap();
        assert_eq!([map.image().width, map.image().height], [16, 17]);

        // Nor is the attribute needed where the user says as much; it gets lost in other programs.
        for (height, is_read) in [(17, true), (9, true), (8, true), (18, false), (16, false)] {
            let path = folder.path().join("plain.exr");
            let map = Image::filled(16, height, 3, 0.5);
            super::super::write_exr(&path, &map, &["R", "G", "B"]).unwrap();
            let mut options = EnvironmentOptions {
                convention: Some(Convention::Mitsuba),
                ..Default::default()
            };
            assert_eq!(
                read_environment(&path, &options).is_ok(),
                is_read,
                "{height}"
            );
            options.convention = Some(Convention::OpenExr);
            assert_eq!(read_environment(&path, &options).is_ok(), height == 8);
        }
    }

    #[test]
    fn a_turn_moves_the_light_counter_clockwise() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let grid = LatLong::new(8, 16);
        let mut map = Image::filled(16, 8, 3, 0.0);
        // A lamp at +x; a quarter turn brings it to +y.
        for texel in grid.bilinear(glam::Vec3::X).index {
            map.data[3 * texel as usize..][..3].fill(1.0);
        }
        super::super::write_exr(&path, &map, &["R", "G", "B"]).unwrap();
        let options = EnvironmentOptions {
            rotate: 90.0,
            ..Default::default()
        };
        let turned = read_environment(&path, &options).unwrap();
        assert!(turned.radiance(glam::Vec3::Y)[0] > 0.99);
        assert!(turned.radiance(glam::Vec3::X)[0] < 0.01);
    }
}
