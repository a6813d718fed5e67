//! Any bytes as the files of a COLMAP model, binary and text. The first two bytes say where to cut cameras from images.

#![no_main]

use std::path::Path;

use eclipse::capture::formats::colmap::{Encoding, parse_model, parse_points};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((cut, bytes)) = bytes.split_first_chunk() else {
        return;
    };
    let cut = usize::from(u16::from_le_bytes(*cut)).min(bytes.len());
    let (cameras, images) = bytes.split_at(cut);
    let path = Path::new("model");
    for encoding in [Encoding::Binary, Encoding::Text] {
        let _ = parse_model([cameras, images], encoding, [path, path]);
        let _ = parse_points(bytes, encoding, path);
    }
});
