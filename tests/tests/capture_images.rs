//! Image files: what is written is read back, and what is damaged is refused with one clear message.

use std::{collections::BTreeMap, path::Path};

use eclipse::image_io::{
    ColorEncoding, ExrOptions, MAX_SAMPLES, Precision, decode_exr, decode_image, decode_size,
    decode_turn, encode_exr, encode_png8, linear_to_srgb, read_exr, read_exr_file, read_image,
    read_size, srgb_to_linear, write_exr, write_exr_with, write_png8,
};
use proptest::prelude::*;
use render::image::Image;

/// A picture whose every value differs.
fn ramp(width: usize, height: usize, channels: usize) -> Image {
    let count = width * height * channels;
    Image {
        width,
        height,
        channels,
        data: (0..count).map(|i| i as f32 / count as f32).collect(),
    }
}

#[test]
fn exr_floats_survive_bit_for_bit_with_any_channel_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = ramp(7, 5, 3);
    write_exr(&path, &image, &["roughness", "Z", "specular"]).unwrap();
    let file = read_exr_file(&path).unwrap();
    assert_eq!(file.channel_names, ["Z", "roughness", "specular"]);
    assert_eq!(file.select(&["roughness", "Z", "specular"]).unwrap(), image);
    assert!(
        read_exr(&path)
            .unwrap_err()
            .to_string()
            .contains("has the channels Z, roughness, specular")
    );
}

#[test]
fn exr_half_keeps_eleven_bits_and_metadata() {
    let image = ramp(9, 4, 4);
    let metadata = BTreeMap::from([
        ("a".to_owned(), "1".to_owned()),
        ("convention".to_owned(), "z up".to_owned()),
    ]);
    let options = ExrOptions {
        precision: Precision::Half,
        metadata: metadata.clone(),
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr_with(&path, &image, &["R", "G", "B", "A"], &options).unwrap();
    assert_eq!(read_exr_file(&path).unwrap().metadata, metadata);
    let read = read_exr(&path).unwrap();
    for (read, written) in read.data.iter().zip(&image.data) {
        assert!(
            (read - written).abs() <= written / 2048.0,
            "{read} {written}"
        );
    }
}

#[test]
fn exr_bytes_are_a_function_of_the_image() {
    let metadata: BTreeMap<String, String> = (0..20)
        .map(|i| (format!("key {i}"), format!("value {i}")))
        .collect();
    let options = ExrOptions {
        precision: Precision::Float,
        metadata: metadata.clone(),
    };
    let encode = || encode_exr(&ramp(8, 8, 1), &["Y"], &options, Path::new("a.exr")).unwrap();
    let first = encode();
    assert_eq!(
        decode_exr(&first, Path::new("a.exr")).unwrap().metadata,
        metadata
    );
    for _ in 0..5 {
        assert_eq!(encode(), first);
    }
}

#[test]
fn unwritable_images_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let message = |error: eclipse::image_io::ImageIoError| error.to_string();
    assert!(
        message(write_exr(&path, &ramp(2, 2, 3), &["R"]).unwrap_err())
            .contains("1 channel names were given for 3")
    );
    assert!(
        message(write_exr(&path, &ramp(2, 2, 1), &["光"]).unwrap_err())
            .contains("not a name or text")
    );
    assert!(
        message(write_png8(&path, &ramp(2, 2, 2)).unwrap_err())
            .contains("1, 3 or 4 channels, not 2")
    );
    let nowhere = folder.path().join("missing/a.exr");
    assert!(
        message(write_exr(&nowhere, &ramp(2, 2, 1), &["Y"]).unwrap_err())
            .contains("check that the folder exists")
    );
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        0,
        "nothing may be left behind"
    );
}

#[test]
fn png_values_follow_the_encoding() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = Image {
        width: 2,
        height: 1,
        channels: 4,
        data: vec![0.0, 0.2, 1.0, 0.6, 0.4, 2.0, f32::NAN, 0.2],
    };
    write_png8(&path, &image).unwrap();
    let linear = read_image(&path, Some(ColorEncoding::Linear)).unwrap();
    assert_eq!(linear.data, [0.0, 0.2, 1.0, 0.6, 0.4, 1.0, 0.0, 0.2]);
    let srgb = read_image(&path, None).unwrap();
    assert_eq!(srgb.data[1], srgb_to_linear(0.2));
    assert_eq!(srgb.data[3], 0.6, "alpha carries no curve");
}

#[test]
fn exposures_of_radiance_files_are_undone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hdr");
    image::ImageBuffer::<image::Rgb<f32>, _>::from_raw(1, 1, vec![0.5, 0.25, 1.0])
        .unwrap()
        .save(&path)
        .unwrap();
    assert_eq!(read_image(&path, None).unwrap().data, [0.5, 0.25, 1.0]);
    let bytes = std::fs::read(&path).unwrap();
    let line = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    let with = |lines: &[u8]| {
        let spliced = [&bytes[..line], lines, &bytes[line..]].concat();
        decode_image(&spliced, &path, None)
    };
    let read = with(b"EXPOSURE=4\nEXPOSURE=0.5\nCOLORCORR=1 0.5 2\n").unwrap();
    assert_eq!(read.data, [0.25, 0.25, 0.25]);
    // Some programs begin such files otherwise.
    let other = [&b"#?RGBE\nEXPOSURE=2\n"[..], &bytes[line..]].concat();
    assert_eq!(
        decode_image(&other, &path, None).unwrap().data,
        [0.25, 0.125, 0.5]
    );
    std::fs::write(&path, &other).unwrap();
    let size = read_size(&path).unwrap();
    assert_eq!([size.width, size.height], [1, 1]);
    let message = with(b"EXPOSURE=0\n").unwrap_err().to_string();
    assert!(
        message.contains("a.hdr") && message.contains("EXPOSURE=0"),
        "{message}"
    );
}

#[test]
fn the_srgb_curve_has_its_published_values() {
    // IEC 61966-2-1: mid grey 118/255 is 0.18116, the straight part ends at 0.04045.
    assert!((srgb_to_linear(118.0 / 255.0) - 0.181_164).abs() < 1e-5);
    assert!((srgb_to_linear(0.04045) - 0.003_130_8).abs() < 1e-7);
    for i in 0..=100 {
        let value = i as f32 / 100.0;
        assert!((linear_to_srgb(srgb_to_linear(value)) - value).abs() < 1e-5);
    }
}

#[test]
fn absurd_sizes_are_refused_before_allocation() {
    // The header of a real file with its windows replaced: 2²⁰ × 2²⁰ pixels would need terabytes.
    let mut bytes = encode_exr(
        &ramp(4, 4, 1),
        &["Y"],
        &ExrOptions::default(),
        Path::new("a.exr"),
    )
    .unwrap();
    for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let start = bytes
            .windows(window.len())
            .position(|bytes| bytes == window)
            .unwrap()
            + window.len()
            + 4;
        bytes[start + 8..start + 12].copy_from_slice(&((1_u32 << 20) - 1).to_le_bytes());
        bytes[start + 12..start + 16].copy_from_slice(&((1_u32 << 20) - 1).to_le_bytes());
    }
    too_large(&bytes, "a.exr", "1048576 × 1048576 pixels of 1 channels");

    for (width, height) in [(2_000_000_000, 4), (65_000, 65_000), (0, 4)] {
        let mut bytes = encode_png8(&ramp(4, 4, 1), Path::new("a.png")).unwrap();
        bytes[16..20].copy_from_slice(&u32::to_be_bytes(width));
        bytes[20..24].copy_from_slice(&u32::to_be_bytes(height));
        // Of the chunk's name and its 13 bytes: else the file would only be damaged.
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        too_large(
            &bytes,
            "a.png",
            &format!("{width} × {height} pixels of 1 channels"),
        );
    }

    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut bytes)
        .encode(&[128; 8 * 8 * 3], 8, 8, image::ExtendedColorType::Rgb8)
        .unwrap();
    let frame = bytes.windows(2).position(|w| w == b"\xff\xc0").unwrap();
    // After the marker the length of two and the precision; then height and width.
    bytes[frame + 5..frame + 9].copy_from_slice(&[65_500_u16.to_be_bytes(); 2].concat());
    too_large(&bytes, "a.jpg", "65500 × 65500 pixels of 3 channels");

    let header = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2000000000 +X 1000000000\n";
    let whole = "1000000000 × 2000000000 pixels of 3 channels";
    too_large(header.as_bytes(), "a.hdr", whole);
}

/// Both who decodes and who only asks for the size are told that the file declares it, and what is read.
#[track_caller]
fn too_large(bytes: &[u8], name: &str, size: &str) {
    let path = Path::new(name);
    let message = decode_image(bytes, path, None).unwrap_err().to_string();
    for part in [
        &format!("{name} declares {size}"),
        "at least one of each and at most 65536 a side and 402653184 values are read",
        "scale the image down",
    ] {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
    let asked = decode_size(bytes, path).unwrap_err().to_string();
    assert_eq!(asked, message);
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

#[test]
fn sizes_and_turns_of_photographs_are_read_of_any_kind_of_jpeg() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds/image");
    for (name, channels, turn) in [
        ("baseline.jpg", 3, None),
        ("progressive.jpg", 3, None),
        ("turned.jpg", 1, Some(6)),
    ] {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        let path = Path::new(name);
        let image = decode_image(&bytes, path, None).unwrap();
        assert_eq!(
            [image.width, image.height, image.channels],
            [17, 9, channels]
        );
        let size = decode_size(&bytes, path).unwrap();
        assert_eq!(
            [size.width, size.height, size.samples],
            [17, 9, 153 * channels]
        );
        assert_eq!(
            decode_turn(&bytes, path).map(|turn| turn.exif()),
            turn,
            "{name}"
        );
    }
}

/// An OpenEXR file of one pixel in a display window of `side` × `side`.
fn one_pixel_in(side: u32) -> Vec<u8> {
    let options = ExrOptions::default();
    let mut bytes = encode_exr(&ramp(1, 1, 1), &["Y"], &options, Path::new("a.exr")).unwrap();
    let window = b"displayWindow\0box2i\0";
    let at = bytes.windows(window.len()).position(|w| w == window);
    // After the name the length of four, then the corners, the lower one first.
    let upper = at.unwrap() + window.len() + 4 + 8;
    for corner in [upper, upper + 4] {
        bytes[corner..corner + 4].copy_from_slice(&(side - 1).to_le_bytes());
    }
    bytes
}

/// An OpenEXR file of parts of 2 × 2 pixels, each with its name and channels that are all `value`, from 0 on.
fn parts(parts: &[(&str, &[&str])]) -> Vec<u8> {
    use exr::prelude::{
        AnyChannel, AnyChannels, Encoding, FlatSamples, Image, ImageAttributes, IntegerBounds,
        Layer, LayerAttributes, Layers, SmallVec, Text, WritableImage,
    };
    let mut value = 0.0;
    let mut layers = Layers::new();
    for (name, channels) in parts {
        let mut list = SmallVec::new();
        for channel in *channels {
            list.push(AnyChannel::new(
                Text::from(*channel),
                FlatSamples::F32(vec![value; 4]),
            ));
            value += 1.0;
        }
        layers.push(Layer::new(
            (2, 2),
            LayerAttributes::named(*name),
            Encoding::FAST_LOSSLESS,
            AnyChannels::sort(list),
        ));
    }
    let attributes = ImageAttributes::new(IntegerBounds::from_dimensions((2, 2)));
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image: Image<Layers<AnyChannels<FlatSamples>>> = Image::from_layers(attributes, layers);
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .unwrap();
    bytes.into_inner()
}

#[test]
fn the_picture_is_the_first_part_with_colours() {
    let path = Path::new("a.exr");
    let pixel = |bytes: &[u8]| {
        decode_image(bytes, path, None)
            .unwrap()
            .pixel(1, 1)
            .to_vec()
    };
    let bytes = parts(&[
        ("depth", &["Z"]),
        ("position", &["X", "Y", "Z"]),
        ("picture", &["R", "G", "B", "A"]),
        ("albedo", &["R", "G", "B"]),
    ]);
    assert_eq!(pixel(&bytes), [4.0, 5.0, 6.0, 7.0]);
    let names = decode_exr(&bytes, path).unwrap().channel_names;
    assert_eq!(names, ["A", "B", "G", "R"]);
    let bytes = parts(&[("a", &["r", "g", "b", "Z"])]);
    assert_eq!(pixel(&bytes), [0.0, 1.0, 2.0]);
    let none = parts(&[("position", &["X", "Y", "Z"]), ("depth", &["Z"])]);
    let message = decode_image(&none, path, None).unwrap_err().to_string();
    assert!(message.contains("has the channels X, Y, Z"), "{message}");
}

#[test]
fn subsampled_channels_are_called_so_and_not_damaged() {
    for side in [4, 5] {
        let path = Path::new("a.exr");
        let options = ExrOptions::default();
        let mut bytes = encode_exr(&ramp(side, side, 1), &["Y"], &options, path).unwrap();
        let list = b"channels\0chlist\0";
        let at = bytes.windows(list.len()).position(|w| w == list).unwrap();
        // After the list's length: the name, the type and whether it is linear, then the steps across and down.
        let steps = at + list.len() + 4 + 2 + 4 + 4;
        assert_eq!(bytes[steps..steps + 8], [1, 0, 0, 0, 1, 0, 0, 0]);
        bytes[steps] = 2;
        bytes[steps + 4] = 2;
        let message = decode_image(&bytes, path, None).unwrap_err().to_string();
        assert!(
            message.contains("a.exr has subsampled channels, which are not supported"),
            "{message}"
        );
    }
}

#[test]
fn a_display_window_is_not_gigabytes_around_a_pixel() {
    let path = Path::new("a.exr");
    // A margin is read, as one finds it around what was rendered in part.
    let image = decode_image(&one_pixel_in(64), path, None).unwrap();
    assert_eq!((image.width, image.height), (64, 64));
    let message = decode_image(&one_pixel_in(20_000), path, None)
        .unwrap_err()
        .to_string();
    for part in [
        "a.exr has a display window of 20000 × 20000 pixels",
        "400000000 values of which 1 are stored",
        "crop the display window",
    ] {
        assert!(message.contains(part), "{message}");
    }
    // The size that is told beforehand is that of the window, and refused alike.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    std::fs::write(&path, one_pixel_in(64)).unwrap();
    assert_eq!(read_size(&path).unwrap().samples, 64 * 64);
    std::fs::write(&path, one_pixel_in(20_000)).unwrap();
    assert_eq!(
        read_size(&path).unwrap_err().to_string(),
        decode_image(&one_pixel_in(20_000), &path, None)
            .unwrap_err()
            .to_string()
    );
}

#[test]
fn the_largest_image_is_an_environment_of_16384_columns() {
    assert_eq!(MAX_SAMPLES, 16_384 * 8_192 * 3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    // The header alone says it: no pixel is decoded.
    let declaring = |width: u32, height: u32| {
        let mut bytes = encode_exr(
            &ramp(2, 2, 3),
            &["R", "G", "B"],
            &ExrOptions::default(),
            &path,
        )
        .unwrap();
        for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
            let at = bytes.windows(window.len()).position(|w| w == window);
            let upper = at.unwrap() + window.len() + 4 + 8;
            bytes[upper..upper + 4].copy_from_slice(&(width - 1).to_le_bytes());
            bytes[upper + 4..upper + 8].copy_from_slice(&(height - 1).to_le_bytes());
        }
        std::fs::write(&path, bytes).unwrap();
        read_size(&path)
    };
    assert_eq!(declaring(16_384, 8_192).unwrap().samples, MAX_SAMPLES);
    let message = declaring(16_384, 8_193).unwrap_err().to_string();
    assert!(message.contains("scale the image down"), "{message}");
}

proptest! {
    #[test]
    fn truncated_and_altered_images_never_panic(cut in 0_usize..90, at in any::<prop::sample::Index>(), byte: u8) {
        let path = Path::new("a");
        let exr = encode_exr(&ramp(6, 5, 3), &["R", "G", "B"], &ExrOptions::default(), path).unwrap();
        let png = encode_png8(&ramp(6, 5, 3), path).unwrap();
        for mut bytes in [exr, png] {
            prop_assert!(decode_image(&bytes[..bytes.len() * cut / 100], path, None).is_err());
            let at = at.index(bytes.len());
            bytes[at] = byte;
            let _ = decode_image(&bytes, path, None);
        }
    }
}
