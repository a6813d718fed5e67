//! Image files: OpenEXR and Radiance HDR (linear), PNG and JPEG (sRGB-encoded unless said otherwise).
//!
//! Everything read ends as linear [`Image`] values; everything written appears whole or not at all.

mod clamped;
mod color;
mod environment;
mod exr_colors;
mod header;
mod name;
mod openexr;
mod radiance;
mod raster;
mod reduce;
mod turn;

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use render::image::Image;

use crate::files::{atomic, read_limited};

pub use clamped::Clamped;
pub use color::{ColorEncoding, linear_to_srgb, srgb_to_linear, white};
pub use environment::{
    EnvironmentIoError, EnvironmentOptions, Rows, read_environment, read_foreign_environment,
};
pub use header::{ImageSize, decode_size, read_size};
pub use name::{EXTENSIONS, stem};
pub use openexr::{ExrFile, ExrOptions, Precision, decode_exr, encode_exr};
pub use raster::{decode_raster, encode_png8};
pub use reduce::{reduce, reduced_size};
pub use turn::{Turn, decode_turn, read_turn};

/// Widest or highest image that is read, in pixels.
pub const MAX_SIDE: usize = 1 << 16;
/// Largest image that is read, in samples (pixels × channels): an environment of 16 384 × 8 192 pixels and three channels,
/// 1.5 GiB as floats.
pub const MAX_SAMPLES: usize = 3 << 27;
/// Largest image file that is read, in bytes.
pub const MAX_FILE: u64 = 1 << 31;

/// Reads an image of any supported format, told apart by content, as linear values with 1 (Y), 2 (Y, alpha), 3 (RGB)
/// or 4 (RGBA) channels.
///
/// `encoding` says how stored values relate to light; by default EXR and HDR are linear, PNG and JPEG sRGB. Alpha is
/// never decoded.
pub fn read_image(path: &Path, encoding: Option<ColorEncoding>) -> Result<Image, ImageIoError> {
    decode_image(&read_bytes(path)?, path, encoding)
}

/// [`read_image`] from bytes; `path` only names them in errors.
pub fn decode_image(
    bytes: &[u8],
    path: &Path,
    encoding: Option<ColorEncoding>,
) -> Result<Image, ImageIoError> {
    if !bytes.starts_with(&openexr::MAGIC) {
        return decode_raster(bytes, path, encoding);
    }
    let mut image = decode_exr(bytes, path)?.color_image(path)?;
    if encoding == Some(ColorEncoding::Srgb) {
        color::decode_srgb(&mut image);
    }
    Ok(image)
}

/// Reads the colour of an OpenEXR file: `R G B`, with `A` as a fourth channel where there is one, or `Y` (and `A`); of the first
/// part that has it.
pub fn read_exr(path: &Path) -> Result<Image, ImageIoError> {
    decode_exr(&read_bytes(path)?, path)?.color_image(path)
}

/// Reads the picture of an OpenEXR file whole: all channels of its part with their names, and the text metadata.
pub fn read_exr_file(path: &Path) -> Result<ExrFile, ImageIoError> {
    decode_exr(&read_bytes(path)?, path)
}

/// Writes a 32-bit float OpenEXR file; `channel_names` holds one name a channel, such as `["R", "G", "B"]`.
pub fn write_exr(path: &Path, image: &Image, channel_names: &[&str]) -> Result<(), ImageIoError> {
    write_exr_with(path, image, channel_names, &ExrOptions::default())
}

/// [`write_exr`] with a choice of precision and with text metadata.
pub fn write_exr_with(
    path: &Path,
    image: &Image,
    channel_names: &[&str],
    options: &ExrOptions,
) -> Result<(), ImageIoError> {
    write_bytes(path, &encode_exr(image, channel_names, options, path)?)
}

/// Writes an 8-bit PNG of 1, 3 or 4 channels from values in [0, 1], stored as they are (encode sRGB first, with
/// [`linear_to_srgb`], where that is wanted). Values outside, and NaN, are clamped.
pub fn write_png8(path: &Path, image: &Image) -> Result<(), ImageIoError> {
    write_bytes(path, &encode_png8(image, path)?)
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, ImageIoError> {
    read_limited(path, MAX_FILE).map_err(|source| ImageIoError::Read {
        path: path.into(),
        source,
    })
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), ImageIoError> {
    atomic::write(path, |file| file.write_all(bytes)).map_err(|source| ImageIoError::Write {
        path: path.into(),
        source,
    })
}

/// Refuses sizes before anything is allocated for them.
fn check_size(
    path: &Path,
    width: usize,
    height: usize,
    channels: usize,
) -> Result<(), ImageIoError> {
    let samples = width
        .checked_mul(height)
        .and_then(|pixels| pixels.checked_mul(channels));
    let fits = (1..=MAX_SIDE).contains(&width)
        && (1..=MAX_SIDE).contains(&height)
        && samples.is_some_and(|samples| (1..=MAX_SAMPLES).contains(&samples));
    if fits {
        Ok(())
    } else {
        Err(ImageIoError::Size {
            path: path.into(),
            width,
            height,
            channels,
        })
    }
}

/// Why an image could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageIoError {
    /// The file cannot be opened or read.
    #[error("cannot read the image {}: {source}; check that it exists and may be read", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The bytes are not a whole image of a known format.
    #[error("{} is damaged, truncated or not an EXR, HDR, PNG or JPEG image ({reason}); export or copy it again", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// The file is good, but uses a part of its format that is not read.
    #[error("{} {problem}; export it as a plain image with R, G, B (and A) for every pixel", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it uses.
        problem: String,
    },
    /// The header declares a size beyond all use.
    #[error(
        "{} declares {width} × {height} pixels of {channels} channels; at least one of each and at most {MAX_SIDE} a side and {MAX_SAMPLES} \
         values are read: scale the image down",
        path.display()
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Declared pixels across.
        width: usize,
        /// Declared pixels down.
        height: usize,
        /// Declared values per pixel.
        channels: usize,
    },
    /// An EXR file that is nearly all margin.
    #[error(
        "{} has a display window of {width} × {height} pixels, {shown} values of which {stored} are stored; a window of that size \
         is read where at least a sixteenth of it is: crop the display window to the picture, or store all of it",
        path.display()
    )]
    Window {
        /// The file.
        path: PathBuf,
        /// Pixels across the display window.
        width: usize,
        /// Pixels down the display window.
        height: usize,
        /// Samples in the display window.
        shown: usize,
        /// Samples in the data windows.
        stored: usize,
    },
    /// An EXR file without colour channels.
    #[error("{} has the channels {found}, but R, G, B (and A) or Y are expected: export it as an RGB image", path.display())]
    Channels {
        /// The file.
        path: PathBuf,
        /// Names of the channels it has.
        found: String,
    },
    /// An image that the format to be written cannot hold.
    #[error("cannot write {}: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What is wrong with the image.
        reason: String,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {source}; check that the folder exists, may be written, and that the disk is not full", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
