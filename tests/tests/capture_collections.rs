//! Loads every capture below the folder named by `ECLIPSE_CAPTURES`, where one is named. Real photographs are such a folder.

use std::path::{Path, PathBuf};

use eclipse::capture::{Capture, CaptureError, LoadOptions, mask_overlap};

fn captures(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    if folder.join("transforms.json").is_file() {
        found.push(folder.into());
    }
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if depth > 0 && entry.path().is_dir() {
            captures(&entry.path(), depth - 1, found);
        }
    }
}

#[test]
fn every_capture_of_the_collection_loads() {
    let Some(folder) = std::env::var_os("ECLIPSE_CAPTURES") else {
        eclipse_tests::skipped("ECLIPSE_CAPTURES names no folder of captures");
        return;
    };
    let mut found = Vec::new();
    captures(Path::new(&folder), 3, &mut found);
    found.sort();
    assert!(!found.is_empty(), "no transforms.json below {folder:?}");
    for path in found {
        let start = std::time::Instant::now();
        match Capture::load(&path, &LoadOptions::default()) {
            Ok(capture) => {
                let overlap = capture
                    .frames
                    .iter()
                    .map(|frame| mask_overlap(&capture.mesh, frame));
                println!(
                    "{}: {} frames, {} faces, least overlap {:.3}, {:.2?}",
                    path.display(),
                    capture.frames.len(),
                    capture.mesh.faces.len(),
                    overlap.fold(1.0, f32::min),
                    start.elapsed(),
                );
                let [low, high] = capture.mesh.bounds();
                assert!(
                    (low + high).length() < 1e-4 * (high - low).length(),
                    "{}",
                    path.display()
                );
            }
            // The one kind of camera that collections hold and that is not supported says so.
            Err(error @ CaptureError::CameraModel { .. }) => println!("{error}"),
            Err(error) => panic!("{}: {error}", path.display()),
        }
    }
}
