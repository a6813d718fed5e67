//! Perspective cameras with OpenCV distortion.

use glam::Mat4;

/// A pinhole camera, OpenGL axes (+x right, +y up, looking along −z), with OpenCV lens distortion.
///
/// Pixel (i, j) covers [i, i+1] × [j, j+1], j counted from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in pixels, pixel corners at integers.
    pub principal: [f32; 2],
    /// OpenCV distortion coefficients `k1 k2 p1 p2`, zero for an ideal lens.
    pub distortion: [f32; 4],
    /// Camera-to-world transform, rigid.
    pub world_from_camera: Mat4,
}
