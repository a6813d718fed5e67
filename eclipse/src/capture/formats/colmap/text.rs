//! The text files of a model: fields separated by blanks, comments after `#`.

use std::{collections::BTreeMap, str::FromStr};

use glam::Vec3;

use super::{ModelImage, Problem, camera::CameraModel};
use crate::capture::transforms::Intrinsics;

pub(super) fn cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, Problem> {
    let mut cameras = BTreeMap::new();
    for mut line in records(bytes)? {
        let id: u32 = line.number("CAMERA_ID")?;
        let model = CameraModel::by_name(line.word("MODEL")?, &line.place)?;
        let size = [line.number("WIDTH")?, line.number("HEIGHT")?];
        let mut values: Vec<f64> = Vec::new();
        while !line.rest.is_empty() {
            values.push(line.number("PARAMS")?);
        }
        let intrinsics = model.intrinsics(&line.place, size, &values)?;
        if cameras.insert(id, intrinsics).is_some() {
            return Err(Problem::new(
                line.place,
                format!("has CAMERA_ID {id}, as one before it; expected each once"),
            ));
        }
    }
    Ok(cameras)
}

pub(super) fn images(bytes: &[u8]) -> Result<Vec<ModelImage>, Problem> {
    let mut images = Vec::new();
    let mut lines = lines(bytes)?;
    while let Some(mut line) = lines.next() {
        if line.is_comment() {
            continue;
        }
        line.number::<u32>("IMAGE_ID")?;
        let mut pose = [0.0; 7];
        for (value, field) in pose
            .iter_mut()
            .zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"])
        {
            *value = line.number(field)?;
        }
        let [w, x, y, z, tx, ty, tz] = pose;
        let camera = line.number("CAMERA_ID")?;
        // A name may have blanks in it.
        let name = super::checked_name(line.rest, &line.place)?;
        images.push(ModelImage {
            name,
            camera,
            rotation: [w, x, y, z],
            translation: [tx, ty, tz],
        });
        // The image's observations, on a line of their own that may be empty.
        if let Some(line) = lines.next().filter(|line| !line.is_observations()) {
            return Err(Problem::new(
                line.place,
                "holds no observations of the image before it (X, Y and POINT3D_ID of each, or nothing at all); give every image \
                 two lines, of which the second may be empty",
            ));
        }
    }
    Ok(images)
}

pub(super) fn points(bytes: &[u8]) -> Result<Vec<Vec3>, Problem> {
    records(bytes)?
        .map(|mut line| {
            line.number::<u64>("POINT3D_ID")?;
            Ok(Vec3::new(
                line.number("X")?,
                line.number("Y")?,
                line.number("Z")?,
            ))
        })
        .collect()
}

/// A line, or what is left of it, and where it stands.
struct Line<'a> {
    place: String,
    rest: &'a str,
}

impl<'a> Line<'a> {
    fn is_comment(&self) -> bool {
        self.rest.is_empty() || self.rest.starts_with('#')
    }

    /// Whether it could hold observations: numbers by threes. An image's own line ends with a name.
    fn is_observations(&self) -> bool {
        let mut count = 0;
        let mut words = self.rest.split_whitespace().inspect(|_| count += 1);
        let are_numbers = words.all(|word| word.parse::<f64>().is_ok());
        are_numbers && count % 3 == 0
    }

    fn word(&mut self, field: &str) -> Result<&'a str, Problem> {
        let end = self
            .rest
            .find(char::is_whitespace)
            .unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        if word.is_empty() {
            return Err(Problem::new(
                &*self.place,
                format!(
                    "ends before {field}; expected all fields that the file's first lines name"
                ),
            ));
        }
        self.rest = rest.trim_start();
        Ok(word)
    }

    fn number<T: FromStr>(&mut self, field: &str) -> Result<T, Problem> {
        let word = self.word(field)?;
        word.parse().map_err(|_| {
            Problem::new(
                &*self.place,
                format!("has {word:?} for {field}; expected a number"),
            )
        })
    }
}

fn lines(bytes: &[u8]) -> Result<impl Iterator<Item = Line<'_>>, Problem> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Problem::new("the file", "is not text (UTF-8); expected COLMAP's text"))?;
    Ok(text.lines().enumerate().map(|(index, line)| Line {
        place: format!("line {}", index + 1),
        rest: line.trim(),
    }))
}

/// The lines without comments.
fn records(bytes: &[u8]) -> Result<impl Iterator<Item = Line<'_>>, Problem> {
    Ok(lines(bytes)?.filter(|line| !line.is_comment()))
}
