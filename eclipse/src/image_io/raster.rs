//! PNG, JPEG and Radiance HDR, by the `image` crate.

use std::{
    io::{BufRead, Cursor, Seek},
    path::Path,
};

use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageReader, Limits,
    codecs::png::PngEncoder,
};
use render::image::Image;

use super::{
    ColorEncoding, ImageIoError, MAX_SAMPLES, MAX_SIDE, check_size, color::decode_srgb,
    header::ImageSize, radiance,
};

/// Decodes a PNG, JPEG or Radiance HDR image to linear values with 1 to 4 channels; `path` only names it in errors.
///
/// Integers map to [0, 1]; of Radiance the light is given before the file's exposure. Without an `encoding`, integers are taken as sRGB and floats as linear.
pub fn decode_raster(
    bytes: &[u8],
    path: &Path,
    encoding: Option<ColorEncoding>,
) -> Result<Image, ImageIoError> {
    let (decoder, _) = checked_decoder(Cursor::new(bytes), path)?;
    let damaged = |reason: String| ImageIoError::Decode {
        path: path.into(),
        reason,
    };
    let decoded =
        DynamicImage::from_decoder(decoder).map_err(|error| damaged(error.to_string()))?;
    let default = match decoded {
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => ColorEncoding::Linear,
        _ => ColorEncoding::Srgb,
    };
    let mut image = floats(decoded);
    if bytes.starts_with(radiance::MAGIC) {
        radiance::undo(&mut image, bytes).map_err(damaged)?;
    }
    if encoding.unwrap_or(default) == ColorEncoding::Srgb {
        decode_srgb(&mut image);
    }
    Ok(image)
}

/// The size of the image whose header `source` begins with.
pub(super) fn size(source: impl BufRead + Seek, path: &Path) -> Result<ImageSize, ImageIoError> {
    checked_decoder(source, path).map(|(_, size)| size)
}

/// The value of EXIF's `Orientation` in the image, 1 where it says nothing; `None` for what is no image.
pub(super) fn orientation(bytes: &[u8], path: &Path) -> Option<u8> {
    let (mut decoder, _) = checked_decoder(Cursor::new(bytes), path).ok()?;
    Some(decoder.orientation().ok()?.to_exif())
}

/// A decoder that has read the header of an image and refused what is too large, and the size.
fn checked_decoder<'a>(
    source: impl BufRead + Seek + 'a,
    path: &Path,
) -> Result<(impl ImageDecoder + 'a, ImageSize), ImageIoError> {
    let fail = |reason: String| ImageIoError::Decode {
        path: path.into(),
        reason,
    };
    let mut reader = ImageReader::new(source)
        .with_guessed_format()
        .map_err(|error| fail(error.to_string()))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(MAX_SAMPLES as u64 * 4);
    reader.limits(limits);
    let decoder = reader
        .into_decoder()
        .map_err(|error| fail(error.to_string()))?;
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    let channels = decoder.color_type().channel_count().into();
    check_size(path, width, height, channels)?;
    let size = ImageSize {
        width,
        height,
        samples: width * height * channels,
    };
    Ok((decoder, size))
}

/// Encodes values in [0, 1] as an 8-bit PNG of 1, 3 or 4 channels; `path` only names it in errors.
pub fn encode_png8(image: &Image, path: &Path) -> Result<Vec<u8>, ImageIoError> {
    let fail = |reason: String| ImageIoError::Encode {
        path: path.into(),
        reason,
    };
    let color = match image.channels {
        1 => ExtendedColorType::L8,
        3 => ExtendedColorType::Rgb8,
        4 => ExtendedColorType::Rgba8,
        channels => {
            return Err(fail(format!(
                "a PNG holds 1, 3 or 4 channels, not {channels}"
            )));
        }
    };
    if image.data.len() != image.width * image.height * image.channels {
        return Err(fail(format!(
            "{} values are not {} × {} pixels",
            image.data.len(),
            image.width,
            image.height
        )));
    }
    let values: Vec<u8> = image
        .data
        .iter()
        .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
        .collect();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&values, image.width as u32, image.height as u32, color)
        .map_err(|error| fail(error.to_string()))?;
    Ok(bytes)
}

/// Floats of any decoded image, integers scaled to [0, 1], with the channels it has.
fn floats(decoded: DynamicImage) -> Image {
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let channels = decoded.color().channel_count().into();
    let from_u8 = |values: &[u8]| values.iter().map(|&v| f32::from(v) / 255.0).collect();
    let from_u16 = |values: &[u16]| values.iter().map(|&v| f32::from(v) / 65535.0).collect();
    let data = match decoded {
        DynamicImage::ImageLuma8(buffer) => from_u8(&buffer),
        DynamicImage::ImageLumaA8(buffer) => from_u8(&buffer),
        DynamicImage::ImageRgb8(buffer) => from_u8(&buffer),
        DynamicImage::ImageRgba8(buffer) => from_u8(&buffer),
        DynamicImage::ImageLuma16(buffer) => from_u16(&buffer),
        DynamicImage::ImageLumaA16(buffer) => from_u16(&buffer),
        DynamicImage::ImageRgb16(buffer) => from_u16(&buffer),
        DynamicImage::ImageRgba16(buffer) => from_u16(&buffer),
        DynamicImage::ImageRgb32F(buffer) => buffer.into_raw(),
        DynamicImage::ImageRgba32F(buffer) => buffer.into_raw(),
        // `DynamicImage` may gain kinds: four floats hold whatever they are.
        other => {
            let data = other.into_rgba32f().into_raw();
            return Image {
                width,
                height,
                channels: 4,
                data,
            };
        }
    };
    Image {
        width,
        height,
        channels,
        data,
    }
}
