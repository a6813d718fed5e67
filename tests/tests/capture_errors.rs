//! Everything that can be wrong with a capture ends with one message: what file, what field, what was expected, what to do.

use std::{fs, path::PathBuf};

use eclipse::{
    capture::{Capture, LoadOptions, write},
    image_io::{write_exr, write_png8},
};
use eclipse_tests::small_capture::{SIZE, small_capture};
use glam::Vec3;
use render::image::Image;
use serde_json::{Value, json};
use tempfile::TempDir;

/// A written capture to be spoiled.
struct Spoiled {
    _folder: TempDir,
    path: PathBuf,
    json: Value,
}

impl Spoiled {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("capture");
        write(&path, &small_capture(Vec3::new(0.5, 0.0, 0.0))).unwrap();
        let json =
            serde_json::from_slice(&fs::read(path.join("transforms.json")).unwrap()).unwrap();
        Self {
            _folder: folder,
            path,
            json,
        }
    }

    /// The message, which must hold all `parts`.
    #[track_caller]
    fn says(&self, parts: &[&str]) {
        fs::write(self.path.join("transforms.json"), self.json.to_string()).unwrap();
        self.load_says(parts);
    }

    #[track_caller]
    fn load_says(&self, parts: &[&str]) {
        let message = match Capture::load(&self.path, &LoadOptions::default()) {
            Ok(_) => panic!("loaded, where {parts:?} was expected"),
            Err(error) => error.to_string(),
        };
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in {message:?}");
        }
        // What is wrong with several frames is a list.
        let listed = message.contains(" frames cannot be used:\n");
        assert!(listed || !message.contains('\n'), "one line: {message}");
    }
}

/// The message after `spoil` changed `transforms.json`.
#[track_caller]
fn json_says(spoil: impl Fn(&mut Value), parts: &[&str]) {
    let mut capture = Spoiled::new();
    spoil(&mut capture.json);
    capture.says(parts);
}

/// The message after `spoil` changed the files of the capture.
#[track_caller]
fn files_say(spoil: impl Fn(&PathBuf), parts: &[&str]) {
    let capture = Spoiled::new();
    spoil(&capture.path);
    capture.load_says(parts);
}

fn grey(width: usize, height: usize, channels: usize) -> Image {
    Image::filled(width, height, channels, 0.5)
}

#[test]
fn transforms_that_are_missing_or_not_json() {
    let folder = tempfile::tempdir().unwrap();
    let message = |path| {
        Capture::load(path, &LoadOptions::default())
            .unwrap_err()
            .to_string()
    };
    assert!(message(folder.path()).contains("transforms.json"));
    assert!(
        message(&folder.path().join("nowhere"))
            .contains("a capture is a folder with transforms.json")
    );
    let spoil = |text: &'static str| {
        move |path: &PathBuf| fs::write(path.join("transforms.json"), text).unwrap()
    };
    files_say(
        spoil("{\"frames\": ["),
        &["transforms.json cannot be understood", "line 1"],
    );
    files_say(
        spoil("{\"frames\": 3}"),
        &[
            "transforms.json cannot be understood",
            "expected a sequence",
        ],
    );
    files_say(spoil("{\"w\": 3}"), &["missing field `frames`"]);
    files_say(
        spoil("{\"frames\": []}"),
        &["`frames` is empty", "expected at least one photograph"],
    );
    files_say(
        spoil("{\"frames\": [{\"file_path\": \"a\", \"transform_matrix\": [[NaN]]}]}"),
        &[
            "transforms.json cannot be understood",
            "`frames[0].transform_matrix[0][0]`: NaN in line 1",
            "JSON has no NaN",
        ],
    );
    files_say(
        spoil("{\"frames\": [{\"file_path\": \"a\", \"w\":\n -Infinity}]}"),
        &["`frames[0].w`: -Infinity in line 2", "JSON has no NaN"],
    );
}

#[test]
fn a_file_in_place_of_the_folder() {
    let capture = Spoiled::new();
    let load = |name: &str| {
        let loaded = Capture::load(&capture.path.join(name), &LoadOptions::default());
        loaded.unwrap_err().to_string()
    };
    for name in ["transforms.json", "000.exr"] {
        let message = load(name);
        let folder = format!("give its own: {}", capture.path.display());
        assert!(
            message.contains(&format!("{name} is a file")) && message.ends_with(&folder),
            "{message}"
        );
    }
}

#[test]
fn fields_of_another_kind_than_expected_are_named() {
    let number = "expected a number at line 1";
    for (value, part) in [
        (Value::Null, "invalid type: null"),
        (json!("5"), "invalid type: string \"5\""),
    ] {
        json_says(
            |json| json["frames"][3]["transform_matrix"][0][3] = value.clone(),
            &[
                "transforms.json",
                "`frames[3].transform_matrix[0][3]`: ",
                part,
                number,
            ],
        );
    }
    json_says(
        |json| {
            drop(
                json["frames"][2]
                    .as_object_mut()
                    .unwrap()
                    .remove("file_path"),
            )
        },
        &["`frames[2]`: missing field `file_path`"],
    );
    json_says(
        |json| json["frames"][4] = json!("004.exr"),
        &["`frames[4]`", "expected an object with `file_path`"],
    );
    // Intrinsics are shared by the file and its frames.
    json_says(
        |json| json["w"] = json!("64"),
        &[
            "transforms.json",
            "`w`: invalid type: string \"64\"",
            number,
        ],
    );
    json_says(
        |json| json["frames"][1]["fl_x"] = json!([1.0]),
        &["`frames[1].fl_x`: invalid type: sequence", number],
    );
    json_says(
        |json| json["color_encoding"] = json!("rec709"),
        &["`color_encoding`: unknown variant `rec709`", "`srgb`"],
    );
    json_says(
        |json| *json = json!([]),
        &["expected an object with `frames`"],
    );
}

#[test]
fn cameras_of_an_unsupported_kind() {
    for model in ["OPENCV_FISHEYE", "EQUIRECTANGULAR"] {
        json_says(
            |json| json["camera_model"] = json!(model),
            &["`camera_model`", model, "not supported yet", "undistort"],
        );
    }
    json_says(
        |json| json["frames"][1]["k3"] = json!(0.1),
        &["frame \"001\"", "`k3` is not zero"],
    );
}

#[test]
fn lenses_that_are_no_perspective_ones() {
    // As instant-ngp tells of them, for all frames or for one.
    for (field, value) in [
        ("is_fisheye", json!(true)),
        ("latlong", json!(true)),
        ("ftheta_p0", json!(0.5)),
    ] {
        json_says(
            |json| json[field] = value.clone(),
            &["frame \"000\"", field, "not supported", "undistort"],
        );
        json_says(
            |json| json["frames"][3][field] = value.clone(),
            &["frame \"003\"", field, "not supported", "undistort"],
        );
    }
    // Of such a lens all coefficients mean something else: it comes first.
    json_says(
        |json| {
            json["is_fisheye"] = json!(true);
            json["k3"] = json!(0.1);
        },
        &["`is_fisheye`"],
    );
    // colmap2nerf of instant-ngp always says whether.
    let mut plain = Spoiled::new();
    plain.json["is_fisheye"] = json!(false);
    plain.json["frames"][0]["latlong"] = json!(false);
    plain.json["frames"][0]["camera_model"] = json!("PINHOLE");
    fs::write(plain.path.join("transforms.json"), plain.json.to_string()).unwrap();
    Capture::load(&plain.path, &LoadOptions::default()).unwrap();

    json_says(
        |json| json["frames"][2]["camera_model"] = json!("OPENCV_FISHEYE"),
        &[
            "002",
            "`camera_model` is \"OPENCV_FISHEYE\"",
            "not supported yet",
            "undistort",
        ],
    );
    json_says(
        |json| json["frames"][2]["camera_model"] = json!("ORTHOGRAPHIC"),
        &["002", "`camera_model` is \"ORTHOGRAPHIC\"", "say it once"],
    );
}

#[test]
fn intrinsics_that_no_camera_has() {
    let remove = |json: &mut Value, names: &[&str]| {
        for name in names {
            json.as_object_mut().unwrap().remove(*name);
        }
    };
    json_says(
        |json| remove(json, &["camera_angle_x", "fl_x", "fl_y"]),
        &[
            "transforms.json: frame \"000\"",
            "`camera_angle_x` is missing, and fl_x too",
        ],
    );
    json_says(
        |json| json["fl_x"] = json!(-5.0),
        &[
            "transforms.json: frame \"000\": `fl_x` is -5",
            "expected a positive focal length",
        ],
    );
    json_says(
        |json| {
            remove(json, &["fl_x", "fl_y"]);
            json["camera_angle_x"] = json!(40.0);
        },
        &["`camera_angle_x` is 40", "between 0 and π, in radians"],
    );
    json_says(
        |json| json["w"] = json!(63.5),
        &["transforms.json: ", "`w` is 63.5", "whole pixels"],
    );
    json_says(
        |json| json["frames"][2]["cx"] = json!(1e300),
        &["frame \"002\"", "`cx`"],
    );
}

#[test]
fn sizes_that_disagree() {
    json_says(
        |json| json["h"] = json!(50),
        &[
            "frame \"000\"",
            "000.exr has 64×48 pixels",
            "`w` and `h` say 64×50",
            "resize the image",
        ],
    );
    let mut capture = Spoiled::new();
    for name in ["w", "h"] {
        capture.json.as_object_mut().unwrap().remove(name);
    }
    let image = Image {
        data: vec![1.0; 30 * 30 * 4],
        ..grey(30, 30, 4)
    };
    write_exr(&capture.path.join("004.exr"), &image, &["R", "G", "B", "A"]).unwrap();
    capture.says(&[
        "frame \"004\"",
        "has 30×30 pixels",
        "the first frame, with the same intrinsics, has 64×48",
    ]);
    let mut capture = Spoiled::new();
    write_png8(&capture.path.join("mask.png"), &grey(8, 8, 1)).unwrap();
    capture.json["frames"][3]["mask_path"] = json!("mask.png");
    capture.says(&[
        "frame \"003\"",
        "mask.png has 8×8 pixels",
        "the image has 64×48",
    ]);
}

#[test]
fn poses_that_are_not_rigid() {
    let pose =
        |rows: Value| move |json: &mut Value| json["frames"][2]["transform_matrix"] = rows.clone();
    let start = &[
        "transforms.json: frame \"002\": `transform_matrix`",
        "camera to world",
    ][..];
    let check = |rows: Value, part: &str| json_says(pose(rows), &[start, &[part]].concat());
    let diagonal =
        |x: f64, y: f64, z: f64| json!([[x, 0, 0, 5], [0, y, 0, 5], [0, 0, z, 5], [0, 0, 0, 1]]);
    check(diagonal(1.0, 1.0, 0.0), "is singular");
    check(diagonal(0.0, 0.0, 0.0), "is singular");
    check(diagonal(2.0, 2.0, 2.0), "scales by 2");
    check(diagonal(1.0, 1.0, -1.0), "mirrors");
    check(diagonal(1.0, 2.0, 1.0), "is not a rotation");
    check(
        json!([[1, 0.1, 0, 5], [0, 1, 0, 5], [0, 0, 1, 5], [0, 0, 0, 1]]),
        "is not a rotation",
    );
    check(
        json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 5, 5, 1]]),
        "is it transposed?",
    );
    check(
        json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1e-5, 1]]),
        "is it transposed?",
    );
    check(
        json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "has 3 rows, the first of 3 numbers",
    );
    check(json!([]), "is missing or empty");
}

#[test]
fn images_that_are_missing_or_damaged() {
    json_says(
        |json| json["frames"][5]["file_path"] = json!("photo"),
        &[
            "transforms.json: frame \"photo\": `file_path`",
            "photo, which does not exist, nor with .exr",
            "correct the path",
        ],
    );
    json_says(
        |json| json["frames"][5]["file_path"] = json!("009.png"),
        &[
            "frame \"009\": `file_path`",
            "009.png, which does not exist; put the file there",
        ],
    );
    json_says(
        |json| json["frames"][5]["mask_path"] = json!("m.png"),
        &["frame \"005\": `mask_path`", "m.png"],
    );
    let cut = |path: &PathBuf| {
        let bytes = fs::read(path.join("001.exr")).unwrap();
        fs::write(path.join("001.exr"), &bytes[..bytes.len() / 2]).unwrap();
    };
    files_say(
        cut,
        &[
            "frame \"001\"",
            "001.exr is damaged, truncated or not an EXR",
            "export or copy it again",
        ],
    );
    files_say(
        |path| fs::write(path.join("002.exr"), "").unwrap(),
        &["frame \"002\"", "002.exr is damaged"],
    );
    files_say(
        |path| write_exr(&path.join("002.exr"), &grey(SIZE[0], SIZE[1], 1), &["Z"]).unwrap(),
        &[
            "frame \"002\"",
            "002.exr has the channels Z",
            "R, G, B (and A) or Y are expected",
        ],
    );
}

#[test]
fn images_that_are_too_large_together() {
    // Each alone could be read: 10 000² pixels of four channels. The headers say it, before any of them is decoded.
    let grow = |path: &PathBuf| {
        for index in 0..6 {
            let path = path.join(format!("{index:03}.exr"));
            let mut bytes = fs::read(&path).unwrap();
            for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
                let at = bytes.windows(window.len()).position(|w| w == window);
                // After the name the length of four, then the corners, the lower one first.
                let upper = at.unwrap() + window.len() + 4 + 8;
                for corner in [upper, upper + 4] {
                    bytes[corner..corner + 4].copy_from_slice(&9_999_u32.to_le_bytes());
                }
            }
            fs::write(&path, bytes).unwrap();
        }
    };
    files_say(
        grow,
        &[
            "transforms.json: its photographs and masks have 2400000000 values together",
            "8.9 GiB",
            "at most 2147483648 are read",
            "scale the images down",
        ],
    );
}

#[test]
fn pixels_that_are_not_finite() {
    let spoil = |path: &PathBuf| {
        let mut image = grey(SIZE[0], SIZE[1], 4);
        image.pixel_mut(7, 3)[1] = f32::NAN;
        image.pixel_mut(8, 3).fill(f32::INFINITY);
        image.pixel_mut(1, 40)[3] = f32::NEG_INFINITY;
        write_exr(&path.join("003.exr"), &image, &["R", "G", "B", "A"]).unwrap();
    };
    files_say(
        spoil,
        &[
            "frame \"003\"",
            "003.exr has 3 pixels that are NaN or infinite",
            "column 7 of row 3",
        ],
    );
}

#[test]
fn masks_that_are_absent_or_empty() {
    files_say(
        |path| {
            write_exr(
                &path.join("000.exr"),
                &grey(SIZE[0], SIZE[1], 3),
                &["R", "G", "B"],
            )
            .unwrap()
        },
        &[
            "frame \"000\"",
            "000.exr has no alpha channel and the frame no `mask_path`",
        ],
    );
    files_say(
        |path| {
            write_exr(
                &path.join("000.exr"),
                &grey(SIZE[0], SIZE[1], 4),
                &["R", "G", "B", "A"],
            )
            .unwrap()
        },
        &[
            "frame \"000\"",
            "the largest value of the mask in",
            "000.exr is 0.500 of 1",
            "leave the frame out",
        ],
    );
    let mut capture = Spoiled::new();
    write_png8(
        &capture.path.join("mask.png"),
        &Image::filled(SIZE[0], SIZE[1], 1, 0.0),
    )
    .unwrap();
    capture.json["frames"][4]["mask_path"] = json!("mask.png");
    capture.says(&["frame \"004\"", "mask.png is empty"]);
}

#[test]
fn masks_that_are_empty_once_they_are_reduced() {
    let capture = Spoiled::new();
    let options = LoadOptions {
        max_size: Some(1),
        ..LoadOptions::default()
    };
    let message = Capture::load(&capture.path, &options)
        .unwrap_err()
        .to_string();
    for part in [
        "frame \"000\": the object fills ",
        "pixels of the mask in",
        "000.exr, and none of the 1 × 1 that --max-size 1",
        "give a larger --max-size",
    ] {
        assert!(message.contains(part), "{part:?} is not in {message:?}");
    }
}

#[test]
fn frames_that_are_named_twice() {
    json_says(
        |json| json["frames"][3]["file_path"] = json!("./001.exr"),
        &["`frames` names \"./001.exr\" twice", "rename"],
    );
}

#[test]
fn paths_that_lead_out_of_the_folder() {
    let outside = |name: &str| {
        let mut capture = Spoiled::new();
        fs::copy(
            capture.path.join("000.exr"),
            capture.path.join("../000.exr"),
        )
        .unwrap();
        capture.json["frames"][0]["file_path"] = json!(name);
        capture
    };
    let parts = [
        "transforms.json: frame \"",
        "`file_path` names",
        "outside the capture's folder",
        "move it inside",
        "give --allow-outside when you trust the capture",
    ];
    outside("../000.exr").says(&parts);
    let mut absolute = outside("");
    let path = absolute.path.parent().unwrap().join("000.exr");
    absolute.json["frames"][0]["file_path"] = json!(path.to_str().unwrap());
    absolute.says(&parts);
    #[cfg(unix)]
    {
        let linked = outside("link.exr");
        std::os::unix::fs::symlink(path, linked.path.join("link.exr")).unwrap();
        fs::copy(linked.path.join("001.exr"), linked.path.join("../000.exr")).unwrap();
        std::os::unix::fs::symlink("../000.exr", linked.path.join("other.exr")).unwrap();
        let mut linked = linked;
        linked.json["frames"][0]["file_path"] = json!("other.exr");
        linked.says(&parts);
    }
    let mut mesh = outside("000.exr");
    fs::rename(mesh.path.join("mesh.glb"), mesh.path.join("../mesh.glb")).unwrap();
    mesh.json["ply_file_path"] = json!("../mesh.glb");
    mesh.says(&["transforms.json: `ply_file_path` names", "outside"]);
}

#[cfg(unix)]
#[test]
fn descriptions_that_lie_elsewhere() {
    for name in ["transforms.json", "transforms_train.json"] {
        let capture = Spoiled::new();
        let elsewhere = capture.path.join("../elsewhere.json");
        fs::rename(capture.path.join("transforms.json"), &elsewhere).unwrap();
        std::os::unix::fs::symlink("../elsewhere.json", capture.path.join(name)).unwrap();
        capture.load_says(&[
            name,
            "leads out of the capture's folder through a link",
            "put the file itself there",
            "give --allow-outside when you trust the capture",
        ]);
        let trusted = LoadOptions {
            allow_outside: true,
            ..LoadOptions::default()
        };
        Capture::load(&capture.path, &trusted).unwrap();
        // A link within the folder leads nowhere else.
        fs::remove_file(capture.path.join(name)).unwrap();
        fs::rename(&elsewhere, capture.path.join("inside.json")).unwrap();
        std::os::unix::fs::symlink("inside.json", capture.path.join(name)).unwrap();
        Capture::load(&capture.path, &LoadOptions::default()).unwrap();
    }
    // Nor are photographs of other splits counted elsewhere.
    let capture = Spoiled::new();
    let at = |name: &str| capture.path.join(name);
    fs::rename(at("transforms.json"), at("transforms_train.json")).unwrap();
    fs::copy(at("transforms_train.json"), at("../test.json")).unwrap();
    std::os::unix::fs::symlink("../test.json", at("transforms_test.json")).unwrap();
    capture.load_says(&["transforms_test.json", "leads out of the capture's folder"]);
}

#[test]
fn sparse_points_in_place_of_a_mesh() {
    let mut capture = Spoiled::new();
    fs::remove_file(capture.path.join("mesh.glb")).unwrap();
    let cloud = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n\
                 0 0 0\n1 2 3\n";
    fs::write(capture.path.join("sparse_pc.ply"), cloud).unwrap();
    capture.json["ply_file_path"] = json!("sparse_pc.ply");
    capture.says(&[
        "`ply_file_path` names",
        "sparse_pc.ply, which has 2 points and no faces",
        "mesh.glb",
        "--mesh",
    ]);
}

#[test]
fn meshes_that_are_missing_or_unusable() {
    let remove = |path: &PathBuf| fs::remove_file(path.join("mesh.glb")).unwrap();
    files_say(
        remove,
        &["holds no mesh.glb, .gltf, .obj or .ply; put", "--mesh"],
    );
    files_say(
        |path| fs::rename(path.join("mesh.glb"), path.join("Potato.GLB")).unwrap(),
        &[
            "holds no mesh.glb",
            "there is Potato.GLB: ",
            "capture/Potato.GLB, or rename it to mesh.glb",
        ],
    );
    let obj = |text: &'static str| {
        move |path: &PathBuf| {
            remove(path);
            fs::write(path.join("mesh.obj"), text).unwrap();
        }
    };
    files_say(
        obj("v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        &[
            "mesh.obj has no faces (3 vertices",
            "export a triangle mesh",
        ],
    );
    files_say(
        obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"),
        &[
            "mesh.obj has a face (number 0",
            "names vertex 4",
            "3 vertices",
        ],
    );
    files_say(
        obj("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        &["mesh.obj has 1 vertex with coordinates that are not finite"],
    );
    files_say(
        obj("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n"),
        &["mesh.obj has no extent"],
    );
    files_say(
        |path| fs::write(path.join("mesh.glb"), "glTF").unwrap(),
        &["mesh.glb", "export it"],
    );
    let options = LoadOptions {
        mesh: Some("shape.stl".into()),
        ..LoadOptions::default()
    };
    let capture = Spoiled::new();
    let message = Capture::load(&capture.path, &options)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("cannot read the mesh shape.stl"),
        "{message}"
    );
    fs::write(capture.path.join("shape.stl"), "solid").unwrap();
    let options = LoadOptions {
        mesh: Some(capture.path.join("shape.stl")),
        ..LoadOptions::default()
    };
    let message = Capture::load(&capture.path, &options)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("no known mesh extension: export it as .glb"),
        "{message}"
    );
}

#[test]
fn cameras_inside_the_object() {
    json_says(
        |json| {
            let frame = &mut json["frames"][1]["transform_matrix"];
            for (row, centre) in [0.5, 0.0, 0.2].into_iter().enumerate() {
                frame[row][3] = json!(centre);
            }
        },
        &[
            "transforms.json: frame \"001\": its camera is 0.2",
            "bounding sphere of radius",
            "same unit and origin",
        ],
    );
}

#[test]
fn cameras_out_of_all_reach() {
    for far in [1e8, 1e20, -1e38, 1e300] {
        json_says(
            |json| json["frames"][4]["transform_matrix"][0][3] = json!(far),
            &[
                "transforms.json: frame \"004\": `transform_matrix` puts the camera ",
                "from the middle of the mesh",
                "correct the position",
            ],
        );
    }
}
