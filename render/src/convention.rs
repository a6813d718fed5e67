//! Equirectangular conventions of other programs, for import and export.
//!
//! Programs with y up see our world (x, y, z) as (x, z, −y), as glTF does.

use std::f32::consts::{PI, TAU};
use std::str::FromStr;

use glam::{Mat3, Vec3};

use crate::image::Image;
use crate::lat_long::LatLong;

/// How a program lays directions out on an equirectangular image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Convention {
    /// Ours and Blender's: z up, centre +x, columns grow as the azimuth falls.
    Blender,
    /// Mitsuba 3: y up, left edge −z, +x a quarter in; rows at the poles and between them, columns centred.
    Mitsuba,
    /// OpenEXR and USD lat-long: y up, centre +z, +x a quarter in.
    OpenExr,
    /// three.js: y up, centre +x; the same pixels as ours.
    ThreeJs,
    /// skylibs, and Stanford-ORB in camera axes: y up, centre −z, +x at three quarters.
    Skylibs,
}

impl Convention {
    /// Every convention.
    pub const ALL: [Self; 5] = [
        Self::Blender,
        Self::Mitsuba,
        Self::OpenExr,
        Self::ThreeJs,
        Self::Skylibs,
    ];

    /// The name that files and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            Self::Blender => "blender",
            Self::Mitsuba => "mitsuba",
            Self::OpenExr => "openexr",
            Self::ThreeJs => "threejs",
            Self::Skylibs => "skylibs",
        }
    }

    /// The (u, v) of a unit direction of our world.
    fn coordinates(self, d: Vec3) -> [f32; 2] {
        let (x, y, z) = (d.x, d.z, -d.y);
        let v = x.hypot(z).atan2(y) / PI;
        let u = match self {
            Self::Blender | Self::ThreeJs => 0.5 + z.atan2(x) / TAU,
            Self::Mitsuba => x.atan2(-z) / TAU,
            Self::OpenExr => 0.5 - x.atan2(z) / TAU,
            Self::Skylibs => 0.5 + x.atan2(-z) / TAU,
        };
        [u.rem_euclid(1.0), v]
    }

    /// The unit direction of our world at (u, v).
    fn direction(self, u: f32, v: f32) -> Vec3 {
        let (sin_theta, y) = (PI * v).sin_cos();
        let (sin, cos) = match self {
            Self::Blender | Self::ThreeJs => (TAU * (u - 0.5)).sin_cos(),
            Self::Mitsuba | Self::OpenExr => (TAU * (u - 0.25)).sin_cos(),
            Self::Skylibs => (TAU * (u - 0.75)).sin_cos(),
        };
        // From +x, u grows towards +z (of the y-up world) in all of them.
        let (x, z) = (sin_theta * cos, sin_theta * sin);
        Vec3::new(x, -z, y)
    }

    /// The v of a (possibly fractional) row of an image of `height` rows.
    fn row_to_v(self, row: f32, height: usize) -> f32 {
        match self {
            Self::Mitsuba if height > 1 => row / (height - 1) as f32,
            _ => (row + 0.5) / height as f32,
        }
    }

    /// The fractional row of v.
    fn v_to_row(self, v: f32, height: usize) -> f32 {
        match self {
            Self::Mitsuba if height > 1 => v * (height - 1) as f32,
            _ => v * height as f32 - 0.5,
        }
    }
}

impl FromStr for Convention {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|c| c.name() == name)
            .ok_or_else(|| {
                let names = Self::ALL.map(Self::name).join(", ");
                format!("unknown environment convention `{name}`; use one of {names}")
            })
    }
}

/// Resamples `image` from one convention to another on a grid of `to_grid`, bilinearly.
///
/// `rotation` takes directions of the source's world to the target's: the identity, or camera-to-world for maps that
/// are stored per view in camera axes.
pub fn convert(
    image: &Image,
    from: Convention,
    to: Convention,
    to_grid: LatLong,
    rotation: Mat3,
) -> Image {
    let mut out = Image::filled(to_grid.columns, to_grid.rows, image.channels, 0.0);
    let back = rotation.transpose();
    for row in 0..to_grid.rows {
        let v = to.row_to_v(row as f32, to_grid.rows);
        for column in 0..to_grid.columns {
            let u = (column as f32 + 0.5) / to_grid.columns as f32;
            let [source_u, source_v] = from.coordinates(back * to.direction(u, v));
            // Expressed as the centred v that has the same fractional row.
            let centred = (from.v_to_row(source_v, image.height) + 0.5) / image.height as f32;
            let lookup = LatLong::new(image.height, image.width).bilinear_at(source_u, centred);
            let pixel = out.pixel_mut(column, row);
            for k in 0..4 {
                let texel = &image.data[lookup.index[k] as usize * image.channels..];
                for (value, t) in pixel.iter_mut().zip(texel) {
                    *value += lookup.weight[k] * t;
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_directions_are_where_each_program_documents_them() {
        // (convention, direction of our world, u)
        let cases = [
            (Convention::Blender, Vec3::X, 0.5),
            (Convention::ThreeJs, Vec3::X, 0.5),
            (Convention::OpenExr, -Vec3::Y, 0.5), // +z with y up
            (Convention::OpenExr, Vec3::X, 0.25),
            (Convention::Skylibs, Vec3::Y, 0.5), // −z with y up
            (Convention::Skylibs, Vec3::X, 0.75),
            (Convention::Mitsuba, Vec3::X, 0.25),
            (Convention::Mitsuba, -Vec3::Y, 0.5), // +z with y up
        ];
        for (convention, direction, u) in cases {
            let [found, v] = convention.coordinates(direction);
            assert!(
                (found - u).abs() < 1e-6 && (v - 0.5).abs() < 1e-6,
                "{convention:?} {found}"
            );
        }
    }

    #[test]
    fn directions_and_coordinates_are_inverse() {
        for convention in Convention::ALL {
            for (u, v) in [(0.1, 0.2), (0.4, 0.7), (0.85, 0.5)] {
                let [u2, v2] = convention.coordinates(convention.direction(u, v));
                assert!(
                    (u - u2).abs() < 1e-5 && (v - v2).abs() < 1e-5,
                    "{convention:?} {u} {u2}"
                );
            }
            assert_eq!(convention.name().parse(), Ok(convention));
        }
        for (u, v) in [(0.1, 0.2), (0.6, 0.7)] {
            assert!(
                (Convention::Blender.direction(u, v) - LatLong::direction(u, v)).length() < 1e-5
            );
        }
    }

    #[test]
    fn a_smooth_map_survives_the_round_trip() {
        let grid = LatLong::new(64, 128);
        let mut image = Image::filled(128, 64, 1, 0.0);
        for r in 0..64 {
            for c in 0..128 {
                let d = grid.texel_direction(r, c);
                image.pixel_mut(c, r)[0] = 1.0 + 0.5 * d.x - 0.3 * d.y * d.z;
            }
        }
        for convention in Convention::ALL {
            let there = convert(
                &image,
                Convention::Blender,
                convention,
                grid,
                Mat3::IDENTITY,
            );
            let back = convert(
                &there,
                convention,
                Convention::Blender,
                grid,
                Mat3::IDENTITY,
            );
            let worst = image
                .data
                .iter()
                .zip(&back.data)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 0.02, "{convention:?} {worst}");
        }
    }
}
