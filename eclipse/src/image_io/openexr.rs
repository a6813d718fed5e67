//! OpenEXR, by the `exr` crate.

use std::{
    collections::BTreeMap,
    io::{Cursor, Read},
    path::Path,
};

use exr::{
    error::Error,
    meta::MetaData,
    prelude::{
        self as exr_image, AnyChannel, AnyChannels, AttributeValue, Compression, Encoding,
        FlatSamples, Layer, LayerAttributes, ReadChannels, ReadLayers, SmallVec, Text, Vec2,
        WritableImage, f16,
    },
};
use render::image::Image;

use super::{ImageIoError, check_size, exr_colors::colors, header::ImageSize};

/// The first bytes of every OpenEXR file.
pub(super) const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Channels of fewer values than the picture has pixels, as some programs keep colour beside brightness.
const SUBSAMPLED: &str = "has subsampled channels, which are not supported";

/// A display window of at most this many samples is read whatever part of it holds data: 256 MiB as floats.
const SMALL_WINDOW: usize = 1 << 26;
/// How many times the data a larger display window may be: renders of a part of the picture and cropped layers are, but a
/// window of gigabytes around one pixel is a trap.
const LARGEST_MARGIN: usize = 16;

/// The picture of an OpenEXR file: of several parts the first with channels of colour, or the first of all where none has any.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrFile {
    /// All channels interleaved, over the display window (zero outside the data window).
    pub image: Image,
    /// Names of the channels, in the order of the image: alphabetical, as the format stores them.
    pub channel_names: Vec<String>,
    /// Text attributes by name, among them the convention of an environment map.
    pub metadata: BTreeMap<String, String>,
}

/// How samples are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 16-bit floats: 11 bits of precision up to 65 504.
    Half,
    /// 32-bit floats.
    #[default]
    Float,
}

/// How an OpenEXR file is written.
#[derive(Clone, Debug, Default)]
pub struct ExrOptions {
    /// How samples are stored.
    pub precision: Precision,
    /// Text attributes by name.
    pub metadata: BTreeMap<String, String>,
}

impl ExrFile {
    /// The channels `names`, in that order, or `None` when one is missing.
    pub fn select(&self, names: &[&str]) -> Option<Image> {
        let indices: Option<Vec<usize>> = names
            .iter()
            .map(|name| self.channel_names.iter().position(|own| own == name))
            .collect();
        Some(self.at(&indices?))
    }

    /// The channels at these places, in that order.
    fn at(&self, indices: &[usize]) -> Image {
        let Image {
            width,
            height,
            channels,
            data,
        } = &self.image;
        let data = data
            .chunks_exact(*channels)
            .flat_map(|pixel| indices.iter().map(|&i| pixel[i]))
            .collect();
        Image {
            width: *width,
            height: *height,
            channels: indices.len(),
            data,
        }
    }

    /// The colour: RGB (or rgb) or Y, with alpha last where there is one. Channels of layers (`Combined.R`) count when no plain
    /// ones exist: those of a layer `Combined`, else of the first layer in the alphabet.
    pub fn color_image(&self, path: &Path) -> Result<Image, ImageIoError> {
        match colors(&self.channel_names) {
            Some(places) => Ok(self.at(&places)),
            None => Err(ImageIoError::Channels {
                path: path.into(),
                // Names may be of any characters, and messages are one line.
                found: self
                    .channel_names
                    .join(", ")
                    .replace(char::is_control, "\u{fffd}"),
            }),
        }
    }
}

/// Decodes an OpenEXR file; `path` only names it in errors.
pub fn decode_exr(bytes: &[u8], path: &Path) -> Result<ExrFile, ImageIoError> {
    let damaged = |reason: String| ImageIoError::Decode {
        path: path.into(),
        reason,
    };
    size(Cursor::new(bytes), path)?;
    let file = exr_image::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| refused(error, path))?;
    let window = file.attributes.display_window;
    let layers = &file.layer_data;
    let with_colors = |layer: &&Layer<_>| colors(&names_of(layer)).is_some();
    let Some(layer) = layers.iter().find(with_colors).or(layers.first()) else {
        return Err(damaged("it has no layer".into()));
    };
    let mut metadata = BTreeMap::new();
    for (name, value) in file.attributes.other.iter().chain(&layer.attributes.other) {
        if let AttributeValue::Text(text) = value {
            metadata.insert(name.to_string(), text.to_string());
        }
    }
    let channels = &layer.channel_data.list;
    let Vec2(layer_width, layer_height) = layer.size;
    let mut image = Image::filled(window.size.0, window.size.1, channels.len(), 0.0);
    for (index, channel) in channels.iter().enumerate() {
        if channel.sample_data.len() != layer_width * layer_height {
            return Err(unsupported(SUBSAMPLED, path));
        }
        for (offset, value) in channel.sample_data.values_as_f32().enumerate() {
            let x = (offset % layer_width) as i64 + i64::from(layer.attributes.layer_position.0);
            let y = (offset / layer_width) as i64 + i64::from(layer.attributes.layer_position.1);
            let (x, y) = (
                x - i64::from(window.position.0),
                y - i64::from(window.position.1),
            );
            if (0..image.width as i64).contains(&x) && (0..image.height as i64).contains(&y) {
                image.pixel_mut(x as usize, y as usize)[index] = value;
            }
        }
    }
    Ok(ExrFile {
        image,
        channel_names: names_of(layer),
        metadata,
    })
}

/// The names of a part's channels.
fn names_of(layer: &Layer<AnyChannels<FlatSamples>>) -> Vec<String> {
    let channels = layer.channel_data.list.iter();
    channels.map(|channel| channel.name.to_string()).collect()
}

/// What the library says of a file, told apart: damage, and what it does not read.
fn refused(error: Error, path: &Path) -> ImageIoError {
    let message = error.to_string();
    let subsampled = ["subsampling", "sampling factor not dividing"];
    if subsampled.iter().any(|part| message.contains(part)) {
        return unsupported(SUBSAMPLED, path);
    }
    match error {
        Error::NotSupported(what) => {
            let problem = format!("uses a part of OpenEXR that is not supported ({what})");
            unsupported(&problem, path)
        }
        _ => ImageIoError::Decode {
            path: path.into(),
            reason: message,
        },
    }
}

fn unsupported(problem: &str, path: &Path) -> ImageIoError {
    ImageIoError::Unsupported {
        path: path.into(),
        problem: problem.to_owned(),
    }
}

/// The size of the image whose header `source` begins with, checked before anything is allocated for it.
pub(super) fn size(source: impl Read, path: &Path) -> Result<ImageSize, ImageIoError> {
    let damaged = |reason: String| ImageIoError::Decode {
        path: path.into(),
        reason,
    };
    let meta = MetaData::read_from_buffered(source, false).map_err(|error| refused(error, path))?;
    let (mut stored, mut shown) = (0_usize, 0);
    for header in &meta.headers {
        let channels = header.channels.list.len();
        let Vec2(width, height) = header.layer_size;
        check_size(path, width, height, channels)?;
        stored = stored.saturating_add(width * height * channels);
        let Vec2(width, height) = header.shared_attributes.display_window.size;
        check_size(path, width, height, channels)?;
        shown = shown.max(width * height * channels);
    }
    // Every layer is decoded: their sum is bounded as well.
    check_size(path, 1, 1, stored)?;
    let Some(first) = meta.headers.first() else {
        return Err(damaged("it has no layer".into()));
    };
    let Vec2(width, height) = first.shared_attributes.display_window.size;
    if shown > SMALL_WINDOW && shown / LARGEST_MARGIN > stored {
        return Err(ImageIoError::Window {
            path: path.into(),
            width,
            height,
            shown,
            stored,
        });
    }
    Ok(ImageSize {
        width,
        height,
        samples: stored.max(shown),
    })
}

/// Encodes `image` with one name a channel, ZIP-compressed; the same image gives the same bytes. `path` only names it
/// in errors.
pub fn encode_exr(
    image: &Image,
    channel_names: &[&str],
    options: &ExrOptions,
    path: &Path,
) -> Result<Vec<u8>, ImageIoError> {
    let fail = |reason: String| ImageIoError::Encode {
        path: path.into(),
        reason,
    };
    let text = |string: &str| {
        let text = Text::new_or_none(string).filter(|text| !text.as_slice().is_empty());
        text.ok_or_else(|| {
            fail(format!(
                "{string:?} is not a name or text that OpenEXR can hold (Latin-1, not empty)"
            ))
        })
    };
    if channel_names.len() != image.channels || image.channels == 0 {
        return Err(fail(format!(
            "{} channel names were given for {} channels",
            channel_names.len(),
            image.channels
        )));
    }
    if image.data.is_empty() || image.data.len() != image.width * image.height * image.channels {
        return Err(fail(format!(
            "{} values are not {} × {} pixels",
            image.data.len(),
            image.width,
            image.height
        )));
    }
    let mut channels = SmallVec::new();
    for (index, name) in channel_names.iter().enumerate() {
        let values = image.data.iter().skip(index).step_by(image.channels);
        let samples = match options.precision {
            Precision::Half => {
                FlatSamples::F16(values.map(|&value| f16::from_f32(value)).collect())
            }
            Precision::Float => FlatSamples::F32(values.copied().collect()),
        };
        channels.push(AnyChannel::new(text(name)?, samples));
    }
    let encoding = Encoding {
        compression: Compression::ZIP16,
        ..Encoding::SMALL_LOSSLESS
    };
    let size = (image.width, image.height);
    let layer = Layer::new(
        size,
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(channels),
    );
    let mut file = exr_image::Image::from_layer(layer);
    for (name, value) in &options.metadata {
        file.attributes
            .other
            .insert(text(name)?, AttributeValue::Text(text(value)?));
    }
    let mut bytes = Cursor::new(Vec::new());
    file.write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|error| fail(error.to_string()))?;
    let mut bytes = bytes.into_inner();
    sort_attributes(&mut bytes);
    Ok(bytes)
}

/// Puts the header's attributes in alphabetical order: the writer keeps those of ours in a hash map, whose order
/// changes from run to run. Lengths, and with them all offsets, stay.
fn sort_attributes(bytes: &mut [u8]) {
    const START: usize = 8; // magic and version
    let mut attributes: Vec<Vec<u8>> = Vec::new();
    let mut position = START;
    let text_end = |from: usize| {
        bytes[from..]
            .iter()
            .position(|&byte| byte == 0)
            .map(|length| from + length + 1)
    };
    while bytes.get(position).is_some_and(|&byte| byte != 0) {
        let Some(value) = text_end(position).and_then(text_end) else {
            return;
        };
        let Some(length) = bytes.get(value..value + 4) else {
            return;
        };
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
        let Some(attribute) = bytes.get(position..value + 4 + length) else {
            return;
        };
        attributes.push(attribute.to_vec());
        position = value + 4 + length;
    }
    attributes.sort();
    bytes[START..position].copy_from_slice(&attributes.concat());
}
