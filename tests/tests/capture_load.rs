//! Captures that must load, in every form of the fields and files, and what they become.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, LoadOptions, mask_overlap, write},
    image_io::{ColorEncoding, srgb_to_linear, write_exr, write_png8},
    mesh_io::{GlbSurface, write_glb},
};
use eclipse_tests::small_capture::{SIZE, small_capture};
use glam::Vec3;
use image::{ImageBuffer, Luma, Rgb};
use render::image::Image;
use serde_json::{Value, json};
use tempfile::TempDir;

/// A written capture and its `transforms.json`.
fn written(centre: Vec3) -> (TempDir, Capture, Value) {
    let folder = tempfile::tempdir().unwrap();
    let capture = small_capture(centre);
    write(&folder.path().join("capture"), &capture).unwrap();
    let folder_path = folder.path().join("capture");
    let json =
        serde_json::from_slice(&fs::read(folder_path.join("transforms.json")).unwrap()).unwrap();
    (folder, capture, json)
}

fn save(folder: &TempDir, json: &Value) {
    fs::write(
        folder.path().join("capture/transforms.json"),
        json.to_string(),
    )
    .unwrap();
}

fn load(folder: &TempDir) -> Capture {
    Capture::load(&folder.path().join("capture"), &LoadOptions::default())
        .unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn what_is_written_is_loaded_and_recentred() {
    let centre = Vec3::new(3.0, -2.0, 7.0);
    let (folder, capture, _) = written(centre);
    let loaded = load(&folder);
    assert!((loaded.centre - centre).length() < 1e-5);
    assert_eq!(loaded.frames.len(), 6);
    for (loaded, original) in loaded.frames.iter().zip(&capture.frames) {
        assert_eq!(loaded.name, original.name);
        assert!(
            loaded
                .camera
                .world_from_camera
                .abs_diff_eq(original.camera.world_from_camera, 1e-5)
        );
        assert_eq!(loaded.camera.focal, original.camera.focal);
        assert_eq!(loaded.camera.principal, original.camera.principal);
        assert_eq!(loaded.camera.distortion, original.camera.distortion);
        assert_eq!(
            loaded.image, original.image,
            "multiples of 1/64 are exact in half floats"
        );
        assert!(
            loaded
                .mask
                .data
                .iter()
                .zip(&original.mask.data)
                .all(|(a, b)| (a - b).abs() < 1e-3)
        );
    }
    assert_eq!(loaded.mesh.faces, capture.mesh.faces);
    for (loaded, original) in loaded.mesh.positions.iter().zip(&capture.mesh.positions) {
        assert!((*loaded - *original).length() < 1e-5);
    }
}

#[test]
fn writing_never_overwrites_and_leaves_nothing_when_it_fails() {
    let (folder, capture, _) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    assert!(
        write(&path, &capture)
            .unwrap_err()
            .to_string()
            .contains("is not empty")
    );
    let mut unwritable = capture;
    unwritable.frames[3].name = "missing-folder/a".into();
    assert!(write(&folder.path().join("other"), &unwritable).is_err());
    let entries: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(entries, ["capture"]);
}

#[test]
fn angles_of_view_stand_in_for_focal_lengths_shared_or_not() {
    let (folder, capture, json) = written(Vec3::ZERO);
    let focal = capture.frames[0].camera.focal[0];
    for field in ["camera_angle_x", "fl_x"] {
        for shared in [true, false] {
            let mut json = json.clone();
            for name in ["camera_angle_x", "fl_x", "fl_y"] {
                let value = json.as_object_mut().unwrap().remove(name).unwrap();
                if name != field {
                    continue;
                }
                let [root, frames] = [!shared, shared];
                // The value that must not be used is a different one.
                json[name] = if root {
                    json!(value.as_f64().unwrap() * 0.5)
                } else {
                    value.clone()
                };
                for frame in json["frames"]
                    .as_array_mut()
                    .unwrap()
                    .iter_mut()
                    .filter(|_| !frames)
                {
                    frame[name] = value.clone();
                }
            }
            save(&folder, &json);
            for frame in load(&folder).frames {
                assert!(
                    (frame.camera.focal[0] - focal).abs() < 1e-4 * focal,
                    "{field} {shared}"
                );
                assert_eq!(frame.camera.focal[0], frame.camera.focal[1]);
            }
        }
    }
}

#[test]
fn poses_may_have_three_rows_and_sizes_may_be_floats_or_absent() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    for frame in json["frames"].as_array_mut().unwrap() {
        frame["transform_matrix"].as_array_mut().unwrap().pop();
    }
    // Rounding errors of whoever computed it, and the mark that editors on Windows put before a text.
    let rows = json["frames"][1]["transform_matrix"].as_array_mut();
    rows.unwrap().push(json!([0.0, -1e-9, 2e-8, 1.0 - 1e-7]));
    json["w"] = json!(64.0);
    json.as_object_mut().unwrap().remove("h");
    let path = folder.path().join("capture/transforms.json");
    fs::write(path, format!("\u{feff}{json}")).unwrap();
    let loaded = load(&folder);
    assert_eq!(
        [
            loaded.frames[0].camera.width,
            loaded.frames[0].camera.height
        ],
        SIZE
    );
    let [found, wanted] =
        [&loaded, &capture].map(|capture| capture.frames[2].camera.world_from_camera);
    assert!(found.abs_diff_eq(wanted, 1e-5));
}

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

#[test]
fn the_mesh_may_be_named_by_the_user_or_by_the_capture() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    let elsewhere = folder.path().join("shape.glb");
    fs::rename(path.join("mesh.glb"), &elsewhere).unwrap();
    let options = LoadOptions {
        mesh: Some(elsewhere.clone()),
        ..LoadOptions::default()
    };
    assert_eq!(
        Capture::load(&path, &options).unwrap().mesh.faces,
        capture.mesh.faces
    );
    fs::rename(elsewhere, path.join("points.glb")).unwrap();
    json["ply_file_path"] = json!("points.glb");
    save(&folder, &json);
    assert_eq!(load(&folder).mesh.faces, capture.mesh.faces);
}

#[test]
fn equal_names_in_different_folders_are_told_apart() {
    let (folder, _, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    for (index, split) in ["train", "test"].into_iter().enumerate() {
        fs::create_dir(path.join(split)).unwrap();
        fs::rename(
            path.join(format!("00{index}.exr")),
            path.join(split).join("r_0.exr"),
        )
        .unwrap();
        json["frames"][index]["file_path"] = json!(format!(".\\{split}\\r_0"));
    }
    save(&folder, &json);
    let names: Vec<String> = load(&folder)
        .frames
        .into_iter()
        .map(|frame| frame.name)
        .collect();
    assert_eq!(names, ["train_r_0", "test_r_0", "002", "003", "004", "005"]);
}

#[test]
fn names_may_hold_dots() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    for index in 0..3 {
        let name = format!("view.{index:03}");
        fs::rename(
            path.join(format!("{index:03}.exr")),
            path.join(format!("{name}.exr")),
        )
        .unwrap();
        // With the ending and without.
        let ending = if index == 0 { ".exr" } else { "" };
        json["frames"][index]["file_path"] = json!(format!("./{name}{ending}"));
    }
    save(&folder, &json);
    let loaded = load(&folder);
    let names: Vec<&str> = loaded.frames.iter().map(|frame| &*frame.name).collect();
    assert_eq!(
        names,
        ["view.000", "view.001", "view.002", "003", "004", "005"]
    );
    assert_eq!(loaded.frames[1].image, capture.frames[1].image);
}

#[test]
fn files_outside_are_read_when_allowed() {
    let (folder, capture, mut json) = written(Vec3::ZERO);
    let path = folder.path().join("capture");
    fs::rename(path.join("000.exr"), folder.path().join("000.exr")).unwrap();
    json["frames"][0]["file_path"] = json!("../000.exr");
    save(&folder, &json);
    let options = LoadOptions {
        allow_outside: true,
        ..LoadOptions::default()
    };
    assert_eq!(
        Capture::load(&path, &options).unwrap().frames[0].image,
        capture.frames[0].image
    );
    assert!(Capture::load(&path, &LoadOptions::default()).is_err());
}

#[test]
fn loading_does_not_depend_on_the_number_of_threads() {
    let (folder, _, _) = written(Vec3::new(0.1, 0.2, 0.3));
    let path = folder.path().join("capture");
    let load = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            format!(
                "{:?}",
                Capture::load(&path, &LoadOptions::default()).unwrap()
            )
        })
    };
    assert_eq!(load(1), load(4));
}

#[test]
fn the_bundled_capture_loads_and_its_mesh_fits() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("captures/potatoes");
    let capture = Capture::load(&path, &LoadOptions::default()).unwrap();
    assert_eq!(capture.frames.len(), 24);
    assert!(
        capture
            .frames
            .iter()
            .all(|frame| mask_overlap(&capture.mesh, frame) > 0.98)
    );
}

#[test]
fn a_mesh_far_from_the_origin_and_of_any_size_is_handled() {
    // All lengths a thousand times larger, and a thousand radii away.
    let mut capture = small_capture(Vec3::new(1e3, 0.0, 5e2));
    for position in &mut capture.mesh.positions {
        *position *= 10.0;
    }
    for frame in &mut capture.frames {
        frame.camera.world_from_camera.w_axis *= glam::Vec4::new(10.0, 10.0, 10.0, 1.0);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    write(&path, &capture).unwrap();
    write_glb(
        &folder.path().join("again.glb"),
        &capture.mesh,
        &GlbSurface::default(),
    )
    .unwrap();
    let loaded = Capture::load(&path, &LoadOptions::default()).unwrap();
    assert!((loaded.centre - capture.centre).length() < 1e-3);
    assert!(
        loaded
            .frames
            .iter()
            .all(|frame| mask_overlap(&loaded.mesh, frame) > 0.9)
    );
}
