//! Everything that can be wrong with what a capture says ends with one message: what file, what field, what was expected, what to do.

use std::{fs, path::PathBuf};

use eclipse::{
    capture::{Capture, LoadOptions},
    image_io::{write_exr, write_png8},
};
use eclipse_tests::{
    on_disk::{Spoiled, files_say, grey, json_says},
    small_capture::small_capture,
};
use glam::Vec3;
use render::image::Image;
use serde_json::{Value, json};

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
fn frames_beyond_number() {
    // As long as they are good ones, and where the first of them is not.
    for frame in ["{\"file_path\":\"a\"}", "{}"] {
        let text = format!("{{\"frames\":[{}]}}", vec![frame; 100_001].join(","));
        let told = match frame {
            "{}" => "missing field `file_path`",
            _ => "`frames`: more than 100000 frames, the most that are read: leave some out",
        };
        files_say(
            |path| fs::write(path.join("transforms.json"), &text).unwrap(),
            &["transforms.json cannot be understood", told],
        );
    }
}

#[test]
fn names_with_control_characters() {
    json_says(
        |json| json["frames"][5]["file_path"] = json!("\u{1b}[2J.png"),
        &[
            "transforms.json: frame \"\\u{1b}[2J.png\": `file_path` has control characters",
            "rename the file",
        ],
    );
    json_says(
        |json| json["frames"][5]["mask_path"] = json!("m.png\nerror: none"),
        &["frame \"005.exr\": `mask_path` has control characters"],
    );
    json_says(
        |json| json["ply_file_path"] = json!("\u{9b}2J.ply"),
        &["`ply_file_path` has control characters; rename the file"],
    );
    json_says(
        |json| json["shape"] = json!({ "sphere": {}, "\u{1b}[2J\n": 1 }),
        &["cannot be understood", "\u{fffd}[2J"],
    );
}

/// A folder whose name clears the screen, and then says something.
#[cfg(unix)]
#[test]
fn nothing_that_is_printed_steers_a_terminal() {
    let outer = tempfile::tempdir().unwrap();
    let path = outer.path().join("\u{1b}[2J\u{9b}31mcapture");
    let capture = small_capture(Vec3::new(0.5, 0.0, 0.0));
    eclipse::capture::write(&path, &capture).unwrap();
    let inspect = |more: &[&str]| {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let words = ["eclipse", "inspect", path.to_str().unwrap()];
        let words = words.iter().chain(more).map(Into::into);
        eclipse::cli::run(words, &mut out, &mut err);
        [out, err].map(|bytes| String::from_utf8(bytes).unwrap())
    };
    let is_plain = |text: &str| !text.contains(|c: char| c.is_control() && c != '\n');
    let [out, _] = inspect(&[]);
    assert!(is_plain(&out), "{out:?}");
    assert!(out.contains("\\u001b[2J\\u009b31mcapture"), "{out}");
    // What programs read means what it did.
    let [out, _] = inspect(&["--json"]);
    assert!(is_plain(&out), "{out:?}");
    let json: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(json["capture"].as_str(), path.to_str());
    fs::remove_file(path.join("mesh.glb")).unwrap();
    let [out, err] = inspect(&[]);
    assert_eq!(out, "");
    assert!(is_plain(&err) && err.contains("\\u001b[2J"), "{err:?}");
}

#[test]
fn a_file_in_place_of_the_folder() {
    let capture = Spoiled::fresh();
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
    let mut plain = Spoiled::fresh();
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
            "transforms.json: frame \"000\" and 5 more: ",
            "`camera_angle_x` is missing, and fl_x too",
        ],
    );
    json_says(
        |json| json["fl_x"] = json!(-5.0),
        &[
            "transforms.json: frame \"000\" and 5 more: `fl_x` is -5",
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
    let mut capture = Spoiled::fresh();
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
    let mut capture = Spoiled::fresh();
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
fn frames_that_are_named_twice() {
    json_says(
        |json| json["frames"][3]["file_path"] = json!("./001.exr"),
        &["`frames` names \"./001.exr\" twice", "rename"],
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
