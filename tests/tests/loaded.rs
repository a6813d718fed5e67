//! Exported scenes as the programs they are for render them, where those are installed: for Python (`pip install mitsuba bpy`), or
//! for a browser (`npm install three`, whose folder `ECLIPSE_THREE` names).

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

use eclipse::{
    export::{Program, export},
    image_io::{read_exr, srgb_to_linear},
    output,
    reconstruction::Uncertainty,
    report::ReportOptions,
};
use eclipse_tests::{
    browser::{self, Browser, SOFTWARE},
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

/// The variable that names the folder of the package `three`.
const THREE: &str = "ECLIPSE_THREE";
/// Strength of the light on the page of three.js, so that nothing is too bright for a screen.
const DIM: f32 = 0.4;

#[test]
fn threejs_shows_the_same_light_and_the_same_object() {
    let Some(library) = std::env::var_os(THREE) else {
        skipped(&format!(
            "{THREE} names no folder of three.js, which `npm install three@0.170` makes in node_modules"
        ));
        return;
    };
    let Some(program) = browser::installed() else {
        return;
    };
    let (run, ours) = relit();
    let folder = tempfile::tempdir().unwrap();
    export(run, Program::ThreeJs, folder.path()).unwrap();
    let path = folder.path().join("index.html");
    let page = std::fs::read_to_string(&path).unwrap();
    let (_, rest) = page.split_once(r#""three": ""#).unwrap();
    let (online, _) = rest.split_once("build/three.module.js").unwrap();
    let library = std::fs::canonicalize(library).unwrap();
    let page = page.replace(online, &format!("file://{}/", library.display()));
    let show = "renderer.domElement.id = 'canvas'; window.view = { scene, camera }; renderer.setAnimationLoop";
    std::fs::write(&path, page.replace("renderer.setAnimationLoop", show)).unwrap();

    let flags = [&SOFTWARE[..], &["--allow-file-access-from-files"]].concat();
    let size = [ours.width, ours.height].map(|side| u32::try_from(side).unwrap());
    let mut browser = Browser::start(&program, &flags, size);
    browser.open(&path);
    browser.wait_for("!!window.view?.scene.background?.image && view.scene.children.length === 1");
    browser.evaluate(&format!(
        "view.scene.environmentIntensity = view.scene.backgroundIntensity = {DIM}"
    ));
    let theirs = linear(&browser.picture("canvas"));
    // It casts no shadows of the light: crevices are brighter, nothing is darker, and colours go together.
    let [ratio, _] = compare(&theirs, ours);
    assert!((0.99..1.2).contains(&ratio), "{ratio} as bright");
    let alike = correlation(&squares(&theirs, ours));
    assert!(alike > 0.85, "correlation {alike}");

    // The light itself, where the camera is turned towards it.
    browser.evaluate("view.scene.children[0].visible = false; view.camera.position.set(0, 0, 0)");
    for axis in [
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Y,
        Vec3::NEG_Y,
        Vec3::new(0.3, 0.2, 0.9),
        Vec3::new(-0.4, 0.3, -0.8),
    ] {
        // y is up there.
        let [x, y, z] = [axis.x, axis.z, -axis.y];
        browser.evaluate(&format!("view.camera.lookAt({x}, {y}, {z})"));
        let seen = linear(&browser.picture("canvas"));
        let seen = seen.pixel(seen.width / 2, seen.height / 2);
        let sent = light(axis.normalize());
        for (seen, sent) in seen.iter().zip(sent) {
            assert!(
                (seen - sent).abs() < 0.03 * sent,
                "{axis}: {seen} of {sent}"
            );
        }
    }
    assert!(browser.exceptions.is_empty(), "{:?}", browser.exceptions);
}

/// What a picture of the page shows, were the light as strong as it is.
fn linear(picture: &image::RgbImage) -> Image {
    let values = picture.as_raw().iter();
    Image {
        width: picture.width() as usize,
        height: picture.height() as usize,
        channels: 3,
        data: values
            .map(|&value| srgb_to_linear(f32::from(value) / 255.0) / DIM)
            .collect(),
    }
}

/// Smooth uneven light.
fn light(d: Vec3) -> [f32; 3] {
    [
        Vec3::new(1.0, 1.0, 0.3),
        Vec3::new(0.2, -1.0, 0.5),
        Vec3::new(-0.3, 0.2, 1.0),
    ]
    .map(|axis| 0.2 + 2.0 * d.dot(axis.normalize()).max(0.0).powi(4))
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
                let value = light(d);
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

/// Of the mean over squares: brightness over ours, relative RMS difference.
fn compare(theirs: &Image, ours: &Image) -> [f64; 2] {
    let mut sums = [0.0; 3];
    for [theirs, ours] in squares(theirs, ours) {
        sums[0] += theirs;
        sums[1] += ours;
        sums[2] += (theirs - ours).powi(2) / ours;
    }
    assert!(sums[1] > 0.0);
    [sums[0] / sums[1], (sums[2] / sums[1]).sqrt()]
}

fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let mean = [0, 1].map(|k| pairs.iter().map(|pair| pair[k]).sum::<f64>() / pairs.len() as f64);
    let product = |i: usize, j: usize| -> f64 {
        let terms = pairs
            .iter()
            .map(|pair| (pair[i] - mean[i]) * (pair[j] - mean[j]));
        terms.sum()
    };
    product(0, 1) / (product(0, 0) * product(1, 1)).sqrt()
}

/// Sums over squares of 8 x 8 pixels that ours sees the object in throughout, theirs and ours, colour by colour.
fn squares(theirs: &Image, ours: &Image) -> Vec<[f64; 2]> {
    const SIDE: usize = 8;
    assert_eq!([theirs.width, theirs.height], [ours.width, ours.height]);
    let mut squares = Vec::new();
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
            squares.push([sum(theirs), sum(ours)]);
        }
    }
    squares
}
