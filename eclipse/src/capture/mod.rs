//! What a user hands in: posed photographs and the object's shape.

use std::path::PathBuf;

use glam::Vec3;
use render::{camera::Camera, image::Image, mesh::Mesh};

/// A capture, read and checked, in the recentred frame (the middle of the mesh's bounding box is the origin).
#[derive(Clone, Debug)]
pub struct Capture {
    /// The folder it was read from.
    pub path: PathBuf,
    /// Photographs, in the order of `transforms.json`.
    pub frames: Vec<Frame>,
    /// The object.
    pub mesh: Mesh,
    /// Where the recentred frame's origin lies in the capture's own frame: own = recentred + centre.
    pub centre: Vec3,
}

/// One photograph with its camera.
#[derive(Clone, Debug)]
pub struct Frame {
    /// File name without folder and extension, such as `007`.
    pub name: String,
    /// Where and how it was taken, in the recentred frame.
    pub camera: Camera,
    /// Linear RGB, three channels.
    pub image: Image,
    /// Coverage of each pixel by the object, one channel in [0, 1].
    pub mask: Image,
}
