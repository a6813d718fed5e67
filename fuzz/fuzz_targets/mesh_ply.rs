//! Any bytes as PLY, a mesh or points alone: a mesh that parses is a valid one, and has faces.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let points = eclipse::mesh_io::parse_ply_points(bytes);
    if let Ok(mesh) = eclipse::mesh_io::parse_ply(bytes) {
        mesh.validate().expect("what is parsed can be rendered");
        assert!(matches!(points, Ok(None)));
    }
});
