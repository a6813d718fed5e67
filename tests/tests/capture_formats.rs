//! Captures in the formats of other programs: what they become, and what is said of broken ones.

use std::{fs, path::Path};

use eclipse::capture::{
    Capture, LoadOptions,
    formats::colmap::{Encoding, parse_model, read_points},
    mask_overlap, write,
};
use eclipse_tests::{colmap_model, small_capture::small_capture};
use glam::Vec3;
use serde_json::{Value, json};
use tempfile::TempDir;

const CENTRE: Vec3 = Vec3::new(3.0, -2.0, 1.0);
const ENCODINGS: [(Encoding, &str); 2] = [(Encoding::Binary, "bin"), (Encoding::Text, "txt")];

fn colmap(encoding: Encoding) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    colmap_model::write(folder.path(), &small_capture(CENTRE), encoding);
    folder
}

fn load(folder: &Path) -> Capture {
    Capture::load(folder, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn says(folder: &Path, parts: &[&str]) {
    let error = Capture::load(folder, &LoadOptions::default())
        .map(|_| ())
        .expect_err("it is broken");
    let message = error.to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
    assert!(!message.contains('\n'), "one line: {message}");
}

/// What is said after `spoil` changed the bytes of a file of a COLMAP model.
#[track_caller]
fn colmap_says(encoding: Encoding, file: &str, spoil: impl FnOnce(&mut Vec<u8>), parts: &[&str]) {
    let folder = colmap(encoding);
    let path = folder.path().join("sparse/0").join(file);
    let mut bytes = fs::read(&path).unwrap();
    spoil(&mut bytes);
    fs::write(&path, bytes).unwrap();
    says(folder.path(), parts);
}

#[track_caller]
fn text_says(file: &str, from: &str, to: &str, parts: &[&str]) {
    let spoil = |bytes: &mut Vec<u8>| {
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(text.contains(from), "{text}");
        *bytes = text.replacen(from, to, 1).into_bytes();
    };
    colmap_says(Encoding::Text, file, spoil, parts);
}

#[test]
fn colmap_models_become_the_cameras_they_were_made_of() {
    let original = small_capture(CENTRE);
    for (encoding, extension) in ENCODINGS {
        let folder = colmap(encoding);
        let capture = load(folder.path());
        assert!((capture.centre - CENTRE).length() < 1e-4);
        assert_eq!(capture.frames.len(), original.frames.len());
        for (found, made) in capture.frames.iter().zip(&original.frames) {
            assert_eq!(found.name, made.name, "sorted by name");
            let (found, made) = (&found.camera, &made.camera);
            let (pose, true_pose) = (found.world_from_camera, made.world_from_camera);
            assert!(pose.abs_diff_eq(true_pose, 1e-4), "{pose} {true_pose}");
            assert_eq!(found.focal, made.focal);
            assert_eq!(found.principal, made.principal);
            assert_eq!(found.distortion, made.distortion);
        }
        let overlaps = capture
            .frames
            .iter()
            .map(|f| mask_overlap(&capture.mesh, f));
        assert!(overlaps.fold(1.0, f32::min) > 0.9);

        let source = Capture::describe(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!(source.format, "COLMAP");
        let points = source.points.expect("points3D is there");
        assert!(points.ends_with(format!("points3D.{extension}")));
        let points = read_points(&points).unwrap();
        assert_eq!(points.len(), original.mesh.positions.len());
        for (point, position) in points.iter().zip(&original.mesh.positions) {
            assert!((*point - *position - CENTRE).length() < 1e-5);
        }
    }
}

#[cfg(unix)]
#[test]
fn files_of_a_colmap_model_lie_in_the_folder() {
    for (encoding, extension) in ENCODINGS {
        for name in ["cameras", "images", "points3D"] {
            let (folder, elsewhere) = (colmap(encoding), tempfile::tempdir().unwrap());
            let name = format!("{name}.{extension}");
            let (file, other) = (
                folder.path().join("sparse/0").join(&name),
                elsewhere.path().join(&name),
            );
            fs::copy(&file, &other).unwrap();
            fs::remove_file(&file).unwrap();
            std::os::unix::fs::symlink(&other, &file).unwrap();
            says(
                folder.path(),
                &[
                    &name,
                    "leads out of the capture's folder",
                    "--allow-outside",
                ],
            );
            let trusted = LoadOptions {
                allow_outside: true,
                ..LoadOptions::default()
            };
            Capture::load(folder.path(), &trusted).unwrap();
        }
    }
}

#[test]
fn colmap_models_may_lie_in_the_folder_itself() {
    let folder = colmap(Encoding::Text);
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        fs::rename(
            folder.path().join("sparse/0").join(name),
            folder.path().join(name),
        )
        .unwrap();
    }
    assert_eq!(load(folder.path()).frames.len(), 6);
}

#[test]
fn every_supported_camera_model_of_colmap_is_read() {
    // The mesh's silhouette does not matter here.
    let options = LoadOptions {
        min_overlap: 0.0,
        ..LoadOptions::default()
    };
    let cases = [
        ("SIMPLE_PINHOLE", "100 31 23", [100.0, 100.0], [0.0; 4]),
        ("PINHOLE", "100 90 31 23", [100.0, 90.0], [0.0; 4]),
        (
            "SIMPLE_RADIAL",
            "100 31 23 0.1",
            [100.0; 2],
            [0.1, 0.0, 0.0, 0.0],
        ),
        (
            "RADIAL",
            "100 31 23 0.1 0.2",
            [100.0; 2],
            [0.1, 0.2, 0.0, 0.0],
        ),
        (
            "OPENCV",
            "100 90 31 23 0.1 0.2 0.3 0.4",
            [100.0, 90.0],
            [0.1, 0.2, 0.3, 0.4],
        ),
    ];
    let binary_numbers = [0i32, 1, 2, 3, 4];
    for ((model, parameters, focal, distortion), number) in cases.into_iter().zip(binary_numbers) {
        for (encoding, extension) in ENCODINGS {
            let folder = colmap(encoding);
            let path = folder.path().join(format!("sparse/0/cameras.{extension}"));
            let bytes = match encoding {
                Encoding::Text => (1..=6)
                    .map(|id| format!("{id} {model} 64 48 {parameters}\n"))
                    .collect::<String>()
                    .into_bytes(),
                Encoding::Binary => {
                    let mut bytes = 6u64.to_le_bytes().to_vec();
                    for id in 1..=6u32 {
                        bytes.extend(id.to_le_bytes());
                        bytes.extend(number.to_le_bytes());
                        bytes.extend([64u64, 48].into_iter().flat_map(u64::to_le_bytes));
                        let values = parameters.split(' ').map(|v| v.parse::<f64>().unwrap());
                        bytes.extend(values.flat_map(f64::to_le_bytes));
                    }
                    bytes
                }
            };
            fs::write(path, bytes).unwrap();
            let camera = &Capture::load(folder.path(), &options).unwrap().frames[0].camera;
            assert_eq!(camera.focal, focal, "{model}");
            assert_eq!(camera.principal, [31.0, 23.0], "{model}");
            assert_eq!(camera.distortion, distortion, "{model}");
        }
    }
}

#[test]
fn masks_beside_colmaps_images_are_used_in_both_namings() {
    for naming in ["NAME.png.png", "NAME.png"] {
        let folder = colmap(Encoding::Binary);
        let (images, masks) = (folder.path().join("images"), folder.path().join("masks"));
        let loaded = load(folder.path());
        fs::create_dir(&masks).unwrap();
        // Masks from the alpha, then photographs without one.
        for frame in loaded.frames {
            let mask = masks.join(naming.replace("NAME", &frame.name));
            eclipse::image_io::write_png8(&mask, &frame.mask).unwrap();
            let image = images.join(format!("{}.png", frame.name));
            let opaque = render::image::Image {
                data: frame.image.data.iter().map(|v| v.min(1.0)).collect(),
                ..frame.image
            };
            eclipse::image_io::write_png8(&image, &opaque).unwrap();
        }
        assert_eq!(load(folder.path()).frames.len(), 6, "{naming}");
        let one = naming.replace("NAME", "003");
        fs::remove_file(masks.join(one)).unwrap();
        says(
            folder.path(),
            &["003", "masks", "003.png.png", "does not exist"],
        );
    }
}

#[test]
fn broken_colmap_text_is_located_by_line_and_field() {
    text_says(
        "cameras.txt",
        "OPENCV",
        "FISHEYE",
        &[
            "cameras.txt",
            "line 3",
            "MODEL FISHEYE",
            "OPENCV",
            "undistort",
        ],
    );
    text_says(
        "cameras.txt",
        "1 OPENCV 64",
        "1 OPENCV wide",
        &["line 3", "\"wide\" for WIDTH", "expected a number"],
    );
    text_says(
        "cameras.txt",
        "1 OPENCV 64 48",
        "1 OPENCV 64 0",
        &["line 3", "HEIGHT 0"],
    );
    text_says(
        "cameras.txt",
        "1 OPENCV 64 48 ",
        "1 OPENCV 64 48 7 ",
        &["9 PARAMS", "OPENCV cameras have 8"],
    );
    text_says(
        "cameras.txt",
        "\n1 OPENCV",
        "\n2 OPENCV",
        &["line 4", "CAMERA_ID 2", "each once"],
    );
    text_says(
        "cameras.txt",
        "\n1 OPENCV",
        "\n9 OPENCV",
        &["images.txt", "\"000.png\"", "CAMERA_ID 1"],
    );
    text_says(
        "images.txt",
        " 6 005.png",
        " 6",
        &["images.txt", "line 2", "NAME"],
    );
    text_says(
        "images.txt",
        "\n6 ",
        "\nsix ",
        &["line 2", "\"six\" for IMAGE_ID"],
    );
    text_says(
        "images.txt",
        "005.png",
        "005x.png",
        &["`NAME`", "images/005x.png", "does not exist"],
    );
    colmap_says(
        Encoding::Text,
        "images.txt",
        Vec::clear,
        &["holds no images"],
    );
    colmap_says(
        Encoding::Text,
        "images.txt",
        |b| b.push(0xff),
        &["is not text"],
    );
}

#[test]
fn names_and_numbers_of_images_that_no_model_has() {
    let camera = b"1 PINHOLE 8 8 9 9 4 4\n";
    let message = |images: &str| {
        let paths = ["cameras.txt", "images.txt"].map(Path::new);
        let bytes = [&camera[..], images.as_bytes()];
        let error = parse_model(bytes, Encoding::Text, paths).unwrap_err();
        error.to_string()
    };
    let found = message("1 1 0 0 0 0 0 0 1 \u{1b}[2J.png\n\n");
    assert!(
        found.contains("images.txt: line 1 has the NAME \"\\u{1b}[2J.png\", with control"),
        "{found}"
    );
    // Without lines for observations every second image would be taken for one.
    let found = message("1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 0 0 0 1 b.png\n");
    assert!(
        found.contains("images.txt: line 2 holds no observations") && found.contains("two lines"),
        "{found}"
    );
    let found = message(&"1 1 0 0 0 0 0 0 1 a.png\n\n".repeat(100_001));
    assert!(
        found.contains("holds 100001 images; at most 100000 are read"),
        "{found}"
    );
}

#[test]
fn photographs_of_a_colmap_model_may_not_lie_outside_the_capture() {
    let outside = tempfile::tempdir().unwrap();
    let folder = colmap(Encoding::Text);
    let path = folder.path().join("sparse/0/images.txt");
    let target = outside.path().join("005.png");
    fs::copy(folder.path().join("images/005.png"), &target).unwrap();
    // As many steps up as lead to the root, from wherever temporary folders are.
    let climb = format!("{}{}", "../".repeat(40), target.display());
    let text = fs::read_to_string(&path)
        .unwrap()
        .replace("005.png", &climb);
    fs::write(&path, text).unwrap();
    says(folder.path(), &["`NAME`", "outside the capture's folder"]);
}

#[test]
fn truncated_and_lying_binary_models_are_refused_without_reserving_memory() {
    for file in ["cameras.bin", "images.bin"] {
        let length = fs::metadata(colmap(Encoding::Binary).path().join("sparse/0").join(file))
            .unwrap()
            .len() as usize;
        for cut in [0, 7, 8, 9, 40, length / 2, length - 1] {
            colmap_says(
                Encoding::Binary,
                file,
                |b| b.truncate(cut),
                &[file, "truncated"],
            );
        }
        let lie = |b: &mut Vec<u8>| b[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        colmap_says(
            Encoding::Binary,
            file,
            lie,
            &[file, "says 18446744073709551615", "room for"],
        );
        colmap_says(
            Encoding::Binary,
            file,
            |b| b.push(1),
            &[file, "1 bytes after the last"],
        );
    }
    let fisheye = |b: &mut Vec<u8>| b[12..16].copy_from_slice(&5i32.to_le_bytes());
    colmap_says(
        Encoding::Binary,
        "cameras.bin",
        fisheye,
        &["camera number 0", "OPENCV_FISHEYE"],
    );
    let unknown = |b: &mut Vec<u8>| b[12..16].copy_from_slice(&(-1i32).to_le_bytes());
    colmap_says(Encoding::Binary, "cameras.bin", unknown, &["number -1"]);
    let nan = |b: &mut Vec<u8>| b[32..40].copy_from_slice(&f64::NAN.to_le_bytes());
    colmap_says(
        Encoding::Binary,
        "cameras.bin",
        nan,
        &["NaN among its PARAMS"],
    );
    let zero = |b: &mut Vec<u8>| b[12..44].fill(0);
    colmap_says(
        Encoding::Binary,
        "images.bin",
        zero,
        &["QW QX QY QZ", "length 1"],
    );
    let infinite = |b: &mut Vec<u8>| b[44..52].copy_from_slice(&f64::INFINITY.to_le_bytes());
    colmap_says(
        Encoding::Binary,
        "images.bin",
        infinite,
        &["TX TY TZ", "not finite"],
    );
}

#[test]
fn a_model_without_its_cameras_says_which_files_belong_to_it() {
    let folder = colmap(Encoding::Binary);
    fs::remove_file(folder.path().join("sparse/0/cameras.bin")).unwrap();
    says(
        folder.path(),
        &["cameras.bin", "cameras, images and points3D"],
    );
}

/// A capture in `folder/capture` with its `transforms.json`.
fn written(folder: &TempDir) -> (std::path::PathBuf, Value) {
    let path = folder.path().join("capture");
    write(&path, &small_capture(CENTRE)).unwrap();
    let json = fs::read(path.join("transforms.json")).unwrap();
    (path, serde_json::from_slice(&json).unwrap())
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.frames.iter().map(|frame| &*frame.name).collect()
}

/// `json` with the frames at `kept`.
fn subset(json: &Value, kept: &[usize]) -> String {
    let mut json = json.clone();
    json["frames"] = kept
        .iter()
        .map(|&index| json["frames"][index].clone())
        .collect();
    json.to_string()
}

#[test]
fn blenders_training_split_is_the_capture() {
    let folder = tempfile::tempdir().unwrap();
    let (path, json) = written(&folder);
    fs::remove_file(path.join("transforms.json")).unwrap();
    fs::write(
        path.join("transforms_train.json"),
        subset(&json, &[0, 2, 3]),
    )
    .unwrap();
    assert_eq!(names(&load(&path)), ["000", "002", "003"]);
    fs::write(path.join("transforms_val.json"), subset(&json, &[1])).unwrap();
    fs::write(path.join("transforms_test.json"), subset(&json, &[4, 5])).unwrap();
    assert_eq!(names(&load(&path)), ["000", "002", "003"]);
    let source = Capture::describe(&path, &LoadOptions::default()).unwrap();
    assert_eq!((source.format, source.left_out), ("Blender's splits", 3));
    // Nothing but the number of the others' frames is used.
    let fisheye = r#"{"camera_model": "OPENCV_FISHEYE", "frames": [{"file_path": "a"}, {}]}"#;
    for (other, left_out) in [
        (r#"{"frames": []}"#, 1),
        ("{}", 1),
        ("", 1),
        ("\n", 1),
        (fisheye, 3),
    ] {
        fs::write(path.join("transforms_test.json"), other).unwrap();
        assert_eq!(names(&load(&path)), ["000", "002", "003"]);
        let source = Capture::describe(&path, &LoadOptions::default()).unwrap();
        assert_eq!(source.left_out, left_out, "{other}");
    }
    fs::write(path.join("transforms_test.json"), "{").unwrap();
    says(&path, &["transforms_test.json cannot be understood"]);
    fs::remove_file(path.join("transforms_train.json")).unwrap();
    says(
        &path,
        &[
            "none of the files that describe a capture",
            "transforms_train.json",
            "sparse/0",
        ],
    );
}

#[test]
fn nerfstudios_splits_keep_training_frames_only() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut json) = written(&folder);
    let save = |json: &Value| fs::write(path.join("transforms.json"), json.to_string()).unwrap();
    json["test_filenames"] = json!(["001.exr", "004.exr"]);
    save(&json);
    assert_eq!(names(&load(&path)), ["000", "002", "003", "005"]);
    json["train_filenames"] = json!(["000.exr", "005.exr"]);
    save(&json);
    assert_eq!(names(&load(&path)), ["000", "005"]);
    let source = Capture::describe(&path, &LoadOptions::default()).unwrap();
    assert_eq!(source.left_out, 4);
    json["train_filenames"] = json!(["./000.exr", ".\\005.exr"]);
    json["frames"][0]["file_path"] = json!("././000.exr");
    save(&json);
    assert_eq!(names(&load(&path)), ["000", "005"]);
    json["train_filenames"] = json!([]);
    save(&json);
    says(&path, &["transforms.json", "no frame is for training"]);
    json["train_filenames"] = json!(["000.png"]);
    save(&json);
    says(
        &path,
        &["`train_filenames` names \"000.png\"", "`file_path`"],
    );
}
