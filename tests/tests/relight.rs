//! A recovered object in other light.

use std::{fs, path::Path, process::Output};

use eclipse::{
    capture::{Capture, formats::colmap::Encoding, read_cameras},
    image_io::{read_exr, read_image, write_exr},
    mesh_io::{GlbSurface, MeshSurface, write_glb},
    output,
    reconstruction::VertexMaterial,
    relight::{Object, Orbit, Quality, Stage, frame_names, picture},
    report::ReportOptions,
    synthesize::{self, Occluders, Pattern, Scene, Shooting},
};
use eclipse_tests::{
    colmap_model, perfect,
    program::{self, stderr, stdout, text},
    scenes,
    small_capture::{SIZE, boxes, small_capture},
    statistics::mean_and_error,
};
use glam::Vec3;
use render::{
    bsdf::{Material, Model},
    bvh::Bvh,
    environment::EnvironmentMap,
    image::Image,
    lat_long::LatLong,
    mesh::Mesh,
    reference::Reference,
};

const ALBEDO: [f32; 3] = [0.7, 0.5, 0.3];

/// The light that the object was not photographed in.
fn other_light() -> EnvironmentMap {
    scenes::interior(LatLong::new(50, 100))
}

/// A synthetic capture of an L-shaped object, which shades itself.
fn scene(model: Model) -> Scene {
    Scene {
        mesh: boxes(),
        environment: other_light().image().clone(),
        model,
        albedo: Pattern {
            mean: ALBEDO,
            variation: 0.0,
        },
        alpha: 0.5,
        kappa: 0.04,
        occluders: Occluders::None,
    }
}

fn shooting(frames: usize, resolution: usize) -> Shooting {
    Shooting {
        frames,
        resolution,
        distance: 4.0,
        noise: 0.0,
        seed: 0,
    }
}

/// The object as a perfect reconstruction of `scene` has it.
fn truth(scene: &Scene) -> Object {
    let material = VertexMaterial {
        albedo: scene.albedo.mean,
        alpha: scene.alpha,
        kappa: scene.kappa,
    };
    let surface = MeshSurface::Vertices(vec![material; scene.mesh.positions.len()]);
    Object::new(scene.mesh.clone(), surface, scene.model)
}

fn quality(samples: usize, seed: u64) -> Quality {
    Quality {
        samples,
        seed,
        backdrop: false,
    }
}

#[test]
fn relighting_the_truth_equals_photographing_it_there() {
    for model in [Model::Lambertian, Model::Microfacet] {
        let scene = scene(model);
        let made = synthesize::synthesize(&scene, &shooting(2, 20), |_| true).unwrap();
        let stage = Stage::new(truth(&scene), other_light(), 0.0).unwrap();
        let turned = Stage::new(truth(&scene), turned(&other_light()), 0.0).unwrap();
        // The photograph is made by quadrature on 25 rows. A grid twice as fine tells its error: that of a rule of first
        // order, along shadows' edges, is twice the difference of the two at most.
        let bvh = Bvh::new(&stage.object().mesh).unwrap();
        let environment = other_light();
        let radiance = |d| environment.radiance(d);
        let fine = Reference::with_radiance(&bvh, LatLong::new(50, 100), radiance, model, 4);
        let material = Material {
            albedo: ALBEDO,
            alpha: 0.5,
            kappa: 0.04,
        };
        let (mut errors, mut allowed, mut wrong) = (0.0, 0.0, 0.0);
        let (mut sum, mut sum_allowed) = (0.0, 0.0);
        let mut count = 0.0;
        for frame in &made.capture.frames {
            let better = fine.frame(&frame.camera, None, |_| material);
            let seeds: Vec<Image> = (0..8)
                .map(|seed| picture(&stage, &frame.camera, 0, &quality(128, seed), &|_| true))
                .map(Option::unwrap)
                .collect();
            let other = picture(&turned, &frame.camera, 0, &quality(128, 0), &|_| true).unwrap();
            for (pixel, photograph) in frame.image.data.chunks_exact(3).enumerate() {
                let covered = better.data[4 * pixel + 3];
                assert_eq!(
                    seeds[0].data[4 * pixel + 3],
                    covered,
                    "coverage of pixel {pixel}"
                );
                if covered < 1.0 {
                    continue;
                }
                for channel in 0..3 {
                    let at = 4 * pixel + channel;
                    let values: Vec<f64> = seeds.iter().map(|s| f64::from(s.data[at])).collect();
                    let (mean, error) = mean_and_error(&values);
                    let photograph = f64::from(photograph[channel]);
                    let bias = 2.0 * (photograph - f64::from(better.data[at]));
                    errors += (mean - photograph).powi(2);
                    allowed += error * error + bias * bias;
                    sum += mean - photograph;
                    sum_allowed += bias.abs();
                    wrong += (f64::from(other.data[at]) - photograph).powi(2);
                    count += 1.0;
                }
            }
        }
        assert!(count > 100.0);
        // Squared errors of a few hundred pixels are within a third of their expectation.
        assert!(
            errors < 1.3 * allowed,
            "{model:?}: {errors} against {allowed}"
        );
        assert!(
            sum.abs() < 4.0 * allowed.sqrt() + sum_allowed,
            "{model:?}: mean {}",
            sum / count
        );
        // The same comparison notices light from elsewhere.
        assert!(
            wrong > 10.0 * allowed,
            "{model:?}: {wrong} against {allowed}"
        );
    }
}

/// The light turned by a quarter.
fn turned(light: &EnvironmentMap) -> EnvironmentMap {
    let image = light.image();
    let mut turned = image.clone();
    for y in 0..image.height {
        for x in 0..image.width {
            let from = image.pixel((x + image.width / 4) % image.width, y);
            turned.pixel_mut(x, y).copy_from_slice(from);
        }
    }
    EnvironmentMap::new(turned).unwrap()
}

#[test]
fn a_white_object_vanishes_in_even_light_at_every_exposure() {
    let mut mesh = Mesh::default();
    scenes::add_sphere(&mut mesh, Vec3::new(3.0, 2.0, 1.0), 0.5, 48);
    let white = VertexMaterial {
        albedo: [1.0; 3],
        alpha: 1.0,
        kappa: 0.0,
    };
    let surface = MeshSurface::Vertices(vec![white; mesh.positions.len()]);
    let object = Object::new(mesh, surface, Model::Lambertian);
    let stage = Stage::new(object, scenes::furnace(0.7), 1.0).unwrap();
    let orbit = Orbit {
        frames: 1,
        size: [24, 24],
        elevation: 20.0,
        azimuth: 0.0,
        distance: 4.0,
    };
    let camera = orbit
        .cameras(stage.object().mesh.bounding_radius())
        .remove(0);
    let backdrop = Quality {
        backdrop: true,
        ..quality(1024, 1)
    };
    let seen = picture(&stage, &camera, 0, &backdrop, &|_| true).unwrap();
    // A light sample's weight varies as the cosine does, at most by its square's mean ⅓ over ¼, less 1: with 1024 samples,
    // half of them so drawn, five deviations are 2.5 %. Facets hide a sliver of the horizon.
    for pixel in seen.data.chunks_exact(4) {
        assert_eq!(pixel[3], 1.0);
        assert!((pixel[0] / 1.4 - 1.0).abs() < 0.03, "{pixel:?}");
    }
    let mean: f32 = seen.data.iter().step_by(4).sum::<f32>() / (24.0 * 24.0);
    assert!((mean / 1.4 - 1.0).abs() < 3e-3, "{mean}");
}

#[test]
fn pictures_depend_on_the_seed_and_not_on_the_threads() {
    let scene = scene(Model::Microfacet);
    let stage = Stage::new(truth(&scene), other_light(), 0.0).unwrap();
    let camera = scenes::camera(24);
    let with = |threads: usize, seed: u64, frame: u32| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| picture(&stage, &camera, frame, &quality(32, seed), &|_| true).unwrap())
    };
    let one = with(1, 7, 0);
    assert_eq!(one, with(3, 7, 0));
    assert_ne!(one, with(3, 8, 0));
    assert_ne!(one, with(3, 7, 1));
    assert_eq!(
        picture(&stage, &camera, 0, &quality(32, 7), &|_| false),
        None
    );
}

fn relight(arguments: &[&str]) -> Output {
    let arguments = [&["relight"], arguments].concat();
    program::run(env!("CARGO_BIN_EXE_eclipse-under-test"), &arguments)
}

/// A run's folder, and a map to relight it with.
fn run_folder(folder: &Path) -> (std::path::PathBuf, std::path::PathBuf) {
    let (run, map) = (folder.join("run"), folder.join("map.exr"));
    let capture = perfect::capture();
    output::write(
        &run,
        &capture,
        &perfect::reconstruction(&capture),
        &ReportOptions::default(),
    )
    .unwrap();
    write_exr(&map, other_light().image(), &["R", "G", "B"]).unwrap();
    (run, map)
}

#[test]
fn the_command_renders_orbits_and_the_cameras_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let (run, map) = run_folder(folder.path());
    let short = [
        text(&run),
        "--environment",
        text(&map),
        "--samples",
        "32",
        "--size",
        "32x24",
    ];
    let output = relight(&[&short[..], &["--frames", "3"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).starts_with("wrote 3 pictures to "));
    let relit = run.join("relit");
    let picture = read_exr(&relit.join("002.exr")).unwrap();
    assert_eq!(
        (picture.width, picture.height, picture.channels),
        (32, 24, 4)
    );
    let shown = read_image(&relit.join("002.png"), None).unwrap();
    for (exact, shown) in picture
        .data
        .chunks_exact(4)
        .zip(shown.data.chunks_exact(4))
        .filter(|(exact, _)| exact[3] == 1.0)
    {
        assert!((exact[0].min(1.0) - shown[0]).abs() < 0.01);
    }

    // Fewer pictures take the places of more.
    let output = relight(&[&short[..], &["--frames", "2"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(relit.join("001.png").is_file() && !relit.join("002.png").exists());

    // Through the capture's own cameras the object is where the photographs have it.
    let transforms = perfect::bundled().join("transforms.json");
    let out = folder.path().join("own");
    let arguments = [
        text(&run),
        "--environment",
        text(&map),
        "--samples",
        "2",
        "--camera",
        text(&transforms),
        "--frames",
        "2",
        "--out",
        text(&out),
    ];
    let output = relight(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let capture: Capture = perfect::capture();
    let frame = &capture.frames[capture.frames.len() / 2];
    let picture = read_exr(&out.join("001.exr")).unwrap();
    let differing = picture
        .data
        .chunks_exact(4)
        .zip(&frame.mask.data)
        .filter(|(pixel, mask)| (pixel[3] - **mask).abs() > 0.3)
        .count();
    assert!(differing < frame.mask.data.len() / 200, "{differing}");
}

#[test]
fn what_cannot_be_relit_is_said_and_nothing_is_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let (run, map) = run_folder(folder.path());
    let fails = |arguments: &[&str], code: i32, expected: &str| {
        let output = relight(arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(expected), "{message}");
        assert!(code == 2 || message.lines().count() == 1, "{message}");
    };
    let good = [text(&run), "--environment", text(&map)];
    fails(&[text(&run)], 2, "--environment");
    fails(&[&good[..], &["--size", "800"]].concat(), 2, "800x600");
    fails(
        &[&good[..], &["--exposure", "lots"]].concat(),
        2,
        "not a number",
    );

    let missing = folder.path().join("missing");
    fails(
        &[text(&missing), "--environment", text(&map)],
        3,
        "a folder that `eclipse reconstruct` wrote",
    );
    fails(&[text(&run), "--environment", text(&missing)], 3, "missing");
    fails(
        &[&good[..], &["--camera", text(&missing)]].concat(),
        3,
        "missing",
    );

    let unknown = folder.path().join("unknown.exr");
    let mut bad = Image::filled(4, 2, 3, 1.0);
    bad.pixel_mut(1, 1)[2] = f32::NAN;
    write_exr(&unknown, &bad, &["R", "G", "B"]).unwrap();
    fails(
        &[text(&run), "--environment", text(&unknown)],
        3,
        "unknown.exr: the environment map's pixel in column 1 of row 1 is NaN",
    );

    let bare = folder.path().join("bare");
    fs::create_dir(&bare).unwrap();
    write_glb(&bare.join("mesh.glb"), &boxes(), &GlbSurface::default()).unwrap();
    fails(
        &[text(&bare), "--environment", text(&map)],
        3,
        "has no materials",
    );

    // Photographs with the names of pictures are in the way.
    let taken = folder.path().join("taken");
    fs::create_dir(&taken).unwrap();
    fs::write(taken.join("000.png"), "a photograph").unwrap();
    fails(
        &[&good[..], &["--out", text(&taken)]].concat(),
        1,
        "holds other files: name a new folder with --out",
    );
    assert_eq!(
        fs::read_to_string(taken.join("000.png")).unwrap(),
        "a photograph"
    );
    assert_eq!(fs::read_dir(&taken).unwrap().count(), 1);

    let inside = folder.path().join("inside.json");
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let camera = |size: &str| {
        format!(
            r#"{{"camera_angle_x":0.5,{size}"frames":[{{"file_path":"a","transform_matrix":{pose}}}]}}"#
        )
    };
    fs::write(&inside, camera(r#""w":8,"h":8,"#)).unwrap();
    fails(
        &[&good[..], &["--camera", text(&inside)]].concat(),
        3,
        "within its bounding sphere",
    );
}

#[test]
fn cameras_are_those_of_a_capture_of_any_format() {
    let folder = tempfile::tempdir().unwrap();
    let centre = Vec3::new(0.5, -0.25, 2.0);
    let made = small_capture(centre);
    let [ours, colmap] = ["ours", "colmap"].map(|name| folder.path().join(name));
    eclipse::capture::write(&ours, &made).unwrap();
    colmap_model::write(&colmap, &made, Encoding::Text);
    for (path, name) in [(ours, "003"), (colmap, "images/003")] {
        let cameras = read_cameras(&path, None, false).unwrap();
        assert_eq!(cameras.len(), made.frames.len());
        for ((_, found), frame) in cameras.iter().zip(&made.frames) {
            let mut expected = frame.camera.world_from_camera;
            expected.w_axis += centre.extend(0.0);
            assert!(found.world_from_camera.abs_diff_eq(expected, 1e-4));
            assert_eq!([found.width, found.height], SIZE);
        }
        assert_eq!(frame_names(&path, false).unwrap()[3], name);
        let halved = read_cameras(&path, Some(SIZE.map(|side| side / 2)), false).unwrap();
        assert_eq!(halved[0].1.width, SIZE[0] / 2);
    }
    let error = read_cameras(folder.path(), None, false)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("none of the files that describe a capture"),
        "{error}"
    );
}

#[test]
fn cameras_take_their_size_from_the_file_or_from_who_asks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,9],[0,0,0,1]]";
    let write = |size: &str| {
        let frame = format!(r#"{{"file_path":"a","transform_matrix":{pose}}}"#);
        fs::write(
            &path,
            format!(r#"{{"camera_angle_x":0.5,{size}"frames":[{frame}]}}"#),
        )
        .unwrap();
    };
    write(r#""w":80,"h":60,"#);
    let own = &read_cameras(&path, None, false).unwrap()[0].1;
    let half = &read_cameras(&path, Some([40, 30]), false).unwrap()[0].1;
    assert_eq!(
        [own.width, own.height, half.width, half.height],
        [80, 60, 40, 30]
    );
    // The same place of the picture looks the same way.
    assert!((own.ray(20.0, 10.0).direction - half.ray(10.0, 5.0).direction).length() < 1e-6);
    let error = read_cameras(&path, Some([40, 40]), false)
        .unwrap_err()
        .to_string();
    assert!(error.contains("ask for 40 × 30"), "{error}");

    // What is not rendered at its own size may have any.
    write(r#""w":90000,"h":60000,"#);
    assert_eq!(
        read_cameras(&path, Some([90, 60]), false).unwrap()[0]
            .1
            .width,
        90
    );
    let error = read_cameras(&path, None, false).unwrap_err().to_string();
    assert!(error.contains("at most 8192 pixels a side"), "{error}");

    write("");
    let error = read_cameras(&path, None, false).unwrap_err().to_string();
    assert!(error.contains("`w` is missing"), "{error}");
    assert_eq!(
        read_cameras(&path, Some([40, 40]), false).unwrap()[0]
            .1
            .width,
        40
    );
}
