//! What a diagnosis reads of the folder that a reconstruction left.

use std::{fs, path::Path};

use eclipse::{
    capture::Capture,
    criticism::{Simulation, diagnosis::Drawn, silhouette::Silhouettes, study::Study},
    image_io::write_exr,
    layout,
};
use eclipse_tests::{perfect, small_capture::small_capture};
use glam::Vec3;
use render::image::Image;

/// Writes what a run leaves of `capture`, its renders the photographs.
fn written(folder: &Path, capture: &Capture) {
    for name in [layout::RENDERS, layout::MATERIALS] {
        fs::create_dir(folder.join(name)).unwrap();
    }
    let light = Image::filled(8, 4, 3, 0.5);
    write_exr(&folder.join(layout::ENVIRONMENT), &light, &["R", "G", "B"]).unwrap();
    for (t, frame) in capture.frames.iter().enumerate() {
        let path = |name: &str| folder.join(name).join(layout::numbered(t));
        let (width, height) = (frame.image.width, frame.image.height);
        write_exr(&path(layout::RENDERS), &frame.image, &["R", "G", "B"]).unwrap();
        let materials = Image::filled(width, height, 5, 0.3);
        let channels = &layout::MATERIAL_CHANNELS;
        write_exr(&path(layout::MATERIALS), &materials, channels).unwrap();
    }
}

#[test]
fn images_are_taken_with_three_channels_whatever_they_have() {
    let capture = small_capture(Vec3::ZERO);
    let folder = tempfile::tempdir().unwrap();
    written(folder.path(), &capture);
    let image = &capture.frames[1].image;
    let pixels = image.data.chunks_exact(3);
    let rgba = Image {
        channels: 4,
        data: pixels.flat_map(|p| [p[0], p[1], p[2], 0.5]).collect(),
        ..*image
    };
    let path = folder.path().join(layout::RENDERS).join("001.exr");
    write_exr(&path, &rgba, &["R", "G", "B", "A"]).unwrap();
    let grey = Image::filled(8, 4, 1, 0.25);
    write_exr(&folder.path().join(layout::ENVIRONMENT), &grey, &["Y"]).unwrap();

    let simulation = Simulation::load(folder.path(), &capture).unwrap();
    assert_eq!(simulation.environment, Image::filled(8, 4, 3, 0.25));
    assert_eq!(simulation.renders[1], *image);
    assert!(simulation.lobe.is_some());
}

#[test]
fn renders_of_other_photographs_are_refused() {
    let capture = small_capture(Vec3::ZERO);
    let folder = tempfile::tempdir().unwrap();
    written(folder.path(), &capture);
    let refused = |capture: &Capture| {
        let error = Simulation::load(folder.path(), capture).unwrap_err();
        error.to_string()
    };

    let mut fewer = capture.clone();
    fewer.frames.pop();
    let message = refused(&fewer);
    assert!(
        message.contains("holds 6 renders, but the capture has 5"),
        "{message}"
    );

    let path = folder.path().join(layout::RENDERS).join("004.exr");
    let half = Image::filled(32, 24, 3, 0.5);
    write_exr(&path, &half, &["R", "G", "B"]).unwrap();
    let message = refused(&capture);
    assert!(
        message.contains("004.exr has 32 × 24 pixels, but the photograph 64 × 48"),
        "{message}"
    );

    // Nor are they taken where they come from memory.
    let renders = capture.frames.iter().map(|_| half.clone());
    let simulation = Simulation {
        environment: Image::filled(8, 4, 3, 0.5),
        lobe: None,
        renders: renders.collect(),
        occluders: Vec::new(),
    };
    let error = Study::new(&capture, &simulation, 300, 8, 1).err().unwrap();
    assert!(
        error.to_string().contains("renders are not of the"),
        "{error}"
    );
}

/// The outline of an occluder that a diagnosis found is that of a reconstruction, measured against the truth that the capture has.
#[test]
fn outlines_of_a_reconstruction_are_told_as_its_own() {
    let capture = perfect::capture();
    let mut solved = perfect::reconstruction(&capture);
    let drawn = Silhouettes::reconstructed(&capture, &solved).unwrap();
    assert_eq!(drawn.masks, solved.occluders);
    assert_eq!(drawn.told.by, Drawn::Reconstruction);
    assert_eq!(drawn.told.blocked.len(), capture.frames.len());
    assert!(
        drawn
            .told
            .blocked
            .iter()
            .all(|share| (0.001..0.3).contains(share))
    );
    assert!(drawn.told.score.energy_weighted_error.unwrap() < 1e-3);
    assert!(drawn.told.score.iou.unwrap() > 0.999);
    // Nobody is nobody, however it is written.
    for mask in &mut solved.occluders {
        mask.data.fill(1.0);
    }
    assert!(Silhouettes::reconstructed(&capture, &solved).is_none());
}
