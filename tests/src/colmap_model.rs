//! A capture written as COLMAP has it: `images/`, `sparse/0` in binary or text, and a mesh.

use std::{fs, path::Path};

use eclipse::{
    capture::{Capture, formats::colmap::Encoding},
    image_io::write_png8,
    mesh_io::{GlbSurface, write_glb},
};
use glam::{Mat3, Quat, Vec3};
use render::{camera::Camera, image::Image};

/// Writes `capture` to `folder`, photographs as RGBA PNG, its cameras in OPENCV's model.
///
/// Points of the mesh become the sparse points. Images are listed from the last to the first, as COLMAP's order is free.
pub fn write(folder: &Path, capture: &Capture, encoding: Encoding) {
    let sparse = folder.join("sparse/0");
    fs::create_dir_all(&sparse).expect("a folder to write to");
    fs::create_dir_all(folder.join("images")).expect("a folder to write to");
    let mut mesh = capture.mesh.clone();
    for position in &mut mesh.positions {
        *position += capture.centre;
    }
    write_glb(&folder.join("mesh.glb"), &mesh, &GlbSurface::default()).expect("a mesh");
    for frame in &capture.frames {
        let pixels = frame.image.data.chunks_exact(3).zip(&frame.mask.data);
        let data = pixels
            .flat_map(|(rgb, &alpha)| [rgb[0].min(1.0), rgb[1].min(1.0), rgb[2].min(1.0), alpha]);
        let rgba = Image {
            channels: 4,
            data: data.collect(),
            ..frame.image
        };
        let path = folder.join(format!("images/{}.png", frame.name));
        write_png8(&path, &rgba).expect("an image");
    }
    let [cameras, images, points] = match encoding {
        Encoding::Binary => [
            cameras_bin(capture),
            images_bin(capture),
            points_bin(&mesh.positions),
        ],
        Encoding::Text => [
            cameras_txt(capture),
            images_txt(capture),
            points_txt(&mesh.positions),
        ],
    };
    let extension = match encoding {
        Encoding::Binary => "bin",
        Encoding::Text => "txt",
    };
    for (name, bytes) in [
        ("cameras", cameras),
        ("images", images),
        ("points3D", points),
    ] {
        fs::write(sparse.join(format!("{name}.{extension}")), bytes).expect("a file");
    }
}

/// Rotation (w x y z) and translation from world to camera with COLMAP's axes: x right, y down, z forwards.
fn pose(camera: &Camera, centre: Vec3) -> ([f64; 4], [f64; 3]) {
    let axes = Mat3::from_mat4(camera.world_from_camera);
    let turned = Mat3::from_cols(axes.x_axis, -axes.y_axis, -axes.z_axis).transpose();
    let translation = -(turned * (camera.centre() + centre));
    let q = Quat::from_mat3(&turned);
    (
        [q.w, q.x, q.y, q.z].map(f64::from),
        translation.to_array().map(f64::from),
    )
}

fn parameters(camera: &Camera) -> [f64; 8] {
    let ([fx, fy], [cx, cy], [k1, k2, p1, p2]) =
        (camera.focal, camera.principal, camera.distortion);
    [fx, fy, cx, cy, k1, k2, p1, p2].map(f64::from)
}

/// Cameras are numbered from 1, a camera an image.
fn cameras_bin(capture: &Capture) -> Vec<u8> {
    let mut bytes = (capture.frames.len() as u64).to_le_bytes().to_vec();
    for (index, frame) in capture.frames.iter().enumerate() {
        bytes.extend((index as u32 + 1).to_le_bytes());
        bytes.extend(4i32.to_le_bytes());
        bytes.extend((frame.camera.width as u64).to_le_bytes());
        bytes.extend((frame.camera.height as u64).to_le_bytes());
        bytes.extend(
            parameters(&frame.camera)
                .into_iter()
                .flat_map(f64::to_le_bytes),
        );
    }
    bytes
}

fn images_bin(capture: &Capture) -> Vec<u8> {
    let mut bytes = (capture.frames.len() as u64).to_le_bytes().to_vec();
    for (index, frame) in capture.frames.iter().enumerate().rev() {
        let (rotation, translation) = pose(&frame.camera, capture.centre);
        bytes.extend((index as u32 + 1).to_le_bytes());
        bytes.extend(
            rotation
                .into_iter()
                .chain(translation)
                .flat_map(f64::to_le_bytes),
        );
        bytes.extend((index as u32 + 1).to_le_bytes());
        bytes.extend(format!("{}.png\0", frame.name).bytes());
        // Two observations: of point 7, and of none.
        bytes.extend(2u64.to_le_bytes());
        for point in [7, u64::MAX] {
            bytes.extend([1.5f64, 2.5].into_iter().flat_map(f64::to_le_bytes));
            bytes.extend(point.to_le_bytes());
        }
    }
    bytes
}

fn points_bin(points: &[Vec3]) -> Vec<u8> {
    let mut bytes = (points.len() as u64).to_le_bytes().to_vec();
    for (index, point) in points.iter().enumerate() {
        bytes.extend((index as u64).to_le_bytes());
        bytes.extend(
            point
                .to_array()
                .into_iter()
                .flat_map(|v| f64::from(v).to_le_bytes()),
        );
        bytes.extend([10, 20, 30]);
        bytes.extend(0.5f64.to_le_bytes());
        bytes.extend(1u64.to_le_bytes());
        bytes.extend([1u32, 0].into_iter().flat_map(u32::to_le_bytes));
    }
    bytes
}

fn joined(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(f64::to_string).collect();
    words.join(" ")
}

fn cameras_txt(capture: &Capture) -> Vec<u8> {
    let mut text = "# Camera list\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n".to_owned();
    for (index, frame) in capture.frames.iter().enumerate() {
        let Camera { width, height, .. } = frame.camera;
        let parameters = joined(&parameters(&frame.camera));
        text += &format!("{} OPENCV {width} {height} {parameters}\n", index + 1);
    }
    text.into_bytes()
}

fn images_txt(capture: &Capture) -> Vec<u8> {
    let mut text = "# Image list with two lines of data per image\n".to_owned();
    for (index, frame) in capture.frames.iter().enumerate().rev() {
        let (rotation, translation) = pose(&frame.camera, capture.centre);
        let id = index + 1;
        // Every other image has no observations: an empty line.
        let observations = if index % 2 == 0 { "1.5 2.5 -1" } else { "" };
        text += &format!(
            "{id} {} {} {id} {}.png\n{observations}\n",
            joined(&rotation),
            joined(&translation),
            frame.name
        );
    }
    text.into_bytes()
}

fn points_txt(points: &[Vec3]) -> Vec<u8> {
    let mut text = "# 3D point list\n".to_owned();
    for (index, point) in points.iter().enumerate() {
        let position = joined(&point.to_array().map(f64::from));
        text += &format!("{index} {position} 10 20 30 0.5 1 0\n");
    }
    text.into_bytes()
}
