//! Checkpoints: bit for bit, safe against damage, never half-written.

use std::{collections::BTreeMap, fs};

use eclipse::{
    checkpoint::{Array, Checkpoint, CheckpointError, decode, encode, load, save},
    settings::{OccluderPrior, Preset, Settings},
};
use proptest::{collection::vec, prelude::*};

fn checkpoint() -> Checkpoint {
    let arrays = [
        (
            "environment",
            Array::F32(vec![1.0, -0.0, f32::MIN_POSITIVE, 1e-45]),
        ),
        ("moment", Array::F64(vec![0.1, f64::EPSILON])),
        ("counter", Array::U64(vec![u64::MAX, 7])),
    ];
    Checkpoint {
        settings: Settings::default(),
        capture: 0x0123_4567_89ab_cdef,
        iteration: 42,
        seconds: 12.5,
        arrays: arrays
            .into_iter()
            .map(|(name, array)| (name.to_owned(), array))
            .collect(),
    }
}

fn any_array() -> impl Strategy<Value = Array> {
    prop_oneof![
        vec(any::<u32>(), 0..40)
            .prop_map(|bits| Array::F32(bits.into_iter().map(f32::from_bits).collect())),
        vec(any::<u64>(), 0..40)
            .prop_map(|bits| Array::F64(bits.into_iter().map(f64::from_bits).collect())),
        vec(any::<u64>(), 0..40).prop_map(Array::U64),
    ]
}

prop_compose! {
    fn any_checkpoint()(
        seed: u64,
        memory: u64,
        time_limit in proptest::option::of(0.001..1e9f64),
        paper: bool,
        free: bool,
        capture: u64,
        iteration: u64,
        seconds in 0.0..1e9f64,
        arrays in proptest::collection::btree_map("[a-z/ÄÖ0-9]{0,12}", any_array(), 0..6),
    ) -> Checkpoint {
        let settings = Settings {
            seed,
            memory,
            time_limit,
            preset: if paper { Preset::Paper } else { Preset::Fast },
            occluder_prior: if free { OccluderPrior::None } else { OccluderPrior::Operator },
            ..Settings::default()
        };
        Checkpoint { settings, capture, iteration, seconds, arrays }
    }
}

proptest! {
    #[test]
    fn what_is_read_is_what_was_written_bit_for_bit(checkpoint in any_checkpoint()) {
        let bytes = encode(&checkpoint);
        let read = decode(&bytes).unwrap();
        // NaNs are not equal to themselves; their bytes are.
        prop_assert_eq!(encode(&read), bytes);
        prop_assert_eq!(read.settings, checkpoint.settings);
        prop_assert_eq!(read.seconds.to_bits(), checkpoint.seconds.to_bits());
    }

    #[test]
    fn any_changed_byte_is_noticed(position: prop::sample::Index, flip in 1u8..) {
        let mut bytes = encode(&checkpoint());
        let position = position.index(bytes.len());
        bytes[position] ^= flip;
        prop_assert!(decode(&bytes).is_err());
    }

    #[test]
    fn any_truncation_is_noticed(length: prop::sample::Index) {
        let bytes = encode(&checkpoint());
        prop_assert!(decode(&bytes[..length.index(bytes.len())]).is_err());
    }

    #[test]
    fn hostile_lengths_neither_panic_nor_allocate(payload in vec(any::<u8>(), 0..200), at: prop::sample::Index) {
        // A valid header and checksum around bytes that are not a checkpoint, with a huge length somewhere.
        let mut payload = [encode(&checkpoint())[28..].to_vec(), payload].concat();
        let at = at.index(payload.len() - 8);
        payload[at..at + 8].copy_from_slice(&(u64::MAX / 3).to_le_bytes());
        let header = [
            &b"ECLIPSE\0"[..],
            &1u32.to_le_bytes(),
            &(payload.len() as u64).to_le_bytes(),
            &crc64(&payload).to_le_bytes(),
        ];
        let bytes = [&header.concat()[..], &payload].concat();
        // Where the bytes hold a plain number, any value is a good one: then no more may be read than there is.
        if let Ok(read) = decode(&bytes) {
            let held = |array: &Array| match array {
                Array::F32(values) => 4 * values.len(),
                Array::F64(values) => 8 * values.len(),
                Array::U64(values) => 8 * values.len(),
            };
            prop_assert!(read.arrays.values().map(held).sum::<usize>() <= bytes.len());
        }
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

#[test]
fn the_latest_and_the_one_before_it_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let first = checkpoint();
    let second = Checkpoint {
        iteration: 43,
        ..first.clone()
    };
    save(folder.path(), &first).unwrap();
    save(folder.path(), &second).unwrap();
    assert_eq!(load(folder.path()).unwrap(), second);

    let latest = folder.path().join("checkpoint.bin");
    fs::write(&latest, &encode(&second)[..100]).unwrap();
    assert_eq!(load(folder.path()).unwrap(), first);
    fs::remove_file(&latest).unwrap();
    assert_eq!(load(folder.path()).unwrap(), first);

    fs::write(&latest, "").unwrap();
    fs::write(folder.path().join("checkpoint.prev.bin"), "").unwrap();
    let error = load(folder.path()).unwrap_err().to_string();
    assert!(error.contains("start again without --resume"), "{error}");
}

#[test]
fn nothing_to_resume_from_is_said_plainly() {
    let folder = tempfile::tempdir().unwrap();
    let error = load(folder.path()).unwrap_err();
    assert!(matches!(error, CheckpointError::Missing { .. }));
    assert!(
        error.to_string().contains("start without --resume"),
        "{error}"
    );
}

#[test]
fn other_formats_are_told_apart_from_damage() {
    let mut bytes = encode(&checkpoint());
    bytes[8] = 2;
    let error = decode(&bytes).unwrap_err();
    assert!(
        matches!(
            error,
            CheckpointError::Version {
                found: 2,
                expected: 1
            }
        ),
        "{error}"
    );
    let error = decode(b"GIF89a..............................")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("does not start as a checkpoint does"),
        "{error}"
    );
}

#[test]
fn a_failed_write_leaves_the_former_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    save(folder.path(), &checkpoint()).unwrap();
    // The predecessor's place is taken by a folder that cannot be replaced.
    fs::create_dir_all(folder.path().join("checkpoint.prev.bin/full")).unwrap();
    let error = save(
        folder.path(),
        &Checkpoint {
            iteration: 43,
            ..checkpoint()
        },
    )
    .unwrap_err();
    assert!(
        error.to_string().starts_with("cannot write the checkpoint"),
        "{error}"
    );
    assert_eq!(load(folder.path()).unwrap().iteration, 42);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        2,
        "temporary files are left"
    );
}

#[test]
fn a_run_continues_only_what_it_started() {
    let checkpoint = checkpoint();
    let same = Settings {
        threads: 1,
        memory: 1,
        time_limit: None,
        iterations: Some(9),
        ..Settings::default()
    };
    checkpoint.check(&same, checkpoint.capture).unwrap();
    let error = checkpoint.check(&same, 1).unwrap_err().to_string();
    assert!(error.contains("another capture"), "{error}");
    let other = Settings {
        lambertian: true,
        ..same
    };
    let error = checkpoint
        .check(&other, checkpoint.capture)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("`lambertian` = false, now it is true"),
        "{error}"
    );
}

#[test]
fn arrays_are_checked_by_type_and_length() {
    let checkpoint = checkpoint();
    assert_eq!(checkpoint.f64s("moment", 2).unwrap(), [0.1, f64::EPSILON]);
    assert_eq!(checkpoint.u64s("counter", 2).unwrap()[1], 7);
    let cases = [
        (
            checkpoint.f32s("environment", 5).unwrap_err(),
            "should hold 5 f32, found 4 f32",
        ),
        (
            checkpoint.f32s("moment", 2).unwrap_err(),
            "should hold 2 f32, found 2 f64",
        ),
        (
            checkpoint.f32s("mask", 2).unwrap_err(),
            "should hold 2 f32, found nothing",
        ),
    ];
    for (error, expected) in cases {
        assert!(error.to_string().contains(expected), "{error}");
    }
    let empty = Checkpoint {
        arrays: BTreeMap::new(),
        ..checkpoint
    };
    assert_eq!(decode(&encode(&empty)).unwrap(), empty);
}
