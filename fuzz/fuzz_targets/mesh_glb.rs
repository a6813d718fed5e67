//! Any bytes as glTF, binary or not: a mesh that parses is a valid one. A buffer in another file, whatever its name, is this very
//! file: its bytes are as arbitrary as any.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut itself = |_: &str, most: u64| match bytes.len() as u64 <= most {
        true => Ok(bytes.to_vec()),
        false => Err("it is too long".to_owned()),
    };
    if let Ok(mesh) = eclipse::mesh_io::parse_gltf(bytes, &mut itself) {
        mesh.validate().expect("what is parsed can be rendered");
    }
});
