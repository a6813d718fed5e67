//! COLMAP models whose photographs lie elsewhere, and captures with several of them.

use std::{
    fs,
    path::{Path, PathBuf},
};

use eclipse::{
    capture::{Capture, LoadOptions, Source, formats::colmap::Encoding, read_cameras, write},
    inspect::inspect,
    settings::Settings,
};
use eclipse_tests::{
    colmap_model,
    small_capture::{SIZE, small_capture},
};
use glam::Vec3;
use tempfile::TempDir;

const ENCODINGS: [Encoding; 2] = [Encoding::Binary, Encoding::Text];

/// A folder for all, and the capture of the small model in it.
fn colmap(encoding: Encoding) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    colmap_model::write(&path, &small_capture(Vec3::ZERO), encoding);
    (folder, path)
}

/// Makes the model of these frames the capture's model of this number, beside its others.
fn add(path: &Path, number: u32, frames: &[usize], encoding: Encoding) {
    let mut capture = small_capture(Vec3::ZERO);
    let all = capture.frames;
    capture.frames = frames.iter().map(|&index| all[index].clone()).collect();
    let beside = path.with_extension("more");
    colmap_model::write(&beside, &capture, encoding);
    let place = path.join(format!("sparse/{number}"));
    fs::rename(beside.join("sparse/0"), place).unwrap();
    fs::remove_dir_all(beside).unwrap();
}

fn load(path: &Path) -> Capture {
    Capture::load(path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn describe(path: &Path) -> Source {
    Capture::describe(path, &LoadOptions::default()).unwrap()
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.frames.iter().map(|frame| &*frame.name).collect()
}

fn in_folder(images: &Path) -> LoadOptions {
    LoadOptions {
        images: Some(images.into()),
        ..LoadOptions::default()
    }
}

#[track_caller]
fn says(path: &Path, options: &LoadOptions, parts: &[&str]) {
    let error = Capture::load(path, options).map(drop).expect_err("refused");
    let message = error.to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
    assert!(!message.contains('\n'), "one line: {message}");
}

#[test]
fn photographs_may_lie_wherever_the_user_says() {
    let (folder, path) = colmap(Encoding::Binary);
    let usual = load(&path);
    // Out of the capture's folder, which nobody else may lead to.
    let elsewhere = folder.path().join("my photographs");
    fs::rename(path.join("images"), &elsewhere).unwrap();
    let parts = ["images.bin", "images/ is not there", "--images"];
    says(&path, &LoadOptions::default(), &parts);

    let found = Capture::load(&path, &in_folder(&elsewhere)).unwrap();
    assert_eq!(names(&found), names(&usual));
    for (found, usual) in found.frames.iter().zip(&usual.frames) {
        assert_eq!(found.image, usual.image);
        assert_eq!(found.camera, usual.camera);
    }
    // Cameras say their own size: whoever asks for them alone needs no photograph.
    let cameras = read_cameras(&path, None, false).unwrap();
    assert_eq!(cameras.len(), 6);
    assert_eq!([cameras[0].1.width, cameras[0].1.height], SIZE);
}

#[test]
fn what_is_named_for_the_photographs_must_be_their_folder() {
    let (folder, path) = colmap(Encoding::Binary);
    let nowhere = in_folder(&folder.path().join("nowhere"));
    says(&path, &nowhere, &["--images ", "nowhere: "]);
    let file = in_folder(&path.join("mesh.glb"));
    says(
        &path,
        &file,
        &["mesh.glb: it is no folder", "expected the folder"],
    );
    let other = in_folder(&path.join("sparse"));
    says(
        &other_frame(&path),
        &other,
        &["`NAME`", "sparse/000.png, which does not exist"],
    );
}

/// The same capture with one frame alone: what is wrong with all of several is a longer message.
fn other_frame(path: &Path) -> PathBuf {
    fs::remove_dir_all(path.join("sparse/0")).unwrap();
    add(path, 0, &[0], Encoding::Binary);
    path.into()
}

#[test]
fn names_do_not_lead_out_of_the_folder_of_photographs() {
    let (folder, path) = colmap(Encoding::Text);
    let images = folder.path().join("photographs");
    fs::rename(path.join("images"), &images).unwrap();
    fs::copy(images.join("005.png"), folder.path().join("005.png")).unwrap();
    let model = path.join("sparse/0/images.txt");
    let text = fs::read_to_string(&model).unwrap();
    fs::write(&model, text.replace("005.png", "../005.png")).unwrap();
    says(
        &path,
        &in_folder(&images),
        &["`NAME`", "outside the capture's folder"],
    );
}

#[test]
fn captures_that_name_the_place_of_their_photographs_are_told_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    write(&path, &small_capture(Vec3::ZERO)).unwrap();
    let parts = ["transforms.json", "`file_path`", "--images ", "COLMAP"];
    says(&path, &in_folder(folder.path()), &parts);
}

#[test]
fn of_several_models_the_one_with_the_most_images_is_taken_and_told() {
    for encoding in ENCODINGS {
        let (_folder, path) = colmap(encoding);
        fs::remove_dir_all(path.join("sparse/0")).unwrap();
        add(&path, 0, &[0, 1], encoding);
        add(&path, 1, &[1, 2, 3, 5], encoding);
        add(&path, 10, &[0, 3, 4, 5], encoding);
        add(&path, 2, &[4], encoding);
        // Neither a number nor a model.
        fs::create_dir(path.join("sparse/old")).unwrap();
        fs::create_dir(path.join("sparse/7")).unwrap();
        assert_eq!(names(&load(&path)), ["001", "002", "003", "005"]);
        let source = describe(&path);
        assert!(source.path.parent().unwrap().ends_with("sparse/1"));
        let [note] = &*source.notes else {
            panic!("{:?}", source.notes)
        };
        assert!(
            note.starts_with("of 4 COLMAP models the one in sparse/1 is used"),
            "{note}"
        );
        assert!(
            note.contains("images, 4; sparse/0 has 2, sparse/2 has 1, sparse/10 has 4:"),
            "{note}"
        );
        let (inspection, _) = inspect(&path, LoadOptions::default(), &Settings::default()).unwrap();
        assert!(
            inspection.warnings.contains(note),
            "{:?}",
            inspection.warnings
        );
    }
}

#[test]
fn a_model_alone_is_nothing_to_tell_whatever_its_number() {
    let (_folder, path) = colmap(Encoding::Binary);
    assert!(describe(&path).notes.is_empty());
    fs::rename(path.join("sparse/0"), path.join("sparse/3")).unwrap();
    assert!(describe(&path).notes.is_empty());
    assert_eq!(load(&path).frames.len(), 6);
    // One that cannot be read beside it is not taken for it.
    fs::create_dir(path.join("sparse/0")).unwrap();
    fs::write(path.join("sparse/0/images.bin"), "short").unwrap();
    assert_eq!(load(&path).frames.len(), 6);
}
