//! A capture whose own world lies on its side.

use eclipse::capture::{Capture, UpAxis};
use glam::Mat4;

/// The same capture in axes in which `up` points up: what [`LoadOptions::up`](eclipse::capture::LoadOptions::up) brings back.
pub fn lying(capture: &Capture, up: UpAxis) -> Capture {
    let back = up.turn().transpose();
    let mut lying = capture.clone();
    let mesh = &mut lying.mesh;
    for vector in mesh.positions.iter_mut().chain(&mut mesh.normals) {
        *vector = back * *vector;
    }
    for frame in &mut lying.frames {
        let pose = &mut frame.camera.world_from_camera;
        *pose = Mat4::from_mat3(back) * *pose;
    }
    for lamp in lying.lamps.iter_mut().flat_map(|known| &mut known.lamps) {
        lamp.direction = back * lamp.direction;
    }
    lying.centre = back * lying.centre;
    lying
}
