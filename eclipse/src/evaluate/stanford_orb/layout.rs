//! Where the benchmark keeps what, and where predictions are looked for.
//!
//! A scene of `blender_HDR` has `transforms_train.json`, `transforms_test.json` and `transforms_novel.json`; a `file_path` such as
//! `test/0003` names `test/0003.exr` and the mask `test_mask/0003.png`. Frames of `transforms_novel.json` carry the `scene_name` of
//! another scene, beside this one, which photographs the same object elsewhere.

use std::{
    path::{Component, Path, PathBuf},
    str::FromStr,
};

use render::image::Image;

use super::{StanfordOrbError, similarity::RESOLUTION};
use crate::{
    capture::{
        CaptureError, parse_transforms,
        transforms::{MAX_TRANSFORMS, TransformsFrame},
    },
    files::{read_limited, slashed},
    image_io::{ColorEncoding, read_image},
};

/// Which views are scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Those that a method was given.
    Train,
    /// New views in the same light.
    Test,
    /// Views in other light.
    Novel,
}

impl Split {
    /// Every split.
    pub const ALL: [Self; 3] = [Self::Train, Self::Test, Self::Novel];

    /// The name in the benchmark's files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Test => "test",
            Self::Novel => "novel",
        }
    }
}

impl FromStr for Split {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|split| split.name() == name);
        found.ok_or_else(|| format!("unknown split `{name}`; use train, test or novel"))
    }
}

/// One view to be scored.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// `0003`, or `cup_scene002/0003` in light of another scene.
    pub name: String,
    /// The photograph.
    pub image: PathBuf,
    /// Its mask.
    pub mask: PathBuf,
}

/// The views of `split`, in the order of the file.
///
/// # Errors
/// A file that cannot be read, or has no such frames, or frames whose files lie outside the benchmark's folder.
pub fn views(scene: &Path, split: Split) -> Result<Vec<View>, StanfordOrbError> {
    let path = scene.join(format!("transforms_{}.json", split.name()));
    let bytes = read_limited(&path, MAX_TRANSFORMS).map_err(|source| CaptureError::Read {
        path: path.clone(),
        source,
    })?;
    let transforms = parse_transforms(&bytes, &path)?;
    let mut views = Vec::new();
    for frame in &transforms.frames {
        views.push(view(scene, split, frame, &path)?);
    }
    if views.is_empty() {
        let wanted = split.name().to_owned();
        return Err(StanfordOrbError::NoViews { path, wanted });
    }
    Ok(views)
}

/// The view of a frame that `json` lists.
fn view(
    scene: &Path,
    split: Split,
    frame: &TransformsFrame,
    json: &Path,
) -> Result<View, StanfordOrbError> {
    let file = within(&frame.file_path, "file_path", json)?;
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let folder = file.parent().unwrap_or(Path::new(""));
    let (root, name) = match (&frame.scene_name, split) {
        (Some(other), Split::Novel) => {
            let other = within(other, "scene_name", json)?;
            let name = format!("{}/{stem}", other.display());
            (scene.join("..").join(other), name)
        }
        _ => (scene.to_owned(), stem.clone().into_owned()),
    };
    let mut masks = folder.as_os_str().to_owned();
    masks.push("_mask");
    let view = View {
        name,
        image: root.join(folder).join(format!("{stem}.exr")),
        mask: root.join(masks).join(format!("{stem}.png")),
    };
    // What is not there, or has no parent, is said when it is read.
    if let Ok(benchmark) = scene.join("..").canonicalize() {
        for file in [&view.image, &view.mask] {
            if file
                .canonicalize()
                .is_ok_and(|file| !file.starts_with(&benchmark))
            {
                return Err(outside(json, "file_path", &frame.file_path));
            }
        }
    }
    Ok(view)
}

/// `name` as a path that leads down and nowhere else.
fn within(name: &str, field: &'static str, json: &Path) -> Result<PathBuf, StanfordOrbError> {
    let path = PathBuf::from(slashed(name));
    let mut down = PathBuf::new();
    for part in path.components() {
        match part {
            Component::Normal(part) => down.push(part),
            Component::CurDir => {}
            Component::Prefix(_) | Component::RootDir | Component::ParentDir => {
                return Err(outside(json, field, name));
            }
        }
    }
    match down.file_stem() {
        Some(_) => Ok(down),
        None => Err(outside(json, field, name)),
    }
}

fn outside(json: &Path, field: &'static str, name: &str) -> StanfordOrbError {
    StanfordOrbError::Outside {
        path: json.into(),
        field,
        name: name.into(),
    }
}

/// The photograph and its mask, averaged to the benchmark's resolution.
pub(super) fn photograph(view: &View) -> Result<(Image, Image), StanfordOrbError> {
    let present = |what, path: &Path, remedy| {
        if path.is_file() {
            return Ok(());
        }
        Err(StanfordOrbError::Missing {
            what,
            view: view.name.clone(),
            path: path.into(),
            remedy,
        })
    };
    present(
        "the photograph",
        &view.image,
        "scores are of high dynamic range: name a scene of blender_HDR",
    )?;
    present(
        "the mask",
        &view.mask,
        "masks lie beside the photographs' folder, in one named like it with _mask added",
    )?;
    let image = averaged(&read_image(&view.image, None)?.to_rgb(), &view.image)?;
    let mask = read_image(&view.mask, Some(ColorEncoding::Linear))?;
    let first = mask.data.iter().step_by(mask.channels).copied().collect();
    let mask = Image {
        channels: 1,
        data: first,
        ..mask
    };
    Ok((image, averaged(&mask, &view.mask)?))
}

/// The prediction of a view: linear from `.exr`, decoded from `.png`.
pub(super) fn prediction(folder: &Path, view: &View) -> Result<Image, StanfordOrbError> {
    let candidates =
        ["exr", "png"].map(|extension| folder.join(format!("{}.{extension}", view.name)));
    let Some(path) = candidates.iter().find(|path| path.is_file()) else {
        return Err(StanfordOrbError::Missing {
            what: "the prediction",
            view: view.name.clone(),
            path: candidates[0].clone(),
            remedy: "render every view of the split, as .exr (linear) or .png (sRGB)",
        });
    };
    let image = read_image(path, None)?.to_rgb();
    if [image.width, image.height] != [RESOLUTION; 2] {
        return Err(StanfordOrbError::Size {
            path: path.clone(),
            width: image.width,
            height: image.height,
            expected: format!("{RESOLUTION} × {RESOLUTION}"),
            remedy: "render at the benchmark's resolution",
        });
    }
    match image.data.iter().position(|v| !v.is_finite() || *v < 0.0) {
        None => Ok(image),
        Some(at) => Err(StanfordOrbError::Radiance {
            path: path.clone(),
            x: at / 3 % image.width,
            y: at / 3 / image.width,
            value: image.data[at],
        }),
    }
}

/// The mean over blocks that leaves the benchmark's resolution.
fn averaged(image: &Image, path: &Path) -> Result<Image, StanfordOrbError> {
    let parts = image.width / RESOLUTION;
    if parts == 0 || [image.width, image.height] != [RESOLUTION * parts; 2] {
        return Err(StanfordOrbError::Size {
            path: path.into(),
            width: image.width,
            height: image.height,
            expected: format!("{RESOLUTION} × {RESOLUTION} or a whole multiple"),
            remedy: "take the benchmark's own file",
        });
    }
    let mut mean = Image::filled(RESOLUTION, RESOLUTION, image.channels, 0.0);
    for y in 0..RESOLUTION {
        for x in 0..RESOLUTION {
            for channel in 0..image.channels {
                let rows = (0..parts).map(|row| {
                    let columns = (0..parts).map(|column| {
                        let pixel = image.pixel(parts * x + column, parts * y + row);
                        f64::from(pixel[channel])
                    });
                    columns.sum::<f64>()
                });
                let sum: f64 = rows.sum();
                mean.pixel_mut(x, y)[channel] = (sum / (parts * parts) as f64) as f32;
            }
        }
    }
    Ok(mean)
}
