//! Captures that must load, in every form of the fields, and what they become.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, LoadOptions, mask_overlap, write},
    mesh_io::{GlbSurface, write_glb},
};
use eclipse_tests::{
    on_disk::{load, save, written},
    small_capture::{SIZE, small_capture},
};
use glam::Vec3;
use serde_json::json;

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
