//! Everything that can be wrong with a capture's files, photographs, masks and mesh, ends with one message of the same kind.

use std::{fs, path::PathBuf};
#[cfg(unix)]
use std::{os::unix::fs::symlink, path::Path};

use eclipse::{
    capture::{Capture, LoadOptions, formats::colmap::Encoding},
    image_io::{write_exr, write_png8},
};
use eclipse_tests::{
    colmap_model,
    on_disk::{Spoiled, files_say, grey, json_says},
    small_capture::{SIZE, small_capture},
    tetrahedron::gltf,
};
use glam::Vec3;
use render::image::Image;
use serde_json::json;

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
    let mut capture = Spoiled::fresh();
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
    let capture = Spoiled::fresh();
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
fn paths_that_lead_out_of_the_folder() {
    let outside = |name: &str| {
        let mut capture = Spoiled::fresh();
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
        // Whether a link is absolute or relative.
        for target in [path.as_path(), "../000.exr".as_ref()] {
            let linked = outside("link.exr");
            symlink(target, linked.path.join("link.exr")).unwrap();
            linked.says(&parts);
        }
    }
    let mut mesh = outside("000.exr");
    fs::rename(mesh.path.join("mesh.glb"), mesh.path.join("../mesh.glb")).unwrap();
    mesh.json["ply_file_path"] = json!("../mesh.glb");
    mesh.says(&["transforms.json: `ply_file_path` names", "outside"]);
}

/// A way in which a file of a capture lies elsewhere, and what is said of it.
#[cfg(unix)]
type Elsewhere = (&'static str, fn(&mut Spoiled), &'static [&'static str]);

#[cfg(unix)]
#[test]
fn files_that_lie_elsewhere_through_links() {
    let cases: [Elsewhere; 6] = [
        (
            "a mask",
            |capture| {
                write_masks(&capture.path.join(".."));
                symlink("../002.png", capture.path.join("mask.png")).unwrap();
                capture.json["frames"][2]["mask_path"] = json!("mask.png");
            },
            &["frame \"002\": `mask_path` names", "mask.png, which lies"],
        ),
        (
            "a mask by dots",
            |capture| {
                write_masks(&capture.path.join(".."));
                capture.json["frames"][2]["mask_path"] = json!("../002.png");
            },
            &["`mask_path` names", "../002.png, which lies"],
        ),
        (
            "the mesh",
            |capture| moved_out(capture, "mesh.glb", "mesh.glb"),
            &["`mesh` names", "capture/mesh.glb, which lies"],
        ),
        (
            "the mesh under another name",
            |capture| {
                // No name of a capture's own mesh.
                moved_out(capture, "mesh.glb", "shape.glb");
                capture.json["ply_file_path"] = json!("shape.glb");
            },
            &["transforms.json: `ply_file_path` names", "shape.glb, which"],
        ),
        (
            "masks of COLMAP",
            |capture| {
                fs::remove_dir_all(&capture.path).unwrap();
                let made = small_capture(Vec3::new(0.5, 0.0, 0.0));
                colmap_model::write(&capture.path, &made, Encoding::Text);
                write_masks(&capture.path.join("../elsewhere"));
                symlink("../elsewhere", capture.path.join("masks")).unwrap();
            },
            &["frame \"003.png\": `masks` names", "masks/003.png, which"],
        ),
        (
            "masks of Stanford-ORB",
            |capture| {
                let at = |name: &str| capture.path.join(name);
                fs::create_dir(at("train")).unwrap();
                for frame in capture.json["frames"].as_array_mut().unwrap() {
                    let name = frame["file_path"].as_str().unwrap().to_owned();
                    let moved = format!("train/{name}");
                    fs::rename(at(&name), at(&moved)).unwrap();
                    frame["file_path"] = json!(moved);
                }
                fs::remove_file(at("transforms.json")).unwrap();
                let text = capture.json.to_string();
                fs::write(at("transforms_train.json"), text).unwrap();
                write_masks(&at("../elsewhere"));
                symlink("../elsewhere", at("train_mask")).unwrap();
            },
            &["`mask_path` names", "train_mask/003.png, which lies"],
        ),
    ];
    for (what, spoil, parts) in cases {
        let mut capture = Spoiled::fresh();
        spoil(&mut capture);
        if capture.path.join("transforms.json").exists() {
            let text = capture.json.to_string();
            fs::write(capture.path.join("transforms.json"), text).unwrap();
        }
        let load = |allow_outside| {
            let options = LoadOptions {
                allow_outside,
                ..LoadOptions::default()
            };
            Capture::load(&capture.path, &options).map_err(|error| error.to_string())
        };
        let message = load(false).expect_err(what);
        let allowed = "outside the capture's folder; move it inside and correct the path, or give --allow-outside";
        for part in parts.iter().chain(&[allowed]) {
            assert!(message.contains(part), "{what}: {part:?} in {message:?}");
        }
        load(true).unwrap_or_else(|error| panic!("{what}: {error}"));
    }
}

#[cfg(unix)]
#[test]
fn a_buffer_of_a_mesh_that_lies_elsewhere_through_a_link() {
    let capture = Spoiled::fresh();
    fs::remove_file(capture.path.join("mesh.glb")).unwrap();
    let (json, data) = gltf("data.bin", json!({ "mesh": 0 }));
    fs::write(capture.path.join("mesh.gltf"), json.to_string()).unwrap();
    fs::write(capture.path.join("../data.bin"), data).unwrap();
    symlink("../data.bin", capture.path.join("data.bin")).unwrap();
    capture.load_says(&[
        "mesh.gltf",
        "its buffer \"data.bin\" lies outside the mesh's folder: put it beside the mesh",
    ]);
}

/// Moves a file out of the capture's folder, and leaves a link to it.
#[cfg(unix)]
fn moved_out(capture: &Spoiled, name: &str, link: &str) {
    let elsewhere = format!("../{name}");
    fs::rename(capture.path.join(name), capture.path.join(&elsewhere)).unwrap();
    symlink(elsewhere, capture.path.join(link)).unwrap();
}

/// The masks of all frames in a folder, which is made.
#[cfg(unix)]
fn write_masks(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for frame in small_capture(Vec3::ZERO).frames {
        write_png8(&folder.join(format!("{}.png", frame.name)), &frame.mask).unwrap();
    }
}

#[cfg(unix)]
#[test]
fn descriptions_that_lie_elsewhere() {
    for name in ["transforms.json", "transforms_train.json"] {
        let capture = Spoiled::fresh();
        let elsewhere = capture.path.join("../elsewhere.json");
        fs::rename(capture.path.join("transforms.json"), &elsewhere).unwrap();
        symlink("../elsewhere.json", capture.path.join(name)).unwrap();
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
        symlink("inside.json", capture.path.join(name)).unwrap();
        Capture::load(&capture.path, &LoadOptions::default()).unwrap();
    }
    // Nor are photographs of other splits counted elsewhere.
    let capture = Spoiled::fresh();
    let at = |name: &str| capture.path.join(name);
    fs::rename(at("transforms.json"), at("transforms_train.json")).unwrap();
    fs::copy(at("transforms_train.json"), at("../test.json")).unwrap();
    symlink("../test.json", at("transforms_test.json")).unwrap();
    capture.load_says(&["transforms_test.json", "leads out of the capture's folder"]);
}

#[test]
fn sparse_points_in_place_of_a_mesh() {
    let mut capture = Spoiled::fresh();
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
    let capture = Spoiled::fresh();
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
