//! The files that fuzzing begins with are good ones: from bad ones it would not get far.

use std::{
    fs,
    path::{Path, PathBuf},
};

use eclipse::{
    capture::{
        formats::colmap::{Encoding, parse_model, parse_points},
        parse_transforms,
    },
    checkpoint::decode,
    cli::parse_labels,
    evaluate::{parse_metrics, parse_specular},
    image_io::decode_image,
    mesh_io::{parse_gltf, parse_obj, parse_ply, parse_surfaced_glb},
    settings::Settings,
};

/// The seeds of a target, at least one.
fn seeds(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds");
    let mut seeds: Vec<_> = fs::read_dir(folder.join(target))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.clone(), fs::read(path).unwrap()))
        .collect();
    seeds.sort();
    assert!(!seeds.is_empty(), "no seeds for {target}");
    seeds
}

fn all_good<T, E: std::fmt::Display>(target: &str, read: impl Fn(&Path, &[u8]) -> Result<T, E>) {
    for (path, bytes) in seeds(target) {
        if let Err(error) = read(&path, &bytes) {
            panic!("{}: {error}", path.display());
        }
    }
}

#[test]
fn every_target_has_seeds() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/fuzz_targets");
    let mut targets = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        seeds(path.file_stem().unwrap().to_str().unwrap());
        targets += 1;
    }
    assert!(targets >= 13);
}

#[test]
fn meshes_and_images_are_good() {
    // As the target has it: a buffer in another file is the file itself.
    all_good("mesh_glb", |_, bytes| {
        parse_gltf(bytes, &mut |_, _| Ok(bytes.to_vec()))
    });
    all_good("mesh_obj", |_, bytes| parse_obj(bytes));
    all_good("mesh_ply", |_, bytes| parse_ply(bytes));
    all_good("surface", |_, bytes| parse_surfaced_glb(bytes));
    all_good("image", |path, bytes| decode_image(bytes, path, None));
}

#[test]
fn what_a_run_says_of_itself_is_good() {
    all_good("settings", |_, bytes| {
        serde_json::from_slice::<Settings>(bytes)
    });
    all_good("metrics", |path, bytes| parse_metrics(bytes, path));
    all_good("truth", |path, bytes| parse_specular(bytes, path));
    all_good("labels", |path, bytes| parse_labels(bytes, path));
}

#[test]
fn descriptions_of_captures_are_good() {
    all_good("transforms", |path, bytes| parse_transforms(bytes, path));
    for (path, bytes) in seeds("colmap") {
        let (cut, bytes) = bytes.split_first_chunk().unwrap();
        let cut = usize::from(u16::from_le_bytes(*cut));
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let encoding = if name.contains("text") {
            Encoding::Text
        } else {
            Encoding::Binary
        };
        let error = if name.starts_with("points") {
            parse_points(bytes, encoding, &path).err()
        } else {
            let (cameras, images) = bytes.split_at(cut);
            parse_model([cameras, images], encoding, [&path, &path]).err()
        };
        assert!(error.is_none(), "{name}: {}", error.unwrap());
    }
}

#[test]
fn checkpoints_are_good_behind_a_header() {
    for (path, payload) in seeds("checkpoint") {
        let header = [
            &b"ECLIPSE\0"[..],
            &1u32.to_le_bytes(),
            &(payload.len() as u64).to_le_bytes(),
            &crc64(&payload).to_le_bytes(),
        ];
        let whole = [&header.concat()[..], &payload].concat();
        let checkpoint = decode(&whole).unwrap_or_else(|error| panic!("{path:?}: {error}"));
        assert_eq!(checkpoint.arrays.len(), 3);
    }
}

/// CRC-64/XZ by its definition, bit by bit.
fn crc64(bytes: &[u8]) -> u64 {
    let byte = |crc: u64, byte: &u8| {
        (0..8).fold(crc ^ u64::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xc96c_5795_d787_0f42 & (crc & 1).wrapping_neg())
        })
    };
    !bytes.iter().fold(!0, byte)
}
