//! Any bytes as PLY: a mesh that parses is a valid one.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(mesh) = eclipse::mesh_io::parse_ply(bytes) {
        mesh.validate().expect("what is parsed can be rendered");
    }
});
