//! Photographs and masks that must load, in every form of the files, and what they become.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, LoadOptions, read_cameras},
    image_io::{ColorEncoding, srgb_to_linear, write_exr, write_png8},
};
use eclipse_tests::{
    on_disk::{load, save, written},
    small_capture::{SIZE, small_capture},
};
use glam::Vec3;
use image::{ImageBuffer, Luma, Rgb};
use render::image::Image;
use serde_json::json;

/// Replaces the EXR files by what `encode` writes, with masks in files of their own.
fn with_images(extension: &str, encode: impl Fn(&Path, &Image)) -> Capture {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    for (frame, entry) in capture
        .frames
        .iter()
        .zip(json["frames"].as_array_mut().unwrap())
    {
        fs::remove_file(path.join(format!("{}.exr", frame.name))).unwrap();
        let mut image = frame.image.clone();
        image
            .data
            .iter_mut()
            .for_each(|value| *value = value.min(1.0));
        encode(&path.join(format!("{}.{extension}", frame.name)), &image);
        write_png8(&path.join(format!("mask_{}.png", frame.name)), &frame.mask).unwrap();
        entry["file_path"] = json!(format!("./{}", frame.name));
        entry["mask_path"] = json!(format!("mask_{}.png", frame.name));
    }
    save(&folder, &json);
    load(&folder)
}

fn largest_difference(loaded: &Capture, expected: impl Fn(f32) -> f32) -> f32 {
    let original = small_capture(Vec3::ZERO);
    let pairs = loaded.frames.iter().zip(&original.frames);
    let values =
        pairs.flat_map(|(loaded, original)| loaded.image.data.iter().zip(&original.image.data));
    values
        .map(|(loaded, original)| (loaded - expected(original.min(1.0))).abs())
        .fold(0.0, f32::max)
}

#[test]
fn cameras_need_no_more_of_a_photograph_than_its_size() {
    let (folder, _, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    for name in ["w", "h"] {
        json.as_object_mut().unwrap().remove(name);
    }
    save(&folder, &json);
    let photograph = path.join("000.exr");
    let bytes = fs::read(&photograph).unwrap();
    fs::write(&photograph, &bytes[..bytes.len() / 2]).unwrap();
    let cameras = read_cameras(&path, None, false).unwrap();
    let sizes = cameras
        .iter()
        .map(|(_, camera)| [camera.width, camera.height]);
    assert!(sizes.into_iter().all(|size| size == SIZE));
    let error = Capture::load(&path, &LoadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("000.exr is damaged"), "{error}");
    // What is no image has no size either.
    fs::write(&photograph, "").unwrap();
    let error = read_cameras(&path, None, false).unwrap_err().to_string();
    assert!(
        error.contains("frame \"000.exr\"") && error.contains("000.exr is damaged"),
        "{error}"
    );
}

#[test]
fn every_image_format_loads_without_its_extension() {
    let integers = |image: &Image, peak: f32| {
        image
            .data
            .iter()
            .map(|v| (v * peak).round())
            .collect::<Vec<f32>>()
    };
    let (width, height) = (SIZE[0] as u32, SIZE[1] as u32);

    let exr = with_images("exr", |path, image| {
        write_exr(path, image, &["R", "G", "B"]).unwrap()
    });
    assert_eq!(largest_difference(&exr, |v| v), 0.0);

    let hdr = with_images("hdr", |path, image| {
        ImageBuffer::<Rgb<f32>, _>::from_raw(width, height, image.data.clone())
            .unwrap()
            .save(path)
            .unwrap();
    });
    assert!(
        largest_difference(&hdr, |v| v) < 1.0 / 128.0,
        "a shared exponent leaves eight bits"
    );

    let png8 = with_images("png", |path, image| write_png8(path, image).unwrap());
    assert!(largest_difference(&png8, srgb_to_linear) < 2.3 * 0.5 / 255.0);

    let png16 = with_images("PNG", |path, image| {
        let values = integers(image, 65535.0).iter().map(|&v| v as u16).collect();
        let buffer = ImageBuffer::<Rgb<u16>, Vec<u16>>::from_raw(width, height, values).unwrap();
        buffer
            .save_with_format(path, image::ImageFormat::Png)
            .unwrap();
    });
    assert!(largest_difference(&png16, srgb_to_linear) < 2.3 * 0.5 / 65535.0 + 1e-6);

    // JPEG loses detail: a flat grey is what it keeps.
    let jpeg = with_images("jpg", |path, _| {
        ImageBuffer::from_pixel(width, height, Luma([118_u8]))
            .save(path)
            .unwrap();
    });
    let grey = srgb_to_linear(118.0 / 255.0);
    assert!(
        jpeg.frames
            .iter()
            .flat_map(|frame| &frame.image.data)
            .all(|v| (v - grey).abs() < 0.01)
    );
    assert_eq!(jpeg.frames[0].image.channels, 3, "grey images become RGB");
}

/// A JPEG file that says `Orientation` 6: it is shown turned clockwise by a quarter.
fn lying_jpeg(path: &Path, width: u32, height: u32, value: impl Fn(u32, u32) -> u8) {
    let picture = ImageBuffer::from_fn(width, height, |x, y| Luma([value(x, y)]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    let format = image::ImageFormat::Jpeg;
    picture.write_to(&mut bytes, format).unwrap();
    let mut bytes = bytes.into_inner();
    let tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let exif = [&b"Exif\0\0"[..], tiff].concat();
    let length = (exif.len() as u16 + 2).to_be_bytes();
    // Behind the first marker, of the start.
    bytes.splice(2..2, [&[0xff, 0xe1], &length[..], &exif].concat());
    fs::write(path, bytes).unwrap();
}

#[test]
fn photographs_are_turned_where_their_declared_size_asks_for_it() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    let [width, height] = SIZE.map(|side| side as u32);
    let mask = path.join("mask.png");
    write_png8(&mask, &capture.frames[0].mask).unwrap();
    json["frames"][0]["file_path"] = json!("0.jpg");
    json["frames"][0]["mask_path"] = json!("mask.png");
    save(&folder, &json);
    // Shown, it grows brighter to the right: what is stored grows brighter upwards.
    lying_jpeg(&path.join("0.jpg"), height, width, |_, y| {
        (width - 1 - y) as u8
    });
    let image = &load(&folder).frames[0].image;
    assert_eq!([image.width, image.height], SIZE);
    for x in [0, 31, 63] {
        let expected = srgb_to_linear(x as f32 / 255.0);
        assert!((image.pixel(x, 20)[0] - expected).abs() < 0.006, "{x}");
    }

    // What is stored in the declared size is left as it is.
    lying_jpeg(&path.join("0.jpg"), width, height, |x, _| x as u8);
    let raw = &load(&folder).frames[0].image;
    assert!((raw.pixel(63, 20)[0] - srgb_to_linear(63.0 / 255.0)).abs() < 0.006);

    lying_jpeg(&path.join("0.jpg"), 30, 20, |_, _| 99);
    let message = Capture::load(&path, &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("has 30×20 pixels and the EXIF orientation 6, which turns it, but `w`"),
        "{message}"
    );
}

#[test]
fn values_that_are_not_finite_matter_where_the_object_is() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    let frame = &capture.frames[3];
    let outside = frame.mask.data.iter().position(|m| *m == 0.0).unwrap();
    let inside = frame.mask.data.iter().position(|m| *m == 1.0).unwrap();
    let spoiled = |pixel: usize, alpha: bool| {
        let names = ["R", "G", "B", "A"];
        let mut image = Image::filled(SIZE[0], SIZE[1], 3 + usize::from(alpha), 0.5);
        for (k, pixel) in image
            .data
            .chunks_exact_mut(3 + usize::from(alpha))
            .enumerate()
        {
            pixel[3..].fill(frame.mask.data[k]);
        }
        image.data[pixel * (3 + usize::from(alpha)) + 1] = f32::NAN;
        let names = &names[..image.channels];
        write_exr(&path.join("003.exr"), &image, names).unwrap();
    };
    write_png8(&path.join("mask.png"), &frame.mask).unwrap();
    for alpha in [true, false] {
        if !alpha {
            json["frames"][3]["mask_path"] = json!("mask.png");
            save(&folder, &json);
        }
        spoiled(outside, alpha);
        let image = &load(&folder).frames[3].image;
        assert_eq!(image.data[3 * outside..3 * outside + 3], [0.5, 0.0, 0.5]);
        spoiled(inside, alpha);
        let message = Capture::load(&path, &LoadOptions::default())
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("003.exr has 1 pixel that are NaN or infinite"),
            "{message}"
        );
    }
}

#[test]
fn a_mask_may_number_what_it_shows() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let mut mask = capture.frames[2].mask.clone();
    for value in &mut mask.data {
        *value = if *value > 0.5 { 2.0 / 255.0 } else { 0.0 };
    }
    write_png8(&folder.path().join("capture/labels.png"), &mask).unwrap();
    json["frames"][2]["mask_path"] = json!("labels.png");
    save(&folder, &json);
    let found = &load(&folder).frames[2].mask;
    let pairs = found.data.iter().zip(&mask.data);
    assert!(
        pairs
            .into_iter()
            .all(|(found, label)| *found == label.ceil())
    );
}

#[test]
fn a_mask_may_be_grey_and_serve_all_frames() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let mut mask = capture.frames[0].mask.clone();
    for value in &mut mask.data {
        *value = if *value > 0.5 { 128.0 / 255.0 } else { 0.0 };
    }
    write_png8(&folder.path().join("capture/mask.png"), &mask).unwrap();
    json["mask_path"] = json!("mask.png");
    json["frames"][2]["mask_path"] = json!("own.png");
    write_png8(
        &folder.path().join("capture/own.png"),
        &capture.frames[2].mask,
    )
    .unwrap();
    save(&folder, &json);
    let options = LoadOptions {
        min_overlap: 0.0,
        ..LoadOptions::default()
    };
    let loaded = Capture::load(&folder.path().join("capture"), &options).unwrap();
    let whole = |mask: &Image| mask.data.iter().map(|m| m.ceil()).collect::<Vec<f32>>();
    for (index, frame) in loaded.frames.iter().enumerate() {
        let own = if index == 2 {
            &capture.frames[2].mask
        } else {
            &mask
        };
        assert_eq!(whole(&frame.mask), whole(own), "{index}");
        assert!(frame.mask.data.contains(&1.0), "{index}");
    }
}

#[test]
fn the_color_encoding_can_be_stated() {
    let (folder, _, mut json) = written(Vec3::ZERO);
    json["color_encoding"] = json!("srgb");
    save(&folder, &json);
    assert!(largest_difference(&load(&folder), |v| v) > 0.1);
    let path = folder.path().join("capture");
    let options = LoadOptions {
        color_encoding: Some(ColorEncoding::Linear),
        ..LoadOptions::default()
    };
    let loaded = Capture::load(&path, &options).unwrap();
    assert_eq!(
        loaded.frames[0].image,
        small_capture(Vec3::ZERO).frames[0].image
    );
}
