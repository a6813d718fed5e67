//! The recovered light as a Radiance picture: what the page's viewer takes from other runs, and most programs with it.

use std::{io::Write, path::Path};

use image::{ExtendedColorType, ImageEncoder, codecs::hdr::HdrEncoder};
use render::image::Image;

use crate::{files::atomic, image_io::ImageIoError};

/// The file in a run's folder.
pub use crate::layout::RADIANCE as NAME;
/// The range of what is written: beyond it an exponent does not fit into a byte, and what is darker is black.
const RANGE: [f32; 2] = [1e-38, 1e38];

/// Writes `light`, linear RGB on the grid of the environment map, to `environment.hdr` in `folder`, whole or not at all.
///
/// The format keeps eight bits of a texel's brightest channel, of the others what these leave: `environment.exr` is exact.
///
/// # Errors
/// [`ImageIoError::Encode`] for an image that is no RGB image, [`ImageIoError::Write`] where the file cannot be written.
pub fn write(folder: &Path, light: &Image) -> Result<(), ImageIoError> {
    let path = folder.join(NAME);
    let bytes = encode(light, &path)?;
    atomic::write(&path, |file| file.write_all(&bytes))
        .map_err(|source| ImageIoError::Write { path, source })
}

/// The picture's bytes; `path` only names it in errors.
fn encode(light: &Image, path: &Path) -> Result<Vec<u8>, ImageIoError> {
    let fail = |reason: String| ImageIoError::Encode {
        path: path.to_owned(),
        reason,
    };
    let (width, height) = (light.width, light.height);
    if light.channels != 3 || light.data.is_empty() || light.data.len() != 3 * width * height {
        return Err(fail(format!(
            "{} values of {} channels are no RGB image of {width} × {height} pixels",
            light.data.len(),
            light.channels
        )));
    }
    let side = |side: usize| u32::try_from(side).map_err(|error| fail(error.to_string()));
    let [least, most] = RANGE;
    let within = |texel: &[f32]| -> [f32; 3] {
        let black = texel.iter().all(|&value| value < least);
        std::array::from_fn(|c| match black {
            true => 0.0,
            false => texel[c].clamp(0.0, most),
        })
    };
    let values: Vec<[f32; 3]> = light.data.chunks_exact(3).map(within).collect();
    let mut bytes = Vec::new();
    HdrEncoder::new(&mut bytes)
        .write_image(
            bytemuck::cast_slice(&values),
            side(width)?,
            side(height)?,
            ExtendedColorType::Rgb32F,
        )
        .map_err(|error| fail(error.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_io::read_image;

    #[test]
    fn what_is_read_is_what_was_written_to_eight_bits() {
        let folder = tempfile::tempdir().unwrap();
        let value = |i: usize| 1.7f32.powi(i as i32 % 90 - 45);
        let light = Image {
            width: 20,
            height: 10,
            channels: 3,
            data: (0..600).map(value).collect(),
        };
        write(folder.path(), &light).unwrap();
        let read = read_image(&folder.path().join(NAME), None).unwrap();
        assert_eq!((read.width, read.height, read.channels), (20, 10, 3));
        for (read, written) in read.data.chunks_exact(3).zip(light.data.chunks_exact(3)) {
            let brightest = written.iter().copied().fold(0.0, f32::max);
            for (read, written) in read.iter().zip(written) {
                assert!(
                    (read - written).abs() <= brightest / 127.0,
                    "{read} {written}"
                );
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn values_that_the_format_cannot_hold_become_the_nearest_that_it_can() {
        let folder = tempfile::tempdir().unwrap();
        let light = Image {
            width: 2,
            height: 1,
            channels: 3,
            data: vec![f32::MAX, 0.0, -1.0, 0.0, 1e-40, 0.0],
        };
        write(folder.path(), &light).unwrap();
        let read = read_image(&folder.path().join(NAME), None).unwrap();
        assert!(read.data[0] > 0.98 * RANGE[1] && read.data[0] <= RANGE[1]);
        assert_eq!(read.data[1..], [0.0; 5]);

        let grey = Image::filled(4, 2, 1, 1.0);
        let error = write(folder.path(), &grey).unwrap_err().to_string();
        assert!(
            error.contains("environment.hdr") && error.contains("no RGB image"),
            "{error}"
        );
    }
}
