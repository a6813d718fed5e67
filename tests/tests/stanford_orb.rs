//! Scores of Stanford-ORB, against what its published scripts say of the same arrays.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, LoadOptions},
    evaluate::stanford_orb::{Scale, Split, score, views},
    image_io::{linear_to_srgb, write_exr, write_png8},
};
use eclipse_tests::{
    program::{self, stderr, stdout, text},
    small_capture::small_capture,
};
use glam::Vec3;
use render::image::Image;

/// A picture of `side`² pixels and three channels, by integers only, so that any language makes the same.
fn picture(side: usize, value: impl Fn(i64, i64, i64) -> f64) -> Image {
    let mut image = Image::filled(side, side, 3, 0.0);
    for y in 0..side {
        for x in 0..side {
            for c in 0..3 {
                image.pixel_mut(x, y)[c] = value(x as i64, y as i64, c as i64) as f32;
            }
        }
    }
    image
}

fn photograph(view: i64) -> Image {
    picture(1024, |x, y, c| {
        let ramp = (x * (c + 1) + y * (3 - c) + 97 * view) % 2048;
        let noise = (x * 37 + y * 17 + x * y * (c + 3) + 11 * view) % 251;
        let value = ramp as f64 / 1024.0 + noise as f64 / 1000.0;
        if (x / 64 + y / 64) % 7 == 0 {
            5.0 * value
        } else {
            value
        }
    })
}

fn mask(view: i64) -> Image {
    let disc = picture(1024, |x, y, _| {
        let (dx, dy) = (x - 500 - 20 * view, y - 520);
        f64::from(u8::from(dx * dx + dy * dy < 400 * 400))
    });
    Image {
        channels: 1,
        data: disc.data.iter().step_by(3).copied().collect(),
        ..disc
    }
}

fn prediction(view: i64) -> Image {
    picture(512, |x, y, c| {
        let ramp = (2 * x * (c + 1) + 2 * y * (3 - c) + 97 * view) % 2048;
        let noise = (x * 53 + y * 29 + x * y * (c + 1)) % 127;
        if view == 1 && c == 2 {
            return 0.0;
        }
        (0.5 + 0.2 * c as f64) * (ramp as f64 / 1024.0 + noise as f64 / 400.0)
    })
}

/// A scene of two views in its own light, of which the second is listed for another scene as well.
fn scene(root: &Path) {
    for (name, view) in [("cup_scene001", 0), ("cup_scene002", 1)] {
        let folder = root.join(name);
        fs::create_dir_all(folder.join("test")).unwrap();
        fs::create_dir_all(folder.join("test_mask")).unwrap();
        let views = if view == 0 { vec![0, 1] } else { vec![1] };
        for view in views {
            let file = format!("{view:04}");
            let rgb = ["R", "G", "B"];
            write_exr(
                &folder.join(format!("test/{file}.exr")),
                &photograph(view),
                &rgb,
            )
            .unwrap();
            write_png8(&folder.join(format!("test_mask/{file}.png")), &mask(view)).unwrap();
        }
    }
    let test =
        r#"{"camera_angle_x":0.5,"frames":[{"file_path":"test/0000"},{"file_path":"test/0001"}]}"#;
    let novel = r#"{"frames":[{"file_path":"test/0001","scene_name":"cup_scene002","camera_angle_x":0.4}]}"#;
    let own = root.join("cup_scene001");
    fs::write(own.join("transforms_test.json"), test).unwrap();
    fs::write(own.join("transforms_novel.json"), novel).unwrap();
}

fn predict(path: &Path, view: i64) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_exr(path, &prediction(view), &["R", "G", "B"]).unwrap();
}

#[test]
fn scores_are_those_of_the_published_scripts() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (own, predicted) = (
        folder.path().join("cup_scene001"),
        folder.path().join("out"),
    );
    for view in 0..2 {
        predict(&predicted.join(format!("{view:04}.exr")), view);
    }
    // Computed by the benchmark's functions (single precision, OpenCV, kornia) on these arrays, as
    // tests/scripts/stanford_orb_reference.py does it again. Scaled, and as they are; a
    // channel that is black; and a PSNR-L that is grey's.
    let published = [
        (Scale::Best, 0, [2.535_584_4, 22.209_796, 0.881_349_47]),
        (Scale::Best, 1, [0.414_340_8, 10.637_512_5, 0.759_434_4]),
        (Scale::None, 0, [1.874_546_6, 20.781_901, 0.813_335_4]),
        (Scale::None, 1, [-0.070_169_7, 10.637_512_5, 0.705_700_4]),
    ];
    for scale in [Scale::Best, Scale::None] {
        let score = score(&predicted, &own, Split::Test, scale).unwrap();
        assert_eq!(score.views.len(), 2);
        for (_, view, expected) in published.iter().filter(|(s, ..)| *s == scale) {
            let found = score.views[*view].1;
            for (found, expected) in [found.psnr_h, found.psnr_l, found.ssim]
                .iter()
                .zip(expected)
            {
                assert!(
                    (found - expected).abs() < 1e-4,
                    "{scale:?} {view}: {found} {expected}"
                );
            }
        }
        let mean = 0.5 * (score.views[0].1.psnr_l + score.views[1].1.psnr_l);
        assert!((score.mean.psnr_l - mean).abs() < 1e-9);
    }

    // Eight bits are decoded before anything else.
    let shown = prediction(0);
    let data = shown.data.iter().map(|&v| linear_to_srgb(v.min(1.0)));
    let shown = Image {
        data: data.collect(),
        ..shown
    };
    fs::remove_file(predicted.join("0000.exr")).unwrap();
    write_png8(&predicted.join("0000.png"), &shown).unwrap();
    let found = score(&predicted, &own, Split::Test, Scale::Best)
        .unwrap()
        .views[0]
        .1;
    for (found, expected) in [
        (found.psnr_h, 2.707_483_3),
        (found.psnr_l, 21.137_609_9),
        (found.ssim, 0.889_026_0),
    ] {
        // The scripts sum a channel one pixel after another in single precision, which costs 0.003 dB here: in double precision
        // they say 2.7043 as well.
        assert!((found - expected).abs() < 5e-3, "{found} {expected}");
    }
}

#[test]
fn views_in_other_light_lie_beside_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let own = folder.path().join("cup_scene001");
    let listed = views(&own, Split::Novel).unwrap();
    assert_eq!(listed[0].name, "cup_scene002/0001");
    assert!(listed[0].image.is_file() && listed[0].mask.is_file());
    let predicted = folder.path().join("out");
    predict(&predicted.join("cup_scene002/0001.exr"), 1);
    let arguments = [
        "evaluate",
        text(&predicted),
        "--stanford-orb",
        text(&own),
        "--split",
        "novel",
    ];
    let program = env!("CARGO_BIN_EXE_eclipse-under-test");
    let output = program::run(program, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("mean") && stdout(&output).contains("10.638"));
    let json = program::run(program, &[&arguments[..], &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_str(&stdout(&json)).unwrap();
    assert!((json["mean"]["ssim"].as_f64().unwrap() - 0.7594).abs() < 1e-3);
}

#[test]
fn a_scene_cannot_name_what_lies_outside_the_benchmark() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("benchmark/cup_scene001");
    fs::create_dir_all(own.join("test")).unwrap();
    let listed = |split: Split, frame: serde_json::Value| {
        let mut frame = frame;
        frame["camera_angle_x"] = serde_json::json!(0.4);
        let path = own.join(format!("transforms_{}.json", split.name()));
        fs::write(path, serde_json::json!({ "frames": [frame] }).to_string()).unwrap();
        views(&own, split)
    };
    let refused = |split, frame, field: &str| {
        let error = listed(split, frame).unwrap_err().to_string();
        let expected = format!("`{field}` is ");
        assert!(
            error.contains(&expected) && error.contains("take the benchmark's own file"),
            "{error}"
        );
    };
    for name in [
        "../test/0001",
        "/etc/0001",
        "test/../../../0001",
        "",
        ".",
        "..\\0001",
    ] {
        refused(
            Split::Test,
            serde_json::json!({ "file_path": name }),
            "file_path",
        );
    }
    for scene in ["..", "../elsewhere", "/etc", "a/../..", ""] {
        let frame = serde_json::json!({ "file_path": "test/0001", "scene_name": scene });
        refused(Split::Novel, frame, "scene_name");
    }
    let frame = serde_json::json!({ "file_path": "./test/0001", "scene_name": "cup_scene002" });
    let found = listed(Split::Novel, frame).unwrap();
    assert_eq!(found[0].name, "cup_scene002/0001");
    #[cfg(unix)]
    {
        let secret = folder.path().join("secret.exr");
        fs::write(&secret, "").unwrap();
        std::os::unix::fs::symlink(&secret, own.join("test/0001.exr")).unwrap();
        let frame = serde_json::json!({ "file_path": "test/0001" });
        refused(Split::Test, frame, "file_path");
    }
}

#[test]
fn what_cannot_be_scored_is_said() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (own, predicted) = (
        folder.path().join("cup_scene001"),
        folder.path().join("out"),
    );
    let fails = |split: Split, expected: &str| {
        let error = score(&predicted, &own, split, Scale::Best).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    };
    fails(Split::Train, "transforms_train.json");
    fails(Split::Test, "the prediction of view \"0000\" is missing");
    let path = predicted.join("0000.exr");
    fs::create_dir_all(&predicted).unwrap();
    let rgb = ["R", "G", "B"];
    write_exr(&path, &Image::filled(256, 512, 3, 0.5), &rgb).unwrap();
    fails(Split::Test, "is 256 × 512; expected 512 × 512");
    let mut bad = prediction(0);
    bad.pixel_mut(3, 2)[1] = -1.0;
    write_exr(&path, &bad, &rgb).unwrap();
    fails(Split::Test, "the pixel in column 3 of row 2 is -1");
    predict(&path, 0);
    fs::remove_file(own.join("test_mask/0000.png")).unwrap();
    fails(Split::Test, "the mask of view \"0000\" is missing");
    fs::remove_file(own.join("test/0000.exr")).unwrap();
    fails(Split::Test, "name a scene of blender_HDR");

    let program = env!("CARGO_BIN_EXE_eclipse-under-test");
    let both = ["evaluate", "out", "--split", "novel", "--truth", "t"];
    assert_eq!(program::run(program, &both).status.code(), Some(2));
}

/// A scene with its photographs where the benchmark has them, which `encode` writes under this name without extension.
fn scene_of(orb: &Path, capture: &Capture, encode: impl Fn(&Path, &Image)) {
    let plain = orb.with_extension("plain");
    eclipse::capture::write(&plain, capture).unwrap();
    fs::create_dir_all(orb.join("train")).unwrap();
    fs::create_dir(orb.join("train_mask")).unwrap();
    fs::copy(plain.join("mesh.glb"), orb.join("mesh.glb")).unwrap();
    for frame in &capture.frames {
        let name = &frame.name;
        encode(&orb.join(format!("train/{name}")), &frame.image);
        write_png8(&orb.join(format!("train_mask/{name}.png")), &frame.mask).unwrap();
    }
    let transforms = fs::read_to_string(plain.join("transforms.json")).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&transforms).unwrap();
    for frame in json["frames"].as_array_mut().unwrap() {
        let name = frame["file_path"].as_str().unwrap().replace(".exr", "");
        frame["file_path"] = format!("train/{name}").into();
    }
    fs::write(orb.join("transforms_train.json"), json.to_string()).unwrap();
    fs::write(orb.join("transforms_test.json"), json.to_string()).unwrap();
}

#[test]
fn photographs_of_eight_bits_are_those_of_a_scene_as_well() {
    // `blender_LDR`: sRGB, without alpha, whatever lies beside them.
    let folder = tempfile::tempdir().unwrap();
    let orb = folder.path().join("cup_scene001");
    let capture = small_capture(Vec3::new(0.2, -0.1, 0.4));
    scene_of(&orb, &capture, |path, image| {
        let mut shown = image.clone();
        shown
            .data
            .iter_mut()
            .for_each(|value| *value = linear_to_srgb(value.min(1.0)));
        write_png8(&path.with_extension("png"), &shown).unwrap();
    });
    let options = LoadOptions::default();
    let source = Capture::describe(&orb, &options).unwrap();
    assert_eq!(source.format, "Stanford-ORB");
    let loaded = Capture::load(&orb, &options).unwrap();
    assert_eq!(loaded.frames.len(), capture.frames.len());
    for (loaded, made) in loaded.frames.iter().zip(&capture.frames) {
        assert_eq!(loaded.name, made.name);
        let pairs = loaded.image.data.iter().zip(&made.image.data);
        let furthest = pairs.map(|(a, b)| (a - b.min(1.0)).abs());
        // The curve is steepest at 1, where half a step of 1/255 is 0.0045 of light.
        assert!(furthest.fold(0.0, f32::max) < 0.0046);
        let pairs = loaded.mask.data.iter().zip(&made.mask.data);
        let furthest = pairs.map(|(a, b)| (a - b).abs());
        assert!(furthest.fold(0.0, f32::max) <= 0.5 / 255.0 + 1e-6);
    }
    // Without its mask a photograph has no silhouette.
    fs::remove_file(orb.join("train_mask/003.png")).unwrap();
    let error = Capture::load(&orb, &options).unwrap_err().to_string();
    assert!(error.contains("train_mask/003.png"), "{error}");
}

#[test]
fn a_scene_of_the_benchmark_is_a_capture() {
    let folder = tempfile::tempdir().unwrap();
    let orb = folder.path().join("orb");
    let capture = small_capture(Vec3::new(0.2, -0.1, 0.4));
    scene_of(&orb, &capture, |path, image| {
        write_exr(&path.with_extension("exr"), image, &["R", "G", "B"]).unwrap();
    });

    let options = LoadOptions::default();
    let source = Capture::describe(&orb, &options).unwrap();
    assert_eq!(
        (source.format, source.left_out),
        ("Stanford-ORB", capture.frames.len())
    );
    let loaded = Capture::load(&orb, &options).unwrap();
    for (loaded, made) in loaded.frames.iter().zip(&capture.frames) {
        assert_eq!(loaded.image, made.image);
        let pairs = loaded.mask.data.iter().zip(&made.mask.data);
        assert!(
            pairs
                .into_iter()
                .all(|(a, b)| (a - b).abs() <= 0.5 / 255.0 + 1e-6)
        );
    }
    // Without its mask a photograph has no silhouette.
    fs::remove_file(orb.join("train_mask/003.png")).unwrap();
    let error = Capture::load(&orb, &options).unwrap_err().to_string();
    assert!(error.contains("train_mask/003.png"), "{error}");
}
