//! Any bytes as `transforms.json`.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = eclipse::capture::parse_transforms(bytes, std::path::Path::new("transforms.json"));
});
