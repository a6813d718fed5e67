//! Outputs written, then scored against a truth, as a user would.

use std::{collections::BTreeMap, fs, path::Path, sync::LazyLock};

use eclipse::{
    checkpoint,
    evaluate::{self, Evaluation, evaluate},
    image_io::{ExrOptions, read_exr, read_exr_file, write_exr, write_exr_with},
    layout,
    mesh_io::MeshSurface,
    output,
    reconstruction::{Metrics, Network, Reconstruction},
    relight::Object,
    report::ReportOptions,
    settings::Settings,
};
use eclipse_tests::{perfect, small_capture::boxes};
use glam::{Mat3, Vec2};
use render::{
    convention::{Convention, convert},
    image::Image,
    lat_long::LatLong,
};
use tempfile::TempDir;

fn written(change: impl FnOnce(&mut Reconstruction)) -> TempDir {
    let capture = perfect::capture();
    let mut reconstruction = perfect::reconstruction(&capture);
    change(&mut reconstruction);
    let folder = tempfile::tempdir().unwrap();
    let options = ReportOptions::new("eclipse reconstruct tests/captures/potatoes");
    output::write(folder.path(), &capture, &reconstruction, &options).unwrap();
    folder
}

/// The truth as a result, written once for all tests that only read it.
fn perfect_result() -> &'static Path {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| written(|_| ()));
    FOLDER.path()
}

fn score(folder: &Path) -> Evaluation {
    evaluate(folder, &perfect::bundled().join("truth")).unwrap()
}

#[test]
fn the_truth_scores_perfectly() {
    let folder = perfect_result();
    let score = score(folder);
    assert!(score.environment.texels.rmse.unwrap() < 1e-6);
    assert!(score.environment.solid_angle.relative_rmse_aligned.unwrap() < 1e-6);
    // Materials are stored as half floats: 11 bits are 70 dB.
    assert!(score.albedo.psnr_aligned.unwrap() > 65.0);
    assert!(score.occluders.energy_weighted_error.unwrap() < 1e-6);
    assert_eq!(score.occluders.iou, Some(1.0));
    assert_eq!(score.photometric.psnr, Some(41.25));
    // The bundled capture is Lambertian: its α and κ mean nothing.
    assert_eq!(score.materials.alpha_rmse, None);
}

#[test]
fn the_free_scale_between_light_and_albedo_costs_nothing() {
    let scale = [2.0f32, 0.5, 1.25];
    let folder = written(|solved| {
        let light = solved.environment.data.chunks_exact_mut(3);
        light.for_each(|texel| (0..3).for_each(|c| texel[c] *= scale[c]));
        for image in &mut solved.materials {
            let pixels = image.data.chunks_exact_mut(5);
            pixels.for_each(|pixel| (0..3).for_each(|c| pixel[c] /= scale[c]));
        }
    });
    let score = score(folder.path());
    assert!(score.environment.texels.relative_rmse_aligned.unwrap() < 1e-6);
    assert!(score.environment.texels.rmse.unwrap() > 0.1);
    assert!(score.albedo.psnr_aligned.unwrap() > 65.0);
}

#[test]
fn a_run_without_occluders_scores_one_and_zero() {
    let folder = written(|solved| solved.occluders.clear());
    let score = score(folder.path()).occluders;
    assert!((score.energy_weighted_error.unwrap() - 1.0).abs() < 1e-6);
    assert_eq!(score.iou, Some(0.0));
}

#[test]
fn the_json_has_the_documented_shape() {
    let folder = perfect_result();
    let json = serde_json::to_value(score(folder)).unwrap();
    let keys = |pointer: &str| -> Vec<String> {
        let object = json
            .pointer(pointer)
            .and_then(|value| value.as_object())
            .unwrap();
        object.keys().cloned().collect()
    };
    assert_eq!(
        keys(""),
        [
            "albedo",
            "environment",
            "materials",
            "occluders",
            "photometric"
        ]
    );
    let four = [
        "relative_mse_aligned",
        "relative_rmse_aligned",
        "rmse",
        "rmse_aligned",
    ];
    assert_eq!(keys("/environment/solid_angle"), four);
    assert_eq!(keys("/environment"), [&four[..], &["solid_angle"]].concat());
    assert_eq!(keys("/albedo"), ["psnr_aligned"]);
    assert_eq!(keys("/materials"), ["alpha_rmse", "kappa_rmse"]);
    assert_eq!(keys("/occluders"), ["energy_weighted_error", "iou"]);
    assert_eq!(keys("/photometric"), ["psnr", "psnr_held_out"]);
    assert!(json["materials"]["alpha_rmse"].is_null());
}

#[test]
fn everything_is_written_and_can_be_read_back() {
    let folder = perfect_result();
    for name in [
        "environment.exr",
        "mesh.glb",
        "materials.bin",
        "metrics.json",
        "settings.json",
        "report.html",
    ] {
        assert!(folder.join(name).is_file(), "{name}");
    }
    for name in ["occluders", "materials", "renders"] {
        assert_eq!(
            fs::read_dir(folder.join(name)).unwrap().count(),
            24,
            "{name}"
        );
    }
    let map = read_exr_file(&folder.join(layout::ENVIRONMENT)).unwrap();
    assert_eq!(map.metadata[layout::CONVENTION], "blender");
    let materials = read_exr_file(&folder.join("materials/000.exr")).unwrap();
    assert!(materials.select(&layout::MATERIAL_CHANNELS).is_some());
    let json = |name: &str| fs::read(folder.join(name)).unwrap();
    let settings: Settings = serde_json::from_slice(&json(layout::SETTINGS)).unwrap();
    assert_eq!(
        settings,
        Settings {
            lambertian: true,
            threads: 2,
            ..Settings::default()
        }
    );
    let metrics: Metrics = serde_json::from_slice(&json(layout::METRICS)).unwrap();
    assert_eq!(metrics.photometric.psnr, Some(41.25));
}

#[test]
fn the_written_mesh_is_where_the_captures_mesh_is() {
    let folder = perfect_result();
    let read = |path: &Path| eclipse::mesh_io::read_mesh(path).unwrap();
    let (ours, theirs) = (
        read(&folder.join(layout::MESH)),
        read(&perfect::bundled().join("mesh.glb")),
    );
    assert_eq!(ours.faces.len(), theirs.faces.len());
    let pairs = ours.bounds().into_iter().zip(theirs.bounds());
    pairs.for_each(|(ours, theirs)| assert!((ours - theirs).length() < 1e-5, "{ours} {theirs}"));
}

#[test]
fn materials_go_to_textures_where_the_mesh_has_a_place_for_them() {
    // Eighteen sides of four corners each, in cells of a grid, all in one cell, or without coordinates.
    let glb = |cells: Option<usize>| {
        let mut capture = perfect::capture();
        capture.mesh = boxes();
        let place = |vertex: usize, cells: usize| {
            let (side, corner) = (vertex / 4 % cells, vertex % 4);
            let cell = Vec2::new((side % 5) as f32, (side / 5) as f32);
            let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
            0.2 * (cell + 0.1 + 0.8 * corners[corner])
        };
        let vertices = 0..capture.mesh.positions.len();
        let uvs = cells.map(|cells| vertices.map(|v| place(v, cells)).collect());
        capture.mesh.uvs = uvs.unwrap_or_default();
        let folder = tempfile::tempdir().unwrap();
        let solved = perfect::reconstruction(&capture);
        output::write(folder.path(), &capture, &solved, &ReportOptions::default()).unwrap();
        let path = folder.path().join(layout::MESH);
        // Wherever they are, they can be read back.
        let object = Object::read(folder.path()).unwrap();
        let found = match &object.surface {
            MeshSurface::Vertices(materials) => materials[0].albedo,
            MeshSurface::Maps(maps) => maps.at(object.mesh.uvs[0]).albedo,
        };
        assert!((found[0] - 0.5).abs() < 0.01, "{found:?}");
        String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned()
    };
    let unwrapped = glb(Some(18));
    assert!(unwrapped.contains("baseColorTexture") && !unwrapped.contains("COLOR_0"));
    for cells in [None, Some(1), Some(9)] {
        let at_vertices = glb(cells);
        assert!(at_vertices.contains("COLOR_0"), "{cells:?}");
        assert!(!at_vertices.contains("baseColorTexture"), "{cells:?}");
    }
}

#[test]
fn images_of_an_earlier_longer_run_do_not_linger() {
    let folder = written(|_| ());
    let capture = perfect::capture();
    let mut second = perfect::reconstruction(&capture);
    second.occluders.clear();
    let renders = folder.path().join(layout::RENDERS);
    fs::write(renders.join("024.exr"), "stale").unwrap();
    fs::write(renders.join("mine.exr"), "the user's").unwrap();
    output::write(folder.path(), &capture, &second, &ReportOptions::default()).unwrap();
    assert_eq!(
        fs::read_dir(folder.path().join(layout::OCCLUDERS))
            .unwrap()
            .count(),
        0
    );
    assert!(!renders.join("024.exr").exists());
    assert!(renders.join("mine.exr").exists());
}

#[test]
fn a_report_means_a_whole_result() {
    let folder = written(|_| ());
    let report = folder.path().join(layout::REPORT);
    assert!(report.is_file());
    let capture = perfect::capture();
    let again = || {
        let solved = perfect::reconstruction(&capture);
        output::write(folder.path(), &capture, &solved, &ReportOptions::default())
    };
    // Nothing of an earlier result has changed yet: its report stays.
    let light = folder.path().join(layout::ENVIRONMENT);
    fs::remove_file(&light).unwrap();
    fs::create_dir_all(light.join("in the way")).unwrap();
    assert!(again().is_err() && report.is_file());
    // Half of it has.
    fs::remove_dir_all(&light).unwrap();
    let metrics = folder.path().join(layout::METRICS);
    fs::remove_file(&metrics).unwrap();
    fs::create_dir_all(metrics.join("in the way")).unwrap();
    assert!(again().is_err() && !report.exists());
    fs::remove_dir_all(&metrics).unwrap();
    again().unwrap();
    assert!(report.is_file());
}

#[test]
fn a_network_of_an_earlier_run_does_not_linger() {
    let network = |extension: &str| Network {
        extension: extension.to_owned(),
        bytes: vec![1, 2, 3],
    };
    let folder = written(|solved| solved.network = Some(network("safetensors")));
    let path = folder.path().join("materials.safetensors");
    assert!(path.is_file());
    let capture = perfect::capture();
    let mut second = perfect::reconstruction(&capture);
    second.network = None;
    output::write(folder.path(), &capture, &second, &ReportOptions::default()).unwrap();
    assert!(!path.exists() && folder.path().join("materials").is_dir());
}

#[test]
fn a_truth_is_read_alike_whatever_channels_it_is_stored_with() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("truth");
    fs::create_dir(&folder).unwrap();
    let put = |name: &str, channels: &[&str], values: &[f32]| {
        let texels: Vec<f32> = (0..8)
            .flat_map(|t| values.iter().map(move |v| v * (1 + t) as f32))
            .collect();
        let image = Image {
            width: 4,
            height: 2,
            channels: channels.len(),
            data: texels,
        };
        write_exr(&folder.join(name), &image, channels).unwrap();
    };
    let colours: [(&[&str], &[f32]); 4] = [
        (&["R", "G", "B"], &[0.1; 3]),
        (&["R", "G", "B", "A"], &[0.1, 0.1, 0.1, 1.0]),
        (&["Y"], &[0.1]),
        (&["Y", "A"], &[0.1, 1.0]),
    ];
    let expected: Vec<f32> = (0..8).map(|t| 0.1 * (1 + t) as f32).collect();
    for (channels, values) in colours {
        for name in ["environment.exr", "occluders.exr", "albedo_000.exr"] {
            put(name, channels, values);
        }
        let truth = evaluate::truth(&folder).unwrap();
        let albedo = &truth.albedo[0];
        for image in [truth.environment.as_ref().unwrap(), &albedo.albedo] {
            assert_eq!(image.channels, 3, "{channels:?}");
            let texels = image.data.chunks_exact(3).map(|texel| texel[2]);
            assert_eq!(texels.collect::<Vec<_>>(), expected, "{channels:?}");
        }
        let masks = truth.occluders.unwrap();
        assert_eq!((masks.len(), masks[0].channels), (1, 1), "{channels:?}");
        assert_eq!(masks[0].data, expected, "{channels:?}");
        assert_eq!(albedo.object, [true; 8], "{channels:?}");
    }
}

#[test]
fn maps_of_light_are_read_in_the_convention_that_they_name() {
    let folder = written(|_| ());
    let path = folder.path().join(layout::ENVIRONMENT);
    let own = read_exr(&path).unwrap();
    let grid = LatLong::new(own.height, own.width);
    let (ours, theirs) = (Convention::Blender, Convention::OpenExr);
    let turned = convert(&own, ours, theirs, grid, Mat3::IDENTITY);
    let named = |name: &str| ExrOptions {
        metadata: BTreeMap::from([(layout::CONVENTION.to_owned(), name.to_owned())]),
        ..ExrOptions::default()
    };
    let rgb = ["R", "G", "B"];
    write_exr_with(&path, &turned, &rgb, &named(theirs.name())).unwrap();
    let read = score(folder.path()).environment.texels;
    assert!(read.relative_rmse_aligned.unwrap() < 1e-3, "{read:?}");
    // The same pixels without their name are another light.
    write_exr(&path, &turned, &rgb).unwrap();
    let read = score(folder.path()).environment.texels;
    assert!(read.relative_rmse_aligned.unwrap() > 0.1, "{read:?}");

    // A truth as well.
    let truth = tempfile::tempdir().unwrap();
    let path = truth.path().join("environment.exr");
    write_exr_with(&path, &turned, &rgb, &named(theirs.name())).unwrap();
    let read = evaluate::truth(truth.path()).unwrap().environment.unwrap();
    let most = own.data.iter().copied().fold(0.0, f32::max);
    for (read, own) in read.data.iter().zip(&own.data) {
        assert!((read - own).abs() < 1e-3 * most, "{read} {own}");
    }
    write_exr_with(&path, &turned, &rgb, &named("fisheye")).unwrap();
    let error = evaluate::truth(truth.path()).unwrap_err().to_string();
    assert!(
        error.contains("environment.exr") && error.contains("fisheye"),
        "{error}"
    );
}

#[test]
fn an_albedo_is_cut_out_by_the_photograph_of_its_own_frame() {
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("truth");
    fs::create_dir(&truth).unwrap();
    // The first is kept for validation, the second is not there, the others are named without an extension.
    let frames: Vec<_> = ["a", "b.exr", "c", "d"]
        .map(|name| serde_json::json!({ "file_path": name }))
        .into();
    let transforms = serde_json::json!({ "frames": frames, "val_filenames": ["a"] });
    let path = folder.path().join("transforms.json");
    fs::write(path, transforms.to_string()).unwrap();
    // Each photograph shows the object in the pixel of its own place.
    for (index, name) in ["a", "c", "d"].into_iter().enumerate() {
        let mut photograph = Image::filled(4, 1, 4, 0.0);
        photograph.pixel_mut(index, 0)[3] = 1.0;
        let path = folder.path().join(format!("{name}.exr"));
        write_exr(&path, &photograph, &["R", "G", "B", "A"]).unwrap();
    }
    for index in 0..3 {
        let path = truth.join(format!("albedo_{}", layout::numbered(index)));
        write_exr(&path, &Image::filled(4, 1, 3, 0.5), &["R", "G", "B"]).unwrap();
    }
    let objects: Vec<_> = evaluate::truth(&truth)
        .unwrap()
        .albedo
        .into_iter()
        .map(|albedo| albedo.object)
        .collect();
    assert_eq!(
        objects,
        [
            [true; 4],
            [false, true, false, false],
            [false, false, true, false],
        ]
    );
}

#[test]
fn a_capture_stands_for_the_truth_in_it() {
    let folder = written(|_| ());
    let of_capture = evaluate(folder.path(), &perfect::bundled()).unwrap();
    let of_truth = evaluate(folder.path(), &perfect::bundled().join("truth")).unwrap();
    assert_eq!(of_capture, of_truth);
    // One without a truth still is none.
    let capture = tempfile::tempdir().unwrap();
    fs::create_dir(capture.path().join("truth")).unwrap();
    let error = evaluate(folder.path(), capture.path()).unwrap_err();
    assert!(error.to_string().contains("holds no truth"), "{error}");
}

#[test]
fn what_is_missing_is_named() {
    let truth = perfect::bundled().join("truth");
    let empty = tempfile::tempdir().unwrap();
    let error = evaluate(empty.path(), &truth).unwrap_err().to_string();
    assert!(
        error.contains("environment.exr") && error.contains("check that it exists"),
        "{error}"
    );

    let folder = written(|_| ());
    let error = evaluate(folder.path(), empty.path())
        .unwrap_err()
        .to_string();
    assert!(error.contains("holds no truth"), "{error}");

    fs::remove_file(folder.path().join("materials/007.exr")).unwrap();
    let error = evaluate(folder.path(), &truth).unwrap_err().to_string();
    assert!(
        error.starts_with("23 material images were reconstructed but the truth has 24"),
        "{error}"
    );

    fs::write(folder.path().join(layout::METRICS), "{").unwrap();
    let error = evaluate(folder.path(), &truth).unwrap_err().to_string();
    assert!(error.contains("metrics.json is not as expected"), "{error}");
}

#[test]
fn a_file_in_the_way_of_the_folder_is_reported_before_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("out");
    fs::write(&file, "").unwrap();
    let error = output::prepare(&file.join("run")).unwrap_err().to_string();
    assert!(
        error.contains("cannot write") && error.contains("--out"),
        "{error}"
    );
}

#[test]
fn a_capture_has_one_fingerprint_that_every_pixel_changes() {
    let mut capture = perfect::capture();
    let fingerprint = checkpoint::fingerprint(&capture);
    assert_eq!(fingerprint, checkpoint::fingerprint(&perfect::capture()));
    capture.frames[3].image.data[777] += 1e-6;
    assert_ne!(fingerprint, checkpoint::fingerprint(&capture));
    let mut capture = perfect::capture();
    capture.mesh.normals[5] = -capture.mesh.normals[5];
    assert_ne!(fingerprint, checkpoint::fingerprint(&capture));
}
