//! Exported scenes as the programs they are for render them, where those are installed for Python (`pip install mitsuba bpy`).

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

use eclipse::{
    export::{Program, export},
    image_io::read_exr,
    output,
    reconstruction::Uncertainty,
    report::ReportOptions,
};
use eclipse_tests::{
    perfect,
    program::{self, stderr, text},
    skipped,
};
use glam::Vec3;
use render::{image::Image, lat_long::LatLong};
use tempfile::TempDir;

const MITSUBA: &str = r#"
import mitsuba as mi
mi.set_variant("scalar_rgb")
image = mi.render(mi.load_file("scene.xml", spp=16))
mi.Bitmap(image).convert(component_format=mi.Struct.Type.Float32).write("picture.exr")
"#;

const BLENDER: &str = r#"
import os
import bpy
exec(compile(open("scene.py").read(), "scene.py", "exec"), {"__file__": "scene.py"})
scene = bpy.context.scene
scene.cycles.samples = 16
scene.cycles.use_denoising = False
scene.render.film_transparent = True
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = os.path.abspath("picture.exr")
bpy.ops.render.render(write_still=True)
"#;

#[test]
fn mitsuba_renders_the_same_picture() {
    check(Program::Mitsuba, "mitsuba", MITSUBA, &[]);
}

#[test]
fn blender_renders_the_same_picture_however_its_python_hashes() {
    // Its reader of glTF keeps attributes in sets, whose order is another at every start.
    check(Program::Blender, "bpy", BLENDER, &["1", "2", "3"]);
}

/// Renders our scene by `script`, once a seed of Python's hashes, and compares with `eclipse relight`.
fn check(program: Program, module: &str, script: &str, seeds: &[&str]) {
    let found = python(Path::new("."), &format!("import {module}"), "0");
    if !found.is_some_and(|output| output.status.success()) {
        skipped(&format!(
            "no Python with `{module}`, which `pip install {module}` installs"
        ));
        return;
    }
    let (run, ours) = relit();
    let folder = tempfile::tempdir().unwrap();
    export(run, program, folder.path()).unwrap();
    for seed in if seeds.is_empty() { &["0"] } else { seeds } {
        let output = python(folder.path(), script, seed).unwrap();
        let path = folder.path().join("picture.exr");
        assert!(path.is_file(), "{}", stderr(&output));
        let theirs = read_exr(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let [ratio, off] = compare(&theirs, ours);
        assert!((ratio - 1.0).abs() < 0.01, "{module}: {ratio} as bright");
        assert!(off < 0.03, "{module}: off by {off}");
    }
}

fn python(folder: &Path, script: &str, seed: &str) -> Option<Output> {
    let mut command = Command::new("python3");
    command.args(["-c", script]).current_dir(folder);
    command.env("PYTHONHASHSEED", seed).output().ok()
}

/// A matt object in smooth uneven light: its folder, and the picture that `eclipse relight` makes of it.
fn relit() -> &'static (PathBuf, Image) {
    static RELIT: OnceLock<(TempDir, (PathBuf, Image))> = OnceLock::new();
    let (_, relit) = RELIT.get_or_init(|| {
        let capture = perfect::capture();
        let mut result = perfect::reconstruction(&capture);
        let grid = LatLong::new(50, 100);
        result.environment = Image::filled(100, 50, 3, 0.0);
        for row in 0..50 {
            for column in 0..100 {
                let d = grid.texel_direction(row, column);
                let lobe = |axis: Vec3| 0.2 + 2.0 * d.dot(axis.normalize()).max(0.0).powi(4);
                let value = [
                    lobe(Vec3::new(1.0, 1.0, 0.3)),
                    lobe(Vec3::new(0.2, -1.0, 0.5)),
                    lobe(Vec3::new(-0.3, 0.2, 1.0)),
                ];
                result
                    .environment
                    .pixel_mut(column, row)
                    .copy_from_slice(&value);
            }
        }
        for (material, position) in result
            .vertex_materials
            .iter_mut()
            .zip(&capture.mesh.positions)
        {
            material.albedo = position.to_array().map(|x| 0.5 + 0.4 * (4.0 * x).sin());
        }
        // What an object carries beside its materials must not be in the way.
        result.uncertainty = Some(Uncertainty {
            environment: result.environment.clone(),
            vertex_albedo: vec![[0.01, 0.02, 0.03]; capture.mesh.positions.len()],
            ..Uncertainty::default()
        });
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        output::write(&run, &capture, &result, &ReportOptions::default()).unwrap();
        let out = folder.path().join("relit");
        let arguments = [
            "relight",
            text(&run),
            "--environment",
            &format!("{}/environment.exr", text(&run)),
            "--frames",
            "1",
            "--out",
            text(&out),
        ];
        let output = program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), &arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        let picture = read_exr(&out.join("000.exr")).unwrap();
        (folder, (run, picture))
    });
    relit
}

/// Of the mean over squares of 8 x 8 pixels that ours sees the object in throughout: brightness over ours, relative RMS difference.
fn compare(theirs: &Image, ours: &Image) -> [f64; 2] {
    const SIDE: usize = 8;
    assert_eq!([theirs.width, theirs.height], [ours.width, ours.height]);
    let mut sums = [0.0; 3];
    for (y, x) in (0..ours.height / SIDE).flat_map(|y| (0..ours.width / SIDE).map(move |x| (y, x)))
    {
        let pixels = || (0..SIDE * SIDE).map(move |i| (SIDE * x + i % SIDE, SIDE * y + i / SIDE));
        if pixels().any(|(x, y)| ours.pixel(x, y)[3] < 0.99) {
            continue;
        }
        for c in 0..3 {
            let sum = |image: &Image| -> f64 {
                pixels().map(|(x, y)| f64::from(image.pixel(x, y)[c])).sum()
            };
            let (theirs, ours) = (sum(theirs), sum(ours));
            sums[0] += theirs;
            sums[1] += ours;
            sums[2] += (theirs - ours).powi(2) / ours;
        }
    }
    assert!(sums[1] > 0.0);
    [sums[0] / sums[1], (sums[2] / sums[1]).sqrt()]
}
