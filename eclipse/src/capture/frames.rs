//! Photographs and masks: decoding in parallel, and what can be checked of each alone.

mod masks;
mod names;

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use render::image::Image;

use super::{
    CaptureError, Frame, MAX_SAMPLES,
    cameras::scaled,
    error::{At, all_good},
    paths::Folder,
    pose::{camera, declared_size, rigid_pose},
    transforms::{Transforms, TransformsFrame},
};
use crate::image_io::{ColorEncoding, read_image, read_size, read_turn, reduce, reduced_size};

/// What is kept of a pixel of a photograph: three values of colour and one of coverage.
const KEPT: usize = 4;
/// Samples that are decoded at once, 1 GiB as floats; more, where a frame alone has more. What is kept of them is less.
const AT_ONCE: u64 = 1 << 28;

/// How photographs are read.
#[derive(Clone, Copy)]
pub(super) struct Reading {
    /// How they store colours, where that is not by their type.
    pub encoding: Option<ColorEncoding>,
    /// The longest side that is kept of them.
    pub max_size: Option<usize>,
    /// Bytes that all may take as floats.
    pub max_memory: u64,
}

/// Reads every frame, in the order of `transforms`.
pub(super) fn load(
    folder: &Folder,
    json: &Path,
    transforms: &Transforms,
    reading: Reading,
) -> Result<Vec<Frame>, CaptureError> {
    let entries = &transforms.frames;
    let names = names::of(json, entries)?;
    let samples = samples((folder, json), entries, reading.max_size);
    check_samples(json, &samples, reading.max_memory)?;
    // In order, whatever the timing.
    let read = batches(&samples, AT_ONCE.min(reading.max_memory / 4))
        .into_iter()
        .flat_map(|batch| {
            let read: Vec<Result<_, CaptureError>> = names[batch.clone()]
                .par_iter()
                .zip(&entries[batch])
                .map(|(name, entry)| {
                    load_frame((folder, json), transforms, name.clone(), entry, reading)
                })
                .collect();
            read
        });
    let (frames, sizes): (Vec<Frame>, Vec<[usize; 2]>) = all_good(json, read)?.into_iter().unzip();
    same_sizes((folder, json), transforms, &frames, &sizes)?;
    Ok(frames)
}

/// Samples of a photograph and its mask.
#[derive(Clone, Copy)]
struct Samples {
    /// While they are decoded.
    decoded: u64,
    /// Afterwards.
    kept: u64,
}

/// What each frame takes, by the headers of its files: a few kilobytes of PNG can hold a hundred million pixels of one colour.
fn samples(
    (folder, json): (&Folder, &Path),
    entries: &[TransformsFrame],
    max_size: Option<usize>,
) -> Vec<Samples> {
    // A file that is not there, or no image, counts nothing here: reading its frame says what is wrong with it.
    let at = At {
        path: json,
        frame: "",
    };
    let size = |field, name: &str| read_size(&folder.image(at, field, name).ok()?).ok();
    let of = |entry: &TransformsFrame| {
        let photograph = size("file_path", &entry.file_path);
        let mask = entry.mask_path.as_deref();
        let mask = mask.and_then(|name| size("mask_path", name));
        let decoded = photograph.map_or(0, |size| size.samples.max(KEPT * size.width * size.height))
            as u64
            + mask.map_or(0, |size| size.samples as u64);
        let reduced = photograph.zip(max_size).and_then(|(size, longest)| {
            let own = [size.width, size.height];
            let reduced = reduced_size(own, longest);
            (reduced != own).then(|| (KEPT * reduced[0] * reduced[1]) as u64)
        });
        Samples {
            decoded,
            kept: reduced.unwrap_or(decoded),
        }
    };
    entries.par_iter().map(of).collect()
}

/// Refuses photographs and masks of more samples than may be kept, before any of them is decoded.
fn check_samples(json: &Path, samples: &[Samples], allowed: u64) -> Result<(), CaptureError> {
    let samples: u64 = samples.iter().map(|samples| samples.kept).sum();
    if samples <= MAX_SAMPLES && 4 * samples <= allowed {
        return Ok(());
    }
    let path = json.into();
    Err(if samples > MAX_SAMPLES {
        CaptureError::TooManySamples { path, samples }
    } else {
        CaptureError::NotAllowed {
            path,
            samples,
            allowed,
        }
    })
}

/// The frames in parts, of which one after the other is decoded: as many as `at_once` allows, but one at least.
fn batches(samples: &[Samples], at_once: u64) -> Vec<Range<usize>> {
    let mut batches = Vec::new();
    let (mut start, mut sum) = (0, 0);
    for (index, samples) in samples.iter().enumerate() {
        if index > start && sum + samples.decoded > at_once {
            batches.push(start..index);
            (start, sum) = (index, 0);
        }
        sum += samples.decoded;
    }
    batches.push(start..samples.len());
    batches
}

/// A frame, and the size that its photograph has in its file.
fn load_frame(
    (folder, json): (&Folder, &Path),
    transforms: &Transforms,
    name: String,
    entry: &TransformsFrame,
    Reading {
        encoding, max_size, ..
    }: Reading,
) -> Result<(Frame, [usize; 2]), CaptureError> {
    let intrinsics = entry.intrinsics.or(&transforms.intrinsics);
    let at = At {
        path: json,
        frame: &name,
    };
    let pose = rigid_pose(at, transforms.pose_of(entry))?;
    let declared = declared_size(at, &intrinsics)?;
    let path = folder.image(at, "file_path", &entry.file_path)?;
    let decode = |path: &Path, encoding| {
        read_image(path, encoding).map_err(|source| CaptureError::Image {
            frame: name.clone(),
            source,
        })
    };
    let mut image = as_declared(decode(&path, encoding)?, &path, declared);
    let size = [image.width, image.height];
    let wanted = [
        declared[0].unwrap_or(size[0]),
        declared[1].unwrap_or(size[1]),
    ];
    check_size(&name, &path, size, "`w` and `h` say", wanted)?;
    let camera = camera(at, transforms.projection(), &intrinsics, size, pose)?;
    let (mask, mask_path) = match entry.mask_path.as_ref().or(transforms.mask_path.as_ref()) {
        Some(mask_path) => {
            let mask_path = folder.image(at, "mask_path", mask_path)?;
            // Masks are coverage, not light: no curve applies.
            let mask = decode(&mask_path, Some(ColorEncoding::Linear))?;
            check_size(
                &name,
                &mask_path,
                [mask.width, mask.height],
                "the image has",
                size,
            )?;
            refuse_not_finite(&name, &mask_path, &mask, |_| true)?;
            (masks::of_file(&mask), mask_path)
        }
        None if image.channels.is_multiple_of(2) => (masks::of_alpha(&image), path.clone()),
        None => return Err(CaptureError::NoMask { frame: name, path }),
    };
    let mask = masks::whitened(mask);
    // Alpha that is not finite says neither.
    let may_show = |pixel: usize| mask.data[pixel].is_nan() || mask.data[pixel] > 0.0;
    refuse_not_finite(&name, &path, &image, may_show)?;
    // Renderers leave such values where there is nothing: they are of no pixel that is used, and must not spread when averaged.
    for value in image.data.iter_mut().filter(|value| !value.is_finite()) {
        *value = 0.0;
    }
    let small = max_size.map_or(size, |longest| reduced_size(size, longest));
    let reduced = |image: Image| match small == size {
        true => image,
        false => reduce(&image, small),
    };
    let shown = |mask: &Image| mask.data.iter().filter(|&&coverage| coverage > 0.5).count();
    let pixels = shown(&mask);
    if pixels == 0 {
        return Err(nothing_shown(name, mask_path, &mask));
    }
    let mask = reduced(mask);
    if let Some(longest) = max_size.filter(|_| shown(&mask) == 0) {
        return Err(CaptureError::ReducedAway {
            frame: name,
            path: mask_path,
            pixels,
            longest,
            size: small,
        });
    }
    let frame = Frame {
        name,
        camera: scaled(camera, small),
        image: reduced(image).to_rgb(),
        mask,
    };
    Ok((frame, size))
}

/// What is wrong with a mask that has nothing above one half.
fn nothing_shown(frame: String, path: PathBuf, mask: &Image) -> CaptureError {
    match masks::brightest(mask) {
        Some(brightest) => CaptureError::DimMask {
            frame,
            path,
            brightest,
        },
        None => CaptureError::EmptyMask { frame, path },
    }
}

/// The photograph as its file says that it is shown, where that has the declared size and what is stored has not: some programs
/// that find the cameras turn photographs, some do not.
fn as_declared(stored: Image, path: &Path, declared: [Option<usize>; 2]) -> Image {
    let [w, h] = declared;
    let fits = |width, height| w.is_none_or(|w| w == width) && h.is_none_or(|h| h == height);
    if fits(stored.width, stored.height) || !fits(stored.height, stored.width) {
        return stored;
    }
    match read_turn(path) {
        Some(turn) => turn.shown(&stored),
        None => stored,
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
    let note = read_turn(path).map_or(String::new(), |turn| {
        format!(" and the EXIF orientation {}, which turns it", turn.exif())
    });
    Err(CaptureError::Size {
        frame: frame.into(),
        path: path.into(),
        found,
        note,
        expected,
        wanted,
    })
}

/// Frames that share their intrinsics must share the size of their files, even where no `w` and `h` say it.
fn same_sizes(
    (folder, json): (&Folder, &Path),
    transforms: &Transforms,
    frames: &[Frame],
    sizes: &[[usize; 2]],
) -> Result<(), CaptureError> {
    let shared = |entry: &TransformsFrame| {
        entry.intrinsics.fl_x.is_none() && entry.intrinsics.camera_angle_x.is_none()
    };
    let mut with_shared = frames
        .iter()
        .zip(sizes)
        .zip(&transforms.frames)
        .filter(|(_, entry)| shared(entry));
    let Some(((_, first), _)) = with_shared.next() else {
        return Ok(());
    };
    let alike = with_shared.map(|((frame, size), entry)| {
        if size == first {
            return Ok(());
        }
        let at = At {
            path: json,
            frame: &frame.name,
        };
        let path = folder.image(at, "file_path", &entry.file_path)?;
        let expected = "the first frame, with the same intrinsics, has";
        check_size(&frame.name, &path, *size, expected, *first)
    });
    all_good(json, alike).map(drop)
}

/// Refuses an image with values that are not finite in pixels that matter, by their number.
fn refuse_not_finite(
    frame: &str,
    path: &Path,
    image: &Image,
    matters: impl Fn(usize) -> bool,
) -> Result<(), CaptureError> {
    let pixels = image.data.chunks_exact(image.channels).enumerate();
    let mut bad = pixels
        .filter(|(index, pixel)| pixel.iter().any(|value| !value.is_finite()) && matters(*index));
    let Some((first, _)) = bad.next() else {
        return Ok(());
    };
    let count = 1 + bad.count();
    let (column, row) = (first % image.width, first / image.width);
    Err(CaptureError::NotFinite {
        frame: frame.into(),
        path: path.into(),
        count,
        column,
        row,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_decoded_at_once_than_may_be_but_for_one_frame() {
        let of = |decoded: &[u64]| {
            let samples = decoded.iter().map(|&decoded| Samples { decoded, kept: 1 });
            batches(&samples.collect::<Vec<_>>(), 10)
        };
        assert_eq!(of(&[5, 5, 5]), [0..2, 2..3]);
        assert_eq!(of(&[15, 1, 5, 5]), [0..1, 1..3, 3..4]);
        assert_eq!(of(&[0, 0, 15]), [0..2, 2..3]);
    }
}
