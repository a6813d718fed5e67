//! PNG, JPEG and Radiance HDR, by the `image` crate.

use std::{
    io::{BufRead, Cursor, Seek},
    path::Path,
};

use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, ImageReader, Limits,
    codecs::{hdr::HdrDecoder, png::PngEncoder},
};
use render::image::Image;

use super::{
    ColorEncoding, ImageIoError, check_size, color::decode_srgb, header::ImageSize, radiance,
};

/// Most bytes of a PNG's texts, colour profile and one row of pixels: a file of a megabyte may hold a profile of a gigabyte, which is
/// unpacked before the first pixel. A longer one is passed over. Whole pictures are held to [`check_size`].
const MAX_METADATA: u64 = 1 << 26;
/// The first bytes of every PNG file.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

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
    if radiance::begins(bytes) {
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
    mut source: impl BufRead + Seek + 'a,
    path: &Path,
) -> Result<(Box<dyn ImageDecoder + 'a>, ImageSize), ImageIoError> {
    let fail = |reason: String| ImageIoError::Decode {
        path: path.into(),
        reason,
    };
    let head = source.fill_buf().map_err(|error| fail(error.to_string()))?;
    check_png(head, path)?;
    let damaged = |error: ImageError| fail(error.to_string());
    let decoder: Box<dyn ImageDecoder + 'a> = if radiance::is_other(head) {
        Box::new(HdrDecoder::new_nonstrict(source).map_err(damaged)?)
    } else {
        let mut reader = ImageReader::new(source)
            .with_guessed_format()
            .map_err(|error| fail(error.to_string()))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(MAX_METADATA);
        reader.limits(limits);
        Box::new(reader.into_decoder().map_err(damaged)?)
    };
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

/// Refuses a PNG by the size that it begins with, whose decoder would name no size where that is beyond its limits.
fn check_png(head: &[u8], path: &Path) -> Result<(), ImageIoError> {
    let chunk = head.strip_prefix(PNG).and_then(<[u8]>::split_first_chunk);
    // The chunk's length and name; then width, height, bits and kind of colour.
    let Some(([_, _, _, _, b'I', b'H', b'D', b'R'], size)) = chunk else {
        return Ok(());
    };
    let Some((&[a, b, c, d, e, f, g, h, _, kind], _)) = size.split_first_chunk() else {
        return Ok(());
    };
    let [width, height] =
        [[a, b, c, d], [e, f, g, h]].map(|side| u32::from_be_bytes(side) as usize);
    let channels = match kind {
        0 => 1,
        4 => 2,
        2 | 3 => 3,
        _ => 4,
    };
    check_size(path, width, height, channels)
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

#[cfg(test)]
mod tests {
    use image::codecs::png::{CompressionType, FilterType};

    use super::*;

    /// A grey PNG of zeros.
    fn black(width: u32, height: u32, color: ExtendedColorType) -> Vec<u8> {
        let mut bytes = Vec::new();
        let bytes_each = color.bits_per_pixel() as usize / 8;
        let values = vec![0; width as usize * height as usize * bytes_each];
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::NoFilter)
            .write_image(&values, width, height, color)
            .unwrap();
        bytes
    }

    /// What a PNG's pixels are packed to.
    fn packed(png: &[u8]) -> Vec<u8> {
        let (mut packed, mut rest) = (Vec::new(), &png[PNG.len()..]);
        while let Some((length, chunk)) = rest.split_first_chunk() {
            let length = u32::from_be_bytes(*length) as usize;
            if chunk.starts_with(b"IDAT") {
                packed.extend_from_slice(&chunk[4..4 + length]);
            }
            rest = &chunk[4 + length + 4..];
        }
        packed
    }

    /// CRC-32 by its definition, bit by bit.
    fn crc32(bytes: &[u8]) -> u32 {
        let byte = |crc: u32, byte: &u8| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
            })
        };
        !bytes.iter().fold(!0, byte)
    }

    /// A PNG of one pixel with a colour profile of as many zeros as so many rows of 8 KiB have.
    fn with_profile(rows: u32) -> Vec<u8> {
        let mut chunk = b"iCCPname\0\0".to_vec();
        chunk.extend(packed(&black(8192, rows, ExtendedColorType::L8)));
        let length = (chunk.len() - 4) as u32;
        let crc = crc32(&chunk);
        let mut bytes = black(1, 1, ExtendedColorType::L8);
        // After the chunk that every PNG begins with.
        let place = PNG.len() + 4 + 4 + 13 + 4;
        let whole = [&length.to_be_bytes()[..], &chunk, &crc.to_be_bytes()];
        bytes.splice(place..place, whole.concat());
        bytes
    }

    #[test]
    fn colour_profiles_are_not_unpacked_to_any_length() {
        let profile = |bytes: &[u8]| {
            let (mut decoder, _) = checked_decoder(Cursor::new(bytes), Path::new("a.png")).unwrap();
            decoder.icc_profile().unwrap().map(|profile| profile.len())
        };
        assert_eq!(profile(&with_profile(4)), Some(4 * 8193));
        let bomb = with_profile(8192);
        assert!(bomb.len() < 1 << 20, "{} bytes", bomb.len());
        assert_eq!(profile(&bomb), None);
        assert!(decode_raster(&bomb, Path::new("a.png"), None).is_ok());
    }

    #[test]
    fn pixels_may_be_more_than_what_comes_before_them() {
        let (width, height) = (8192, 4200);
        assert!(width * height * 2 > MAX_METADATA);
        let bytes = black(width as u32, height as u32, ExtendedColorType::L16);
        let image = decode_raster(&bytes, Path::new("a.png"), None).unwrap();
        assert_eq!(image.data.len() as u64, width * height);
    }
}
