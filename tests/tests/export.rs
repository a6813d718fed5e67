//! Results in other programs: what they would load, read by other readers and looked up by their own formulas.

use std::{
    f32::consts::{PI, TAU},
    fs,
    path::{Path, PathBuf},
    process::Output,
    sync::OnceLock,
};

use eclipse::{
    capture::Capture,
    export::{Program, export},
    mesh_io::read_mesh,
    output,
    reconstruction::Reconstruction,
    report::ReportOptions,
};
use eclipse_tests::{
    perfect,
    program::{self, stderr, stdout, text},
    skipped,
};
use exr::prelude::{ReadChannels, ReadLayers, read};
use glam::Vec3;
use render::{image::Image, lat_long::LatLong};
use tempfile::TempDir;

/// A direction without symmetry, in which a lamp stands.
fn marked() -> Vec3 {
    Vec3::new(0.48, -0.64, 0.6)
}

/// A result whose light is uneven everywhere and brightest in the marked direction.
fn result(capture: &Capture) -> Reconstruction {
    let mut result = perfect::reconstruction(capture);
    let grid = LatLong::new(50, 100);
    let mut light = Image::filled(100, 50, 3, 0.0);
    for row in 0..50 {
        for column in 0..100 {
            let d = grid.texel_direction(row, column);
            let noise = ((row * 31 + column * 17) % 23) as f32 / 23.0;
            let lamp = 50.0 * (40.0 * (d.dot(marked()) - 1.0)).exp();
            let value = [noise + lamp, 0.5 * noise + lamp, 1.0 - noise + lamp];
            light.pixel_mut(column, row).copy_from_slice(&value);
        }
    }
    result.environment = light;
    result.settings.lambertian = false;
    for (index, material) in result.vertex_materials.iter_mut().enumerate() {
        material.albedo = [0.2, 0.4, 0.1 + 0.8 * (index % 7) as f32 / 7.0];
        material.alpha = 0.36;
    }
    result
}

/// The folder of such a result and the result, written once: what tests export goes elsewhere, or where no other looks.
fn run_folder() -> &'static (PathBuf, Reconstruction) {
    static RUN: OnceLock<(TempDir, (PathBuf, Reconstruction))> = OnceLock::new();
    let (_, run) = RUN.get_or_init(|| {
        let capture = perfect::capture();
        let result = result(&capture);
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        output::write(&run, &capture, &result, &ReportOptions::default()).unwrap();
        (folder, (run, result))
    });
    run
}

/// Where each program looks a direction of our world up, from its own sources: column and row, fractional, of an image of
/// `size`, texel centres at whole numbers.
fn place(program: Program, d: Vec3, [width, height]: [usize; 2]) -> [f32; 2] {
    // Programs with y up.
    let p = Vec3::new(d.x, d.z, -d.y);
    let (w, h) = (width as f32, height as f32);
    match program {
        // Cycles' direction_to_equirectangular: u = −atan2(y, x)/2π + ½, v = atan2(z, hypot(x, y))/π + ½ from below.
        Program::Blender => {
            let u = -d.y.atan2(d.x) / TAU + 0.5;
            let v = d.z.atan2(d.x.hypot(d.y)) / PI + 0.5;
            [u * w - 0.5, (1.0 - v) * h - 0.5]
        }
        // Mitsuba's envmap: u = atan2(x, −z)/2π shifted by half a texel, v = acos(y)/π over height − 1.
        Program::Mitsuba => {
            let u = p.x.atan2(-p.z) / TAU;
            [u.rem_euclid(1.0) * w - 0.5, p.y.acos() / PI * (h - 1.0)]
        }
        // three.js' equirectUv: u = atan(z, x)/2π + ½, v = asin(y)/π + ½ from below.
        Program::ThreeJs => {
            let u = p.z.atan2(p.x) / TAU + 0.5;
            let v = p.y.asin() / PI + 0.5;
            [u * w - 0.5, (1.0 - v) * h - 0.5]
        }
    }
}

/// An image by the `exr` crate alone.
fn read_raw(path: &Path) -> (usize, usize, [Vec<f32>; 3]) {
    let file = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .unwrap();
    let size = file.layer_data.size;
    let channel = |name: &str| {
        let list = &file.layer_data.channel_data.list;
        let channel = list.iter().find(|c| c.name.to_string() == name).unwrap();
        channel.sample_data.values_as_f32().collect::<Vec<f32>>()
    };
    (size.0, size.1, ["R", "G", "B"].map(channel))
}

/// Bilinear, columns wrapping, rows clamped.
fn lookup(values: &[f32], [width, height]: [usize; 2], [x, y]: [f32; 2]) -> f32 {
    let y = y.clamp(0.0, (height - 1) as f32);
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let at = |dx: i64, dy: i64| {
        let column = (x0 as i64 + dx).rem_euclid(width as i64) as usize;
        let row = (y0 as i64 + dy).min(height as i64 - 1) as usize;
        values[row * width + column]
    };
    (1.0 - fy) * ((1.0 - fx) * at(0, 0) + fx * at(1, 0))
        + fy * ((1.0 - fx) * at(0, 1) + fx * at(1, 1))
}

#[test]
fn every_program_sees_the_same_light_in_the_same_direction() {
    let folder = tempfile::tempdir().unwrap();
    let (run, result) = run_folder();
    let ours = LatLong::new(50, 100);
    for program in Program::ALL {
        let out = folder.path().join(program.name());
        export(run, program, &out).unwrap();
        let (width, height, channels) = read_raw(&out.join("environment.exr"));
        let size = [width, height];
        // The brightest texel is where the program looks for the marked direction.
        let brightest = (0..width * height)
            .max_by(|&a, &b| channels[0][a].total_cmp(&channels[0][b]))
            .unwrap();
        let [x, y] = place(program, marked(), size);
        let (dx, dy) = (
            (x - (brightest % width) as f32).abs(),
            (y - (brightest / width) as f32).abs(),
        );
        assert!(dx <= 1.0 && dy <= 2.0, "{program:?}: off by {dx}, {dy}");

        // And everywhere the light is ours, not only nearly: nothing is resampled away.
        let mut worst = 0.0f32;
        for k in 0..2000 {
            let z = 1.0 - 2.0 * (k as f32 + 0.5) / 2000.0;
            let azimuth = 2.399_963_2 * k as f32;
            let radius = (1.0 - z * z).sqrt();
            let d = Vec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
            // Next to a pole ours is flat, and theirs too, but for rounding of the place.
            for (channel, values) in channels.iter().enumerate() {
                let texels = ours.bilinear(d);
                let light: f32 = (0..4)
                    .map(|t| {
                        let index = 3 * texels.index[t] as usize + channel;
                        texels.weight[t] * result.environment.data[index]
                    })
                    .sum();
                let theirs = lookup(values, size, place(program, d, size));
                worst = worst.max((theirs - light).abs() / (1.0 + light));
            }
        }
        assert!(worst < 1e-3, "{program:?}: {worst}");
    }
}

#[test]
fn the_object_is_turned_as_its_light_is_and_keeps_its_materials() {
    let folder = tempfile::tempdir().unwrap();
    let (run, result) = run_folder();
    let out = folder.path().join("mitsuba");
    export(run, Program::Mitsuba, &out).unwrap();
    let capture = perfect::capture();
    let y_up = |p: Vec3| Vec3::new(p.x, p.z, -p.y);

    // By the `gltf` crate: positions as they are stored, the extension as it is written.
    let (document, buffers, _) = gltf::import(out.join("mesh.glb")).unwrap();
    let primitive = document
        .meshes()
        .next()
        .unwrap()
        .primitives()
        .next()
        .unwrap();
    let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()]));
    let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
    for (stored, own) in positions.iter().zip(&capture.mesh.positions) {
        let expected = y_up(*own + capture.centre);
        assert!((Vec3::from(*stored) - expected).length() < 1e-5);
    }
    assert!(
        document
            .extensions_used()
            .any(|name| name == "KHR_materials_specular")
    );
    let specular = primitive.material().specular().unwrap();
    let kappa = 0.04 * specular.specular_factor() * specular.specular_color_factor()[0];
    assert!((kappa - 0.04).abs() < 1e-3, "{kappa}");

    // The PLY, which is read raw.
    let ply = read_mesh(&out.join("mesh.ply")).unwrap();
    assert_eq!(ply.faces, capture.mesh.faces);
    for (stored, own) in ply.positions.iter().zip(&capture.mesh.positions) {
        assert!((*stored - y_up(*own + capture.centre)).length() < 1e-5);
    }
    let bytes = fs::read(out.join("mesh.ply")).unwrap();
    let header = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap()
        + 11;
    let number = |vertex: usize, property: usize| {
        let at = header + 4 * (10 * vertex + property);
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    };
    let close = |vertex: &usize| {
        let albedo = result.vertex_materials[*vertex].albedo;
        let color = (0..3).all(|c| (number(*vertex, 6 + c) - albedo[c]).abs() < 0.02);
        color && (number(*vertex, 9) - 0.6).abs() < 0.01
    };
    let vertices = ply.positions.len();
    let good = (0..vertices).filter(close).count();
    // Textures have no room for a different value at every vertex; without them all are exact.
    let least = if capture.mesh.uvs.is_empty() {
        vertices
    } else {
        vertices / 2
    };
    assert!(good >= least, "{good} of {vertices}");

    let xml = fs::read_to_string(out.join("scene.xml")).unwrap();
    let (envmap, _) = xml.split_once("</emitter>").unwrap();
    let (_, envmap) = envmap.split_once("<emitter").unwrap();
    assert!(!envmap.contains("to_world") && envmap.contains("environment.exr"));
    assert!(xml.contains("vertex_roughness") && xml.contains("name=\"eta\" value=\"1.5"));
}

#[test]
fn scenes_name_their_files_and_scripts_are_python() {
    let (run, _) = run_folder();
    for program in Program::ALL {
        let output = eclipse(&["export", text(run), "--for", program.name()]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let out = run.join(program.name());
        assert!(stdout(&output).contains(program.scene()));
        let scene = fs::read_to_string(out.join(program.scene())).unwrap();
        assert!(scene.contains("environment.exr"));
        let notes = fs::read_to_string(out.join("export.txt")).unwrap();
        for entry in fs::read_dir(&out).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(name == "export.txt" || notes.contains(&name), "{name}");
        }
        // Again, over its own files.
        let again = eclipse(&["export", text(run), "--for", program.name()]);
        assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    }
    let script = run.join("blender/scene.py");
    let compiled = std::process::Command::new("python3")
        .args(["-c", "import ast, sys; ast.parse(open(sys.argv[1]).read())"])
        .arg(&script)
        .output();
    match compiled {
        Err(_) => skipped("no python3"),
        Ok(output) => assert!(output.status.success(), "{}", stderr(&output)),
    }
}

#[test]
fn a_result_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let (run, _) = run_folder();
    let before = fs::read(run.join("environment.exr")).unwrap();
    let output = eclipse(&["export", text(run), "--for", "mitsuba", "--out", text(run)]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("holds other files"),
        "{}",
        stderr(&output)
    );
    assert_eq!(fs::read(run.join("environment.exr")).unwrap(), before);

    // Another program's export takes the place of all of the first: its scene would find light that is turned.
    let out = folder.path().join("out");
    export(run, Program::Mitsuba, &out).unwrap();
    export(run, Program::Blender, &out).unwrap();
    let mut names: Vec<_> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        ["environment.exr", "export.txt", "mesh.glb", "scene.py"]
    );

    let output = eclipse(&["export", text(run), "--for", "maya"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("use one of blender, mitsuba, threejs"));
    let missing = folder.path().join("missing");
    let output = eclipse(&["export", text(&missing), "--for", "blender"]);
    assert_eq!(output.status.code(), Some(3));
    let message = stderr(&output);
    assert!(
        message.contains("there is no folder") && message.contains("missing"),
        "{message}"
    );
}

fn eclipse(arguments: &[&str]) -> Output {
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), arguments)
}
