//! The binary files of a model, little-endian.
//!
//! Counts are checked against the bytes that follow before anything is reserved for them.

use std::collections::BTreeMap;

use glam::Vec3;

use super::{ModelImage, Problem, camera::CameraModel};
use crate::capture::transforms::Intrinsics;

/// Fewest bytes of a camera (three parameters), an image (no name, no points) and a point (no track).
const CAMERA: usize = 4 + 4 + 8 + 8 + 3 * 8;
const IMAGE: usize = 4 + 7 * 8 + 4 + 1 + 8;
const POINT: usize = 8 + 3 * 8 + 3 + 8 + 8;
/// Bytes of an image's observation of a point, and of an element of a point's track.
const OBSERVATION: usize = 3 * 8;
const TRACK: usize = 2 * 4;

pub(super) fn cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, Problem> {
    let mut cameras = BTreeMap::new();
    let mut bytes = Bytes(bytes);
    for index in 0..bytes.count("the file", "cameras", CAMERA)? {
        let place = format!("camera number {index} (from 0)");
        let id = bytes.u32(&place, "CAMERA_ID")?;
        let model = i32::from_le_bytes(bytes.take(&place, "MODEL")?);
        let model = CameraModel::by_number(model, &place)?;
        let size = [bytes.u64(&place, "WIDTH")?, bytes.u64(&place, "HEIGHT")?];
        let values = model.parameters.iter().map(|_| bytes.f64(&place, "PARAMS"));
        let values: Vec<f64> = values.collect::<Result<_, _>>()?;
        let intrinsics = model.intrinsics(&place, size, &values)?;
        if cameras.insert(id, intrinsics).is_some() {
            return Err(Problem::new(
                place,
                format!("has CAMERA_ID {id}, as one before it; expected each once"),
            ));
        }
    }
    bytes.end("cameras")?;
    Ok(cameras)
}

pub(super) fn images(bytes: &[u8]) -> Result<Vec<ModelImage>, Problem> {
    let mut images = Vec::new();
    let mut bytes = Bytes(bytes);
    for index in 0..bytes.count("the file", "images", IMAGE)? {
        let place = format!("image number {index} (from 0)");
        bytes.u32(&place, "IMAGE_ID")?;
        let mut pose = [0.0; 7];
        for value in &mut pose {
            *value = bytes.f64(&place, "QW QX QY QZ TX TY TZ")?;
        }
        let [w, x, y, z, tx, ty, tz] = pose;
        let camera = bytes.u32(&place, "CAMERA_ID")?;
        let name = bytes.name(&place)?;
        let observations = bytes.count(&place, "POINTS2D", OBSERVATION)?;
        bytes.skip(observations * OBSERVATION);
        images.push(ModelImage {
            name,
            camera,
            rotation: [w, x, y, z],
            translation: [tx, ty, tz],
        });
    }
    bytes.end("images")?;
    Ok(images)
}

pub(super) fn points(bytes: &[u8]) -> Result<Vec<Vec3>, Problem> {
    let mut points = Vec::new();
    let mut bytes = Bytes(bytes);
    for index in 0..bytes.count("the file", "points", POINT)? {
        let place = format!("point number {index} (from 0)");
        bytes.u64(&place, "POINT3D_ID")?;
        let mut position = [0.0; 3];
        for value in &mut position {
            *value = bytes.f64(&place, "X Y Z")? as f32;
        }
        // Colour and error.
        bytes.take::<{ 3 + 8 }>(&place, "R G B ERROR")?;
        let track = bytes.count(&place, "TRACK", TRACK)?;
        bytes.skip(track * TRACK);
        points.push(Vec3::from(position));
    }
    bytes.end("points")?;
    Ok(points)
}

/// What is left of a file.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self, place: &str, field: &str) -> Result<[u8; N], Problem> {
        let Some((taken, rest)) = self.0.split_first_chunk() else {
            return Err(Problem::new(
                place,
                format!(
                    "ends within {field} ({} bytes where {N} are expected): the file is truncated",
                    self.0.len()
                ),
            ));
        };
        self.0 = rest;
        Ok(*taken)
    }

    fn u32(&mut self, place: &str, field: &str) -> Result<u32, Problem> {
        self.take(place, field).map(u32::from_le_bytes)
    }

    fn u64(&mut self, place: &str, field: &str) -> Result<u64, Problem> {
        self.take(place, field).map(u64::from_le_bytes)
    }

    fn f64(&mut self, place: &str, field: &str) -> Result<f64, Problem> {
        self.take(place, field).map(f64::from_le_bytes)
    }

    /// A number of records of at least `least` bytes each, for which there must be room.
    fn count(&mut self, place: &str, what: &str, least: usize) -> Result<usize, Problem> {
        let count = self.u64(place, what)?;
        let most = self.0.len() / least;
        match usize::try_from(count) {
            Ok(count) if count <= most => Ok(count),
            _ => Err(Problem::new(
                place,
                format!(
                    "says {count} {what}, but has room for {most} at most: the file is truncated or damaged"
                ),
            )),
        }
    }

    /// Passes over bytes that [`Self::count`] has found to be there.
    fn skip(&mut self, count: usize) {
        self.0 = &self.0[count..];
    }

    fn name(&mut self, place: &str) -> Result<String, Problem> {
        let Some(length) = self.0.iter().position(|&byte| byte == 0) else {
            return Err(Problem::new(
                place,
                "ends within NAME: the file is truncated",
            ));
        };
        let (name, rest) = self.0.split_at(length);
        self.0 = &rest[1..];
        let name = std::str::from_utf8(name)
            .map_err(|_| Problem::new(place, "has a NAME that is not UTF-8; rename the image"))?;
        super::checked_name(name, place)
    }

    fn end(&self, what: &str) -> Result<(), Problem> {
        if self.0.is_empty() {
            return Ok(());
        }
        Err(Problem::new(
            "the file",
            format!(
                "has {} bytes after the last of its {what}; expected none: it is damaged",
                self.0.len()
            ),
        ))
    }
}
