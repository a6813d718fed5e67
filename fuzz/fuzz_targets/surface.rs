//! Any bytes as a mesh with its materials: what parses has a material wherever the mesh is.

#![no_main]

use eclipse::mesh_io::{MeshSurface, parse_surfaced_glb};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok((mesh, surface)) = parse_surfaced_glb(bytes) else {
        return;
    };
    mesh.validate().expect("what is parsed can be rendered");
    match surface {
        MeshSurface::Vertices(materials) => assert_eq!(materials.len(), mesh.positions.len()),
        MeshSurface::Maps(maps) => {
            for uv in mesh.uvs.iter().take(64) {
                let material = maps.at(*uv);
                assert!(material.alpha.is_finite() && material.kappa.is_finite());
            }
        }
    }
});
