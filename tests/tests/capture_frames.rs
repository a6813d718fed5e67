//! What is wrong with several frames of a capture is told at once; masks of numbers that no light comes from.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, CaptureError, Frame, LoadOptions, formats::colmap::Encoding, write},
    image_io::write_png8,
};
use eclipse_tests::{
    colmap_model,
    small_capture::{SIZE, small_capture},
};
use glam::Vec3;
use render::image::Image;
use serde_json::{Value, json};
use tempfile::TempDir;

/// The small capture, its frames repeated until they are `count`.
fn written(count: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = small_capture(Vec3::ZERO);
    let frames = capture.frames.iter().cycle().enumerate().take(count);
    capture.frames = frames
        .map(|(index, frame)| Frame {
            name: format!("{index:03}"),
            ..frame.clone()
        })
        .collect();
    write(&folder.path().join("capture"), &capture).unwrap();
    folder
}

fn error(folder: &TempDir) -> CaptureError {
    let loaded = Capture::load(&folder.path().join("capture"), &LoadOptions::default());
    loaded.map(drop).expect_err("frames are bad")
}

fn spoil(folder: &TempDir, index: usize) {
    let path = folder.path().join(format!("capture/{index:03}.exr"));
    fs::write(path, "no picture").unwrap();
}

/// Gives every frame the mask in `mask.png`, of these values of 255.
fn mask_all(folder: &TempDir, values: &[u8]) {
    let capture = folder.path().join("capture");
    let mask = (0..SIZE[0] * SIZE[1]).map(|i| f32::from(values[i % values.len()]) / 255.0);
    let mask = Image {
        width: SIZE[0],
        height: SIZE[1],
        channels: 1,
        data: mask.collect(),
    };
    write_png8(&capture.join("mask.png"), &mask).unwrap();
    edit(&capture, |json| {
        for frame in json["frames"].as_array_mut().unwrap() {
            frame["mask_path"] = json!("mask.png");
        }
    });
}

fn edit(capture: &Path, change: impl FnOnce(&mut Value)) {
    let path = capture.join("transforms.json");
    let mut json = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut json);
    fs::write(path, json.to_string()).unwrap();
}

#[test]
fn all_frames_that_cannot_be_used_are_told_in_their_order() {
    let folder = written(6);
    for index in [4, 1] {
        spoil(&folder, index);
    }
    edit(&folder.path().join("capture"), |json| {
        json["frames"][2]["transform_matrix"] = json!([]);
    });
    let message = error(&folder).to_string();
    let lines: Vec<&str> = message.lines().collect();
    assert_eq!(lines.len(), 4, "{message}");
    assert!(
        lines[0].ends_with("transforms.json: 3 of 6 frames cannot be used:"),
        "{message}"
    );
    for (line, parts) in lines[1..].iter().zip([
        ["  frame \"001\"", "001.exr is damaged"],
        ["  frame \"002\"", "`transform_matrix` is missing or empty"],
        ["  frame \"004\"", "004.exr is damaged"],
    ]) {
        assert!(
            line.starts_with(parts[0]) && line.contains(parts[1]),
            "{message}"
        );
    }
}

#[test]
fn what_is_wrong_with_several_frames_alike_is_told_once() {
    let folder = written(6);
    mask_all(&folder, &[0, 40]);
    let message = error(&folder).to_string();
    assert!(
        message.contains("transforms.json: frame \"000\" and 5 more: the largest value"),
        "{message}"
    );
    assert!(!message.contains('\n'), "{message}");
    spoil(&folder, 2);
    let message = error(&folder).to_string();
    let lines: Vec<&str> = message.lines().collect();
    assert_eq!(lines.len(), 3, "{message}");
    assert!(lines[0].contains("6 of 6 frames"), "{message}");
    assert!(
        lines[1].starts_with("  frame \"000\" and 4 more: "),
        "{message}"
    );
    assert!(lines[2].starts_with("  frame \"002\": "), "{message}");
}

#[test]
fn no_more_than_twenty_are_told_and_the_rest_counted() {
    let folder = written(24);
    (1..24).for_each(|index| spoil(&folder, index));
    let message = error(&folder).to_string();
    let lines: Vec<&str> = message.lines().collect();
    assert_eq!(lines.len(), 22, "{message}");
    assert!(lines[0].contains("23 of 24 frames"), "{message}");
    assert!(lines[20].contains("\"020\""), "{message}");
    assert_eq!(lines[21], "  and 3 more");
}

#[test]
fn one_bad_frame_is_told_alone() {
    let folder = written(6);
    spoil(&folder, 3);
    let message = error(&folder).to_string();
    assert!(message.starts_with("frame \"003\": "), "{message}");
    assert!(!message.contains('\n'), "{message}");
}

#[test]
fn all_photographs_that_a_colmap_model_names_in_vain_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let capture = folder.path().join("capture");
    colmap_model::write(&capture, &small_capture(Vec3::ZERO), Encoding::Binary);
    for name in ["002", "005"] {
        fs::remove_file(capture.join(format!("images/{name}.png"))).unwrap();
    }
    let message = error(&folder).to_string();
    assert!(
        message.contains("images.bin: 2 of 6 frames cannot be used:\n"),
        "{message}"
    );
    for name in ["images/002.png, which", "images/005.png, which"] {
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn masks_of_labels_beyond_the_smallest_numbers_are_told_from_empty_ones() {
    let folder = written(1);
    mask_all(&folder, &[0, 3, 40]);
    let message = error(&folder).to_string();
    for part in [
        "frame \"000\": the largest value of the mask in ",
        "mask.png is 40 of 255",
        "only what is above one half counts",
        "labels, paint the object's white and all else black",
    ] {
        assert!(message.contains(part), "{message}");
    }
    // Whatever numbers: the last that is no longer coverage, and the first that is a label's.
    for (largest, told) in [(127, "127 of 255"), (9, "9 of 255")] {
        mask_all(&folder, &[0, largest]);
        let message = error(&folder).to_string();
        assert!(message.contains(told), "{message}");
    }
    mask_all(&folder, &[0]);
    let message = error(&folder).to_string();
    assert!(message.contains("mask.png is empty"), "{message}");
}
