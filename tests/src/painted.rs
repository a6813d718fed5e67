//! Captures whose photographs are plausible pictures that no light made: for tests that look at geometry, or put values of their own in.

use std::path::Path;

use eclipse::capture::{Capture, Frame};
use glam::Vec3;
use render::{
    bvh::{Bvh, SurfacePoint},
    camera::Camera,
    image::Image,
    mesh::Mesh,
};

/// `mesh` through these cameras, every place in the colour that `paint` gives it.
pub fn capture(
    mesh: Mesh,
    path: &Path,
    cameras: impl Iterator<Item = Camera>,
    paint: impl Fn(&SurfacePoint) -> [f32; 3],
) -> Capture {
    let bvh = Bvh::new(&mesh).expect("a mesh that casts shadows");
    let frames = cameras.enumerate().map(|(t, camera)| {
        let (width, height) = (camera.width, camera.height);
        let mask = Image {
            width,
            height,
            channels: 1,
            data: bvh.coverage(&camera, 3),
        };
        let mut image = Image::filled(width, height, 3, 0.0);
        for (p, rgb) in image.data.chunks_exact_mut(3).enumerate() {
            let (x, y) = ((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
            if let Some((point, _)) = bvh.seen(&camera, x, y) {
                rgb.copy_from_slice(&paint(&point));
            }
        }
        Frame {
            name: format!("{t:03}"),
            camera,
            image,
            mask,
        }
    });
    Capture {
        lamps: None,
        path: path.into(),
        frames: frames.collect(),
        mesh,
        centre: Vec3::ZERO,
    }
}
