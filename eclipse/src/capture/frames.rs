//! Photographs and masks: decoding in parallel, and what can be checked of each alone.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use render::image::Image;

use super::{
    CaptureError, Frame, MAX_SAMPLES,
    paths::Folder,
    pose::{camera, declared_size, rigid_pose},
    transforms::{Transforms, TransformsFrame},
};
use crate::image_io::{ColorEncoding, read_image, read_size};

/// What is kept of a pixel of a photograph: three values of colour and one of coverage.
const KEPT: usize = 4;

/// Reads every frame, in the order of `transforms`.
pub(super) fn load(
    folder: &Folder,
    json: &Path,
    transforms: &Transforms,
    encoding: Option<ColorEncoding>,
) -> Result<Vec<Frame>, CaptureError> {
    let names = names(json, &transforms.frames)?;
    check_samples(folder, json, &transforms.frames)?;
    // Collected in order before the first error is looked for, so that it does not depend on timing.
    let frames: Vec<Result<Frame, CaptureError>> = names
        .into_par_iter()
        .zip(&transforms.frames)
        .map(|(name, entry)| load_frame(folder, transforms, name, entry, encoding))
        .collect();
    let frames = frames
        .into_iter()
        .collect::<Result<Vec<Frame>, CaptureError>>()?;
    same_sizes(folder, transforms, &frames)?;
    Ok(frames)
}

/// Refuses photographs and masks of more samples than may be read, before any of them is decoded: a few kilobytes of PNG can
/// hold a hundred million pixels of one colour.
fn check_samples(
    folder: &Folder,
    json: &Path,
    entries: &[TransformsFrame],
) -> Result<(), CaptureError> {
    // A file that is not there, or no image, counts nothing here: reading its frame says what is wrong with it.
    let size = |field, name: &str| read_size(&folder.image("", field, name).ok()?).ok();
    let samples_of = |entry: &TransformsFrame| {
        let photograph = size("file_path", &entry.file_path)
            .map_or(0, |size| size.samples.max(KEPT * size.width * size.height));
        let mask = entry.mask_path.as_deref();
        let mask = mask.and_then(|name| size("mask_path", name));
        photograph as u64 + mask.map_or(0, |size| size.samples as u64)
    };
    let samples: u64 = entries.par_iter().map(samples_of).sum();
    if samples <= MAX_SAMPLES {
        return Ok(());
    }
    Err(CaptureError::TooManySamples {
        path: json.into(),
        samples,
    })
}

fn load_frame(
    folder: &Folder,
    transforms: &Transforms,
    name: String,
    entry: &TransformsFrame,
    encoding: Option<ColorEncoding>,
) -> Result<Frame, CaptureError> {
    let intrinsics = entry.intrinsics.or(&transforms.intrinsics);
    let pose = rigid_pose(&name, transforms.pose_of(entry))?;
    let declared = declared_size(&name, &intrinsics)?;
    let path = folder.image(&name, "file_path", &entry.file_path)?;
    let decode = |path: &Path, encoding| {
        read_image(path, encoding).map_err(|source| CaptureError::Image {
            frame: name.clone(),
            source,
        })
    };
    let image = decode(&path, encoding)?;
    let size = [image.width, image.height];
    let wanted = [
        declared[0].unwrap_or(size[0]),
        declared[1].unwrap_or(size[1]),
    ];
    check_size(&name, &path, size, "`w` and `h` say", wanted)?;
    let camera = camera(&name, transforms.projection(), &intrinsics, size, pose)?;
    check_finite(&name, &path, &image)?;
    let (mask, mask_path) = match &entry.mask_path {
        Some(mask_path) => {
            let mask_path = folder.image(&name, "mask_path", mask_path)?;
            // Masks are coverage, not light: no curve applies.
            let mask = decode(&mask_path, Some(ColorEncoding::Linear))?;
            check_size(
                &name,
                &mask_path,
                [mask.width, mask.height],
                "the image has",
                size,
            )?;
            check_finite(&name, &mask_path, &mask)?;
            (file_mask(&mask), mask_path)
        }
        None if image.channels.is_multiple_of(2) => (channel(&image, image.channels - 1), path),
        None => return Err(CaptureError::NoMask { frame: name, path }),
    };
    if mask.data.iter().all(|&coverage| coverage <= 0.5) {
        return Err(CaptureError::EmptyMask {
            frame: name,
            path: mask_path,
        });
    }
    Ok(Frame {
        name,
        camera,
        image: image.to_rgb(),
        mask,
    })
}

/// The frames' names: file names without extension or, where those repeat, paths with `_` between folders.
fn names(json: &Path, entries: &[TransformsFrame]) -> Result<Vec<String>, CaptureError> {
    let stem = |path: &Path| {
        path.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let paths: Vec<PathBuf> = entries
        .iter()
        .map(|entry| PathBuf::from(entry.file_path.replace('\\', "/")))
        .collect();
    let distinct = |names: &[String]| {
        let mut seen = HashSet::new();
        names
            .iter()
            .position(|name| name.is_empty() || !seen.insert(name))
    };
    let short: Vec<String> = paths.iter().map(|path| stem(path)).collect();
    if distinct(&short).is_none() {
        return Ok(short);
    }
    let long: Vec<String> = paths
        .iter()
        .map(|path| {
            let path = path.with_extension("");
            let parts = path.components().filter_map(|part| match part {
                std::path::Component::Normal(part) => Some(part.to_string_lossy().into_owned()),
                _ => None,
            });
            parts.collect::<Vec<_>>().join("_")
        })
        .collect();
    match distinct(&long) {
        None => Ok(long),
        Some(index) => Err(CaptureError::DuplicateFrame {
            path: json.into(),
            file_path: entries[index].file_path.clone(),
        }),
    }
}

fn check_size(
    frame: &str,
    path: &Path,
    found: [usize; 2],
    expected: &'static str,
    wanted: [usize; 2],
) -> Result<(), CaptureError> {
    if found == wanted {
        return Ok(());
    }
    Err(CaptureError::Size {
        frame: frame.into(),
        path: path.into(),
        found,
        expected,
        wanted,
    })
}

/// Frames that share their intrinsics must share their size, even where no `w` and `h` say it.
fn same_sizes(
    folder: &Folder,
    transforms: &Transforms,
    frames: &[Frame],
) -> Result<(), CaptureError> {
    let shared = |entry: &TransformsFrame| {
        entry.intrinsics.fl_x.is_none() && entry.intrinsics.camera_angle_x.is_none()
    };
    let size = |frame: &Frame| [frame.image.width, frame.image.height];
    let mut with_shared = frames
        .iter()
        .zip(&transforms.frames)
        .filter(|(_, entry)| shared(entry));
    let Some((first, _)) = with_shared.next() else {
        return Ok(());
    };
    for (frame, entry) in with_shared {
        if size(frame) != size(first) {
            let path = folder.image(&frame.name, "file_path", &entry.file_path)?;
            check_size(
                &frame.name,
                &path,
                size(frame),
                "the first frame, with the same intrinsics, has",
                size(first),
            )?;
        }
    }
    Ok(())
}

fn check_finite(frame: &str, path: &Path, image: &Image) -> Result<(), CaptureError> {
    let bad = |pixel: &&[f32]| pixel.iter().any(|value| !value.is_finite());
    let mut pixels = image.data.chunks_exact(image.channels);
    let Some(first) = pixels.position(|pixel| bad(&pixel)) else {
        return Ok(());
    };
    let count = 1 + pixels.filter(bad).count();
    let (column, row) = (first % image.width, first / image.width);
    Err(CaptureError::NotFinite {
        frame: frame.into(),
        path: path.into(),
        count,
        column,
        row,
    })
}

/// One channel, clamped to [0, 1].
fn channel(image: &Image, index: usize) -> Image {
    let data = image
        .data
        .iter()
        .skip(index)
        .step_by(image.channels)
        .map(|value| value.clamp(0.0, 1.0))
        .collect();
    Image {
        channels: 1,
        data,
        ..*image
    }
}

/// The mask in a file of its own: its brightest colour times its alpha, so that white on black, white on nothing and
/// coloured labels all work.
fn file_mask(image: &Image) -> Image {
    let colors = if image.channels.is_multiple_of(2) {
        image.channels - 1
    } else {
        image.channels
    };
    let coverage = |pixel: &[f32]| {
        let brightest = pixel[..colors].iter().copied().fold(0.0, f32::max);
        let alpha = if colors < pixel.len() {
            pixel[colors]
        } else {
            1.0
        };
        (brightest * alpha).clamp(0.0, 1.0)
    };
    let data = image
        .data
        .chunks_exact(image.channels)
        .map(coverage)
        .collect();
    Image {
        channels: 1,
        data,
        ..*image
    }
}
