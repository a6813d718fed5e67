//! Any bytes as a checkpoint, and as the payload of one whose header and checksum are right: what decodes comes out the same
//! when it is encoded and decoded again.

#![no_main]

use eclipse::checkpoint::{decode, encode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = decode(bytes);
    let header = [
        &b"ECLIPSE\0"[..],
        &1u32.to_le_bytes(),
        &(bytes.len() as u64).to_le_bytes(),
        &crc64(bytes).to_le_bytes(),
    ];
    let whole = [&header.concat()[..], bytes].concat();
    if let Ok(checkpoint) = decode(&whole) {
        let encoded = encode(&checkpoint);
        let again = decode(&encoded).expect("what was encoded can be decoded");
        // NaNs are not equal to themselves; their bytes are.
        assert_eq!(encode(&again), encoded);
    }
});

/// CRC-64/XZ by its definition, bit by bit.
fn crc64(bytes: &[u8]) -> u64 {
    let byte = |crc: u64, byte: &u8| {
        (0..8).fold(crc ^ u64::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xc96c_5795_d787_0f42 & (crc & 1).wrapping_neg())
        })
    };
    !bytes.iter().fold(!0, byte)
}
