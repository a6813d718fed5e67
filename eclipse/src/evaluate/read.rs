//! The files an evaluation reads.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use render::image::Image;
use serde::{Deserialize, de::DeserializeOwned};

use super::{
    Estimate, EvaluateError, Truth,
    materials::{Specular, TrueAlbedo},
};
use crate::{
    capture::{self, CaptureError},
    files::read_limited,
    image_io::{EnvironmentOptions, read_environment, read_exr, read_exr_file, read_image},
    layout,
    reconstruction::Metrics,
};

/// Coverage from which a pixel counts as the object's: half floats round 1 no further than this.
const COVERED: f32 = 0.999;
/// Largest `metrics.json` or `truth.json` that is read, in bytes.
const MAX_JSON: u64 = 1 << 26;

/// Reads a run's outputs; only the environment must be there.
///
/// # Errors
/// A file that is missing or cannot be read.
pub fn estimate(folder: &Path) -> Result<Estimate, EvaluateError> {
    let environment = environment(&folder.join(layout::ENVIRONMENT))?;
    let mut materials = Vec::new();
    for path in images(&folder.join(layout::MATERIALS), "")? {
        let file = read_exr_file(&path)?;
        materials.push(
            file.select(&layout::MATERIAL_CHANNELS)
                .unwrap_or(file.image),
        );
    }
    let masks = images(&folder.join(layout::OCCLUDERS), "")?;
    let occluders = masks
        .iter()
        .map(|path| read_exr(path).map(|mask| first_channel(&mask)))
        .collect::<Result<_, _>>()?;
    Ok(Estimate {
        environment,
        occluders,
        materials,
        metrics: metrics(folder)?,
    })
}

/// What a run said of itself; of an older run it may be nothing.
///
/// # Errors
/// A file that cannot be read.
pub fn metrics(folder: &Path) -> Result<Metrics, EvaluateError> {
    Ok(json(&folder.join(layout::METRICS), parse_metrics)?.unwrap_or_default())
}

/// Reads a capture's truth, whatever there is of it: from the folder that holds it, or from the capture that holds that.
///
/// # Errors
/// A file that cannot be read, or a folder without any truth.
pub fn truth(folder: &Path) -> Result<Truth, EvaluateError> {
    let within = folder.join("truth");
    match truth_in(folder) {
        Err(EvaluateError::NoTruth { .. }) if within.is_dir() => truth_in(&within),
        found => found,
    }
}

fn truth_in(folder: &Path) -> Result<Truth, EvaluateError> {
    let environment = optional(&folder.join(layout::ENVIRONMENT), environment)?;
    let occluders = optional(&folder.join("occluders.exr"), |path| Ok(read_exr(path)?))?;
    let occluders = occluders.map(|stack| unstack(&first_channel(&stack)));
    let images = images(folder, "albedo_")?;
    let coverage = match images.is_empty() {
        true => Vec::new(),
        false => coverage(folder)?,
    };
    let mut albedo = Vec::new();
    for (index, path) in images.iter().enumerate() {
        let image = read_exr(path)?;
        let photograph = coverage.get(index).and_then(Option::as_ref);
        let photograph = photograph.map(|path| read_image(path, None)).transpose()?;
        let object = object(&image, photograph.as_ref());
        albedo.push(TrueAlbedo {
            albedo: image.to_rgb(),
            object,
        });
    }
    let specular = json(&folder.join("truth.json"), parse_specular)?;
    if environment.is_none() && occluders.is_none() && albedo.is_empty() && specular.is_none() {
        return Err(EvaluateError::NoTruth {
            path: folder.to_owned(),
        });
    }
    Ok(Truth {
        environment,
        occluders,
        albedo,
        specular: specular.flatten(),
    })
}

/// Parses a run's `metrics.json`; `path` only names it in errors.
///
/// # Errors
/// [`EvaluateError::Json`] says what is wrong where.
pub fn parse_metrics(bytes: &[u8], path: &Path) -> Result<Metrics, EvaluateError> {
    parse(bytes, path)
}

/// The specular lobe of a `truth.json`, if there is one; `path` only names it in errors.
///
/// # Errors
/// As [`parse_metrics`].
pub fn parse_specular(bytes: &[u8], path: &Path) -> Result<Option<Specular>, EvaluateError> {
    let Scene { bsdf, alpha, kappa } = parse(bytes, path)?;
    let specular = alpha.zip(kappa).filter(|_| bsdf != "lambert");
    Ok(specular.map(|(alpha, kappa)| Specular { alpha, kappa }))
}

/// The scalars of `truth.json` that are compared.
#[derive(Deserialize)]
struct Scene {
    bsdf: String,
    alpha: Option<f64>,
    kappa: Option<f64>,
}

/// The capture's photographs, whose alpha says which pixels are the object's: of each frame, where it is there.
fn coverage(truth: &Path) -> Result<Vec<Option<PathBuf>>, EvaluateError> {
    match capture::photographs(&truth.join("..")) {
        // A truth may lie anywhere; and what lies outside of a capture is not looked into.
        Err(
            CaptureError::NoFormat { .. }
            | CaptureError::Outside { .. }
            | CaptureError::Linked { .. },
        ) => Ok(Vec::new()),
        found => Ok(found?),
    }
}

/// Object pixels: by the albedo's own alpha, else the photograph's, else those that are not black.
fn object(albedo: &Image, photograph: Option<&Image>) -> Vec<bool> {
    let with_alpha = |image: &&Image| {
        image.channels.is_multiple_of(2)
            && (image.width, image.height) == (albedo.width, albedo.height)
    };
    match [Some(albedo), photograph]
        .into_iter()
        .flatten()
        .find(with_alpha)
    {
        Some(image) => image
            .data
            .chunks_exact(image.channels)
            .map(|pixel| pixel[image.channels - 1] >= COVERED)
            .collect(),
        None => albedo
            .data
            .chunks_exact(albedo.channels)
            .map(|pixel| pixel.iter().any(|&v| v > 0.0))
            .collect(),
    }
}

/// Maps stacked one below the other, each twice as wide as high.
fn unstack(stack: &Image) -> Vec<Image> {
    let height = (stack.width / 2).max(1);
    let maps = stack
        .data
        .chunks_exact(height * stack.width * stack.channels);
    maps.map(|data| Image {
        height,
        data: data.to_vec(),
        ..*stack
    })
    .collect()
}

/// EXR files of `folder` whose names start with `prefix`, by name; none when there is no such folder.
fn images(folder: &Path, prefix: &str) -> Result<Vec<PathBuf>, EvaluateError> {
    let failed = |source| EvaluateError::Read {
        path: folder.to_owned(),
        source,
    };
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(failed)?,
    };
    let mut paths = Vec::new();
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !name.starts_with('.') && name.starts_with(prefix) && name.ends_with(".exr") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// What masks have to say, whatever they are stored as.
fn first_channel(image: &Image) -> Image {
    let values = image.data.iter().step_by(image.channels);
    Image {
        channels: 1,
        data: values.copied().collect(),
        ..*image
    }
}

/// A map of light in our convention, whichever its file names.
fn environment(path: &Path) -> Result<Image, EvaluateError> {
    let map = read_environment(path, &EnvironmentOptions::default())?;
    Ok(map.image().clone())
}

/// What `read` makes of a file, if it is there.
fn optional<T>(
    path: &Path,
    read: impl FnOnce(&Path) -> Result<T, EvaluateError>,
) -> Result<Option<T>, EvaluateError> {
    path.exists().then(|| read(path)).transpose()
}

/// What `parse` makes of a text file, if it is there.
fn json<T>(
    path: &Path,
    parse: impl FnOnce(&[u8], &Path) -> Result<T, EvaluateError>,
) -> Result<Option<T>, EvaluateError> {
    match read_limited(path, MAX_JSON) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(EvaluateError::Read {
            path: path.to_owned(),
            source,
        }),
        Ok(bytes) => parse(&bytes, path).map(Some),
    }
}

fn parse<T: DeserializeOwned>(bytes: &[u8], path: &Path) -> Result<T, EvaluateError> {
    serde_json::from_slice(bytes).map_err(|source| EvaluateError::Json {
        path: path.to_owned(),
        source,
    })
}
