//! A mesh that does not fit its cameras: the planted cause is the one that is named.

use std::fs;

use eclipse::{
    capture::{Capture, LoadOptions, write},
    mesh_io::{GlbSurface, write_glb},
};
use eclipse_tests::small_capture::small_capture;
use glam::{Mat3, Mat4, Vec3};
use serde_json::Value;

/// What loading says after `spoil`, which changes mesh, cameras or masks as they are written.
fn message(spoil: impl Fn(&mut Capture)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let mut capture = small_capture(Vec3::ZERO);
    spoil(&mut capture);
    write(&path, &capture).unwrap();
    Capture::load(&path, &LoadOptions::default())
        .expect_err("the mesh does not fit")
        .to_string()
}

fn on_mesh(change: impl Fn(Vec3) -> Vec3) -> String {
    message(|capture| {
        capture
            .mesh
            .positions
            .iter_mut()
            .for_each(|p| *p = change(*p))
    })
}

fn on_cameras(change: impl Fn(Mat4) -> Mat4) -> String {
    message(|capture| {
        for frame in &mut capture.frames {
            frame.camera.world_from_camera = change(frame.camera.world_from_camera);
        }
    })
}

fn flip() -> Mat4 {
    Mat4::from_scale(Vec3::new(1.0, -1.0, -1.0))
}

#[track_caller]
fn assert_names(message: &str, cause: &str) {
    assert!(
        message.contains("the mesh and the cameras disagree"),
        "{message}"
    );
    assert!(
        message.contains(&format!("Likely cause: {cause}")),
        "{message}"
    );
}

#[test]
fn up_axes_are_named() {
    assert_names(
        &on_mesh(|p| Vec3::new(p.x, p.z, -p.y)),
        "the mesh is y up and the cameras z up",
    );
    assert_names(
        &on_mesh(|p| Vec3::new(p.x, -p.z, p.y)),
        "the mesh is z up and the cameras y up",
    );
}

#[test]
fn turned_and_mirrored_meshes_are_named() {
    assert_names(
        &on_mesh(|p| Vec3::new(-p.x, -p.y, p.z)),
        "the mesh is turned by 180° about z",
    );
    assert_names(
        &on_mesh(|p| Vec3::new(-p.y, p.x, p.z)),
        "the mesh is turned by 90° about z",
    );
    assert_names(
        &on_mesh(|p| Vec3::new(-p.x, p.y, p.z)),
        "the mesh is mirrored in x",
    );
    assert_names(
        &on_mesh(|p| Vec3::new(p.x, -p.y, p.z)),
        "the mesh is mirrored in y",
    );
    assert_names(
        &on_mesh(|p| Vec3::new(p.x, p.y, -p.z)),
        "the mesh is mirrored in z",
    );
}

#[test]
fn units_are_named_even_when_the_mesh_swallows_the_cameras() {
    assert_names(
        &on_mesh(|p| p * 1000.0),
        "the mesh's unit is not that of the cameras: it should be scaled by 0.001",
    );
    assert_names(
        &on_mesh(|p| p * 0.01),
        "the mesh's unit is not that of the cameras: it should be scaled by 100 ",
    );
}

#[test]
fn factors_of_no_unit_are_measured_and_the_focal_length_is_suspected_as_well() {
    for factor in [0.43, 0.5, 1.7, 2.0] {
        assert_names(&on_mesh(|p| p / factor), "the mesh is seen");
        let message = message(|capture| {
            for frame in &mut capture.frames {
                frame.camera.focal = frame.camera.focal.map(|f| f / factor);
            }
        });
        assert_names(&message, "the mesh is seen");
        let words = message.split("scale the mesh by ").nth(1).unwrap();
        let told: f32 = words.split(',').next().unwrap().parse().unwrap();
        assert!((told / factor - 1.0).abs() < 0.1, "{factor}: {message}");
        assert!(message.contains("focal length"), "{message}");
    }
}

#[test]
fn camera_conventions_are_named() {
    assert_names(
        &on_cameras(|pose| pose * flip()),
        "`transform_matrix` has OpenCV's camera axes",
    );
    assert_names(
        &on_cameras(|pose| pose.inverse()),
        "`transform_matrix` is world to camera (",
    );
    assert_names(
        &on_cameras(|pose| (pose * flip()).inverse()),
        "`transform_matrix` is world to camera with OpenCV's axes",
    );
}

#[test]
fn two_mistakes_at_once_are_named_together() {
    let message = on_mesh(|p| 100.0 * Vec3::new(p.x, p.z, -p.y));
    assert_names(
        &message,
        "the mesh is y up and the cameras z up, and the mesh's unit",
    );
    assert!(message.contains("scaled by 0.01 "), "{message}");
}

#[test]
fn masks_are_blamed_when_they_are_wrong() {
    let invert = |capture: &mut Capture| {
        for value in capture
            .frames
            .iter_mut()
            .flat_map(|frame| &mut frame.mask.data)
        {
            *value = 1.0 - *value;
        }
    };
    assert_names(&message(invert), "the masks are inverted");
    let full = |capture: &mut Capture| {
        capture
            .frames
            .iter_mut()
            .for_each(|frame| frame.mask.data.fill(1.0))
    };
    assert!(message(full).contains("The masks cover whole images"));
}

#[test]
fn an_offset_mesh_is_named() {
    assert_names(
        &on_mesh(|p| p + Vec3::new(1.5, -1.0, 0.5)),
        "the mesh lies away from the origin",
    );
}

#[test]
fn what_nerfstudio_did_to_the_cameras_alone_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let mut capture = small_capture(Vec3::ZERO);
    // The mesh as it was before cameras were turned about an axis that no other cause knows, moved and scaled.
    let turn = Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -1.0).normalize(), 1.0);
    let (offset, scale) = (Vec3::new(0.4, -0.3, 0.2), 0.3f32);
    for position in &mut capture.mesh.positions {
        *position = turn.transpose() * (*position / scale - offset);
    }
    write(&path, &capture).unwrap();
    let json = path.join("transforms.json");
    let mut transforms: Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    let row = |axis: usize| -> Value {
        let row = turn.row(axis);
        vec![row.x, row.y, row.z, offset[axis]].into()
    };
    transforms["applied_transform"] = vec![row(0), row(1), row(2)].into();
    transforms["applied_scale"] = scale.into();
    fs::write(&json, transforms.to_string()).unwrap();
    let error = Capture::load(&path, &LoadOptions::default()).unwrap_err();
    let message = error.to_string();
    assert_names(
        &message,
        "`applied_transform` was applied to the cameras but not to the mesh",
    );
    assert!(
        message.contains("and `applied_scale` after it"),
        "{message}"
    );
}

#[test]
fn what_nothing_explains_is_said_to_be_unexplained() {
    let message = on_mesh(|p| Vec3::new(0.1 * p.x, p.y * 2.0, p.z * 0.3));
    assert!(message.contains("No common cause"), "{message}");
}

#[test]
fn the_check_can_be_switched_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let mut capture = small_capture(Vec3::ZERO);
    write(&path, &capture).unwrap();
    capture
        .mesh
        .positions
        .iter_mut()
        .for_each(|p| *p = Vec3::new(p.x, p.z, -p.y));
    fs::remove_file(path.join("mesh.glb")).unwrap();
    write_glb(
        &path.join("mesh.glb"),
        &capture.mesh,
        &GlbSurface::default(),
    )
    .unwrap();
    assert!(Capture::load(&path, &LoadOptions::default()).is_err());
    let options = LoadOptions {
        min_overlap: 0.0,
        ..LoadOptions::default()
    };
    assert!(Capture::load(&path, &options).is_ok());
}
