//! `eclipse inspect`: what it says is true, in all its forms.

use std::{fs, path::Path, process::Output};

use eclipse::{
    capture::{LoadOptions, UpAxis, formats::colmap::Encoding, write},
    inspect::{Inspection, inspect, page},
    settings::Settings,
};
use eclipse_tests::{
    capture_turned::lying,
    colmap_model, perfect,
    program::{self, text},
    small_capture::small_capture,
};
use glam::Vec3;
use serde_json::Value;

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}

fn inspected(path: &Path) -> Inspection {
    inspected_with(path, UpAxis::Z)
}

fn inspected_with(path: &Path, up: UpAxis) -> Inspection {
    let options = LoadOptions {
        up,
        ..LoadOptions::default()
    };
    inspect(path, options, &Settings::default()).unwrap().0
}

fn warns(inspection: &Inspection, part: &str) -> bool {
    inspection.warnings.iter().any(|w| w.contains(part))
}

#[test]
fn the_bundled_capture_is_understood() {
    let inspection = inspected(&perfect::bundled());
    let capture = perfect::capture();
    assert_eq!(inspection.problem, None);
    assert_eq!(inspection.frames.len(), capture.frames.len());
    assert!(inspection.silhouettes.median > 0.9);
    assert!(inspection.silhouettes.worst <= inspection.silhouettes.median);
    // Something always lies on the ground, and cameras all around see the rest.
    assert!((0.6..=1.0).contains(&inspection.coverage.seen));
    assert!(inspection.coverage.seen_by_three <= inspection.coverage.seen);
    assert!(inspection.cameras.tilt < 30.0 && inspection.cameras.widest_gap < 90.0);
    assert!(inspection.exposure.spread < 10.0 && inspection.exposure.at_maximum < 0.005);
    assert!(inspection.run.memory > 80 << 20 && inspection.run.memory <= 4 << 30);
    assert_eq!(inspection.warnings, [""; 0]);
}

#[test]
fn numbers_are_those_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let centre = Vec3::new(3.0, -2.0, 1.0);
    let mut made = small_capture(centre);
    // One photograph of twelve times the exposure, and a quarter of its pixels clipped.
    for (index, frame) in made.frames.iter_mut().enumerate() {
        let level = if index == 2 { 2.0 } else { 2.0 / 12.0 };
        frame.image.data.fill(level);
    }
    for pixel in made.frames[2].image.data.chunks_exact_mut(3).step_by(4) {
        pixel.fill(4.5);
    }
    let path = folder.path().join("capture");
    write(&path, &made).unwrap();
    let inspection = inspected(&path);
    assert!((Vec3::from(inspection.object.centre) - centre).length() < 1e-4);
    let size = Vec3::from(inspection.object.size);
    assert!((size - Vec3::new(1.6, 1.1, 0.8)).length() < 1e-4, "{size}");
    for (index, frame) in inspection.frames.iter().enumerate() {
        let eye = made.frames[index].camera.centre();
        // From one side of ±180° to the other is no difference.
        let off = (frame.azimuth - 60.0 * index as f32 + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 0.1, "{} of {index}", frame.azimuth);
        assert!((frame.distance - eye.length()).abs() < 1e-3);
        assert!((frame.elevation - (eye.z / eye.length()).asin().to_degrees()).abs() < 0.1);
        assert_eq!([frame.width, frame.height], [64, 48]);
    }
    assert!((inspection.cameras.widest_gap - 60.0).abs() < 0.1);
    let exposure = &inspection.exposure;
    assert!((exposure.spread - 12.0).abs() < 1e-2, "{}", exposure.spread);
    assert!((exposure.maximum - 4.5).abs() < 1e-2);
    assert!((0.02..0.07).contains(&exposure.at_maximum));
    for part in [
        "only 6 photographs",
        "times as bright as the darkest",
        "highlights are clipped",
    ] {
        let found = inspection.warnings.iter().any(|w| w.contains(part));
        assert!(found, "{part}: {:?}", inspection.warnings);
    }
}

#[test]
fn of_two_meshes_the_one_that_is_taken_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    write(&path, &small_capture(Vec3::ZERO)).unwrap();
    let alone = inspected(&path);
    let mesh = path.join("mesh.glb");
    assert_eq!(alone.object.file.as_deref(), Some(&*mesh));
    assert!(alone.object.passed_over.is_empty() && !warns(&alone, "mesh.glb"));

    std::fs::write(path.join("mesh.obj"), "").unwrap();
    let two = inspected(&path);
    assert_eq!(two.object.file.as_deref(), Some(&*mesh));
    assert_eq!(two.object.passed_over, [path.join("mesh.obj")]);
    assert!(
        warns(
            &two,
            "mesh.obj is there too and not used, the mesh being mesh.glb"
        ),
        "{:?}",
        two.warnings
    );
    // Whoever names the mesh has chosen.
    let options = LoadOptions {
        mesh: Some(mesh),
        ..LoadOptions::default()
    };
    let chosen = inspect(&path, options, &Settings::default()).unwrap().0;
    assert!(!warns(&chosen, "mesh.obj"), "{:?}", chosen.warnings);
}

#[test]
fn sparse_points_and_the_up_direction_of_colmap_models_are_judged() {
    let folder = tempfile::tempdir().unwrap();
    colmap_model::write(folder.path(), &small_capture(Vec3::ZERO), Encoding::Text);
    let inspection = inspected(folder.path());
    let points = inspection.points.expect("the model has points");
    assert_eq!((points.count, points.in_box), (72, 72));
    assert!(inspection.cameras.tilt < 30.0);

    let far = "1 100 0 0 10 20 30 0.5\n2 0 100 0 10 20 30 0.5\n";
    fs::write(folder.path().join("sparse/0/points3D.txt"), far).unwrap();
    let inspection = inspected(folder.path());
    let warned = warns(&inspection, "none of the 2 sparse points");
    assert!(warned, "{:?}", inspection.warnings);
}

#[test]
fn sparse_points_are_turned_as_the_capture_is() {
    let made = small_capture(Vec3::new(0.5, -0.25, 2.0));
    let oblique = "0.3,-0.8,0.4".parse().unwrap();
    for up in UpAxis::ALL.into_iter().chain([oblique]) {
        let folder = tempfile::tempdir().unwrap();
        colmap_model::write(folder.path(), &lying(&made, up), Encoding::Binary);
        let points = inspected_with(folder.path(), up).points;
        let points = points.expect("the model has points");
        assert_eq!((points.count, points.in_box), (72, 72), "{up:?}");
    }
    // The page has them as the text does.
    let folder = tempfile::tempdir().unwrap();
    colmap_model::write(folder.path(), &made, Encoding::Text);
    let settings = Settings::default();
    let (inspection, capture) = inspect(folder.path(), LoadOptions::default(), &settings).unwrap();
    let page = page::html(&inspection, &capture).unwrap();
    for row in [
        "<td>sparse points</td><td>72, of which 72 lie in the mesh's box</td>",
        "<td>axis nearest to upward</td><td>z</td>",
        "<td>light</td><td>the best linear estimate, ",
    ] {
        assert!(page.contains(row), "{row}");
    }
}

#[test]
fn sparse_points_of_nerfstudio_are_judged_and_those_that_cannot_be_read_are_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let made = small_capture(Vec3::new(0.5, -0.25, 2.0));
    write(&path, &made).unwrap();
    let json = path.join("transforms.json");
    let mut transforms: Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    transforms["ply_file_path"] = "sparse_pc.ply".into();
    fs::write(&json, transforms.to_string()).unwrap();
    let put = |points: &[Vec3]| {
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uint8 red\nend_header\n",
            points.len()
        );
        let rows = points
            .iter()
            .map(|p| format!("{} {} {} 7\n", p.x, p.y, p.z));
        let text = header + &rows.collect::<String>();
        fs::write(path.join("sparse_pc.ply"), text).unwrap();
    };
    let counts = || {
        let found = inspected(&path).points;
        found.map(|points| (points.count, points.in_box))
    };
    // The file need not be there, where there is a mesh.
    assert_eq!(counts(), None);
    let corners = made.mesh.positions.iter().map(|p| *p + made.centre);
    put(&corners.collect::<Vec<_>>());
    assert_eq!(counts(), Some((72, 72)));
    put(&[100.0 * Vec3::X]);
    assert_eq!(counts(), Some((1, 0)));
    assert!(warns(&inspected(&path), "none of the 1 sparse points"));
    // A mesh holds no sparse points, and a run would take a capture whose points are damaged.
    fs::write(
        path.join("sparse_pc.ply"),
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
         property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    )
    .unwrap();
    assert_eq!(counts(), None);
    fs::write(path.join("sparse_pc.ply"), "ply\n").unwrap();
    let inspection = inspected(&path);
    assert_eq!(inspection.problem, None);
    assert!(warns(&inspection, "the sparse points say nothing"));
}

#[test]
fn a_world_on_its_side_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let mut capture = small_capture(Vec3::ZERO);
    let turn = glam::Mat4::from_rotation_x(std::f32::consts::FRAC_PI_2);
    for frame in &mut capture.frames {
        frame.camera.world_from_camera = turn * frame.camera.world_from_camera;
    }
    for vector in capture
        .mesh
        .positions
        .iter_mut()
        .chain(&mut capture.mesh.normals)
    {
        *vector = turn.transform_vector3(*vector);
    }
    let path = folder.path().join("capture");
    write(&path, &capture).unwrap();
    let inspection = inspected(&path);
    assert!(
        (inspection.cameras.tilt - 90.0).abs() < 15.0,
        "{}",
        inspection.cameras.tilt
    );
    assert!(warns(&inspection, "off the world's z axis"));
    // What is to be typed is told, and with it there is nothing to warn of.
    assert_eq!(inspection.cameras.nearest_up, "-y");
    assert!(warns(&inspection, "probably with --up -y,"));
    let upward = Vec3::from(inspection.cameras.upward);
    assert!(upward.angle_between(Vec3::NEG_Y) < 15f32.to_radians());
    let shown = eclipse(&["inspect", text(&path)]);
    assert!(program::stdout(&shown).contains("(in the capture's own axes they hold"));
    let upright = inspected_with(&path, UpAxis::NegY);
    assert!((Vec3::from(upright.cameras.upward) - upward).length() < 1e-5);
    assert!(upright.cameras.tilt < 30.0, "{}", upright.cameras.tilt);
    assert_eq!(upright.cameras.nearest_up, "-y");
    assert!(!warns(&upright, "off the world's z axis"));
}

#[test]
fn looks_of_the_mesh_that_are_not_used_are_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scan) = (
        folder.path().join("capture"),
        folder.path().join("scan.obj"),
    );
    let made = small_capture(Vec3::ZERO);
    write(&path, &made).unwrap();
    let vertices = made
        .mesh
        .positions
        .iter()
        .map(|p| format!("v {} {} {}", p.x, p.y, p.z));
    let faces = made.mesh.faces.iter();
    let faces = faces.map(|face| face.map(|index| (index + 1).to_string()).join(" "));
    let obj = |colour: &str, material: &str| {
        let vertices = vertices.clone().map(|vertex| vertex + colour + "\n");
        let faces = faces.clone().map(|face| format!("f {face}\n"));
        vertices.collect::<String>() + material + &faces.collect::<String>()
    };
    let shown = |scan_text: String| {
        fs::write(&scan, scan_text).unwrap();
        let shown = eclipse(&["inspect", text(&path), "--mesh", text(&scan)]);
        assert_eq!(shown.status.code(), Some(0));
        program::stdout(&shown)
    };
    let painted = shown(obj(" 0.5 0.4 0.3", "usemtl paint\n"));
    let remark = "; only its shape is used, not the vertex colours and materials of its file";
    assert!(painted.contains(remark), "{painted}");
    assert!(!shown(obj("", "")).contains("only its shape"));
    // The capture's own mesh, which is written with a material.
    assert_eq!(inspected(&path).object.unused, ["materials"]);
}

#[test]
fn the_command_prints_text_or_json_and_writes_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("it's <b>"), folder.path().join("out"));
    write(&path, &small_capture(Vec3::ZERO)).unwrap();

    let shown = eclipse(&["inspect", text(&path)]);
    assert_eq!(shown.status.code(), Some(0));
    let shown = String::from_utf8(shown.stdout).unwrap();
    for part in [
        "6, 64 × 48 pixels",
        "silhouettes",
        "coverage",
        "a run takes",
        "warning",
    ] {
        assert!(shown.contains(part), "{part}: {shown}");
    }

    let json = eclipse(&["inspect", text(&path), "--json", "--out", text(&out)]);
    assert_eq!(json.status.code(), Some(0));
    let printed: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!(printed["frames"].as_array().unwrap().len(), 6);
    assert_eq!(printed["object"]["faces"], 36);
    let written = fs::read(out.join("inspection.json")).unwrap();
    assert_eq!(printed, serde_json::from_slice::<Value>(&written).unwrap());

    let page = fs::read_to_string(out.join("inspection.html")).unwrap();
    assert_eq!(page.matches("<img ").count(), 6);
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 6);
    assert_eq!(page.matches("<polyline").count(), 6);
    assert!(page.contains("it's &lt;b&gt;") && !page.contains("it's <b>"));
    // Self-contained: nothing is fetched.
    assert!(!page.contains("http"), "no network");

    let again = folder.path().join("again");
    eclipse(&["inspect", text(&path), "--out", text(&again)]);
    assert_eq!(
        page,
        fs::read_to_string(again.join("inspection.html")).unwrap(),
        "deterministic"
    );
}

#[test]
fn a_capture_that_a_run_would_refuse_is_shown_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let mut capture = small_capture(Vec3::ZERO);
    for position in &mut capture.mesh.positions {
        *position *= 0.1;
    }
    write(&path, &capture).unwrap();
    let out = folder.path().join("out");
    let shown = eclipse(&["inspect", text(&path), "--out", text(&out)]);
    assert_eq!(shown.status.code(), Some(3));
    let message = String::from_utf8(shown.stderr).unwrap();
    assert!(
        message.starts_with("error: the mesh and the cameras disagree"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1);
    assert!(
        String::from_utf8(shown.stdout)
            .unwrap()
            .contains("silhouettes")
    );
    let page = fs::read_to_string(out.join("inspection.html")).unwrap();
    assert!(page.contains("the mesh and the cameras disagree"));
}

#[test]
fn what_no_run_has_the_memory_for_is_a_problem() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    write(&path, &small_capture(Vec3::ZERO)).unwrap();
    let settings = Settings {
        memory: 1 << 20,
        ..Settings::default()
    };
    let (inspection, _) = inspect(&path, LoadOptions::default(), &settings).unwrap();
    let problem = inspection.problem.expect("a run takes more than that");
    assert!(problem.contains("more than the 1 MiB"), "{problem}");
    assert!(problem.contains("(--max-size)"), "{problem}");
}

#[test]
fn what_is_no_capture_exits_with_three_and_one_message() {
    let folder = tempfile::tempdir().unwrap();
    let shown = eclipse(&["inspect", text(folder.path())]);
    assert_eq!(shown.status.code(), Some(3));
    let message = String::from_utf8(shown.stderr).unwrap();
    assert!(
        message.contains("none of the files that describe a capture"),
        "{message}"
    );
    assert!(shown.stdout.is_empty() && message.lines().count() == 1);
}
