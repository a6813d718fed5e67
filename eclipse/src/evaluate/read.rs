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
    image_io::{read_exr, read_exr_file, read_image},
    layout,
};

/// Coverage from which a pixel counts as the object's: half floats round 1 no further than this.
const COVERED: f32 = 0.999;

/// Reads a run's outputs; only the environment must be there.
///
/// # Errors
/// A file that is missing or cannot be read.
pub fn estimate(folder: &Path) -> Result<Estimate, EvaluateError> {
    let environment = colour(&folder.join(layout::ENVIRONMENT))?;
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
        .map(|path| read_exr(path))
        .collect::<Result<_, _>>()?;
    let metrics = json(&folder.join(layout::METRICS))?.unwrap_or_default();
    Ok(Estimate {
        environment,
        occluders,
        materials,
        metrics,
    })
}

/// Reads a capture's truth, whatever there is of it.
///
/// # Errors
/// A file that cannot be read, or a folder without any truth.
pub fn truth(folder: &Path) -> Result<Truth, EvaluateError> {
    let environment = optional(&folder.join("environment.exr"))?;
    let occluders = optional(&folder.join("occluders.exr"))?.map(|stack| unstack(&stack));
    let coverage = coverage(folder)?;
    let mut albedo = Vec::new();
    for (index, path) in images(folder, "albedo_")?.iter().enumerate() {
        let image = colour(path)?;
        let photograph = coverage
            .get(index)
            .map(|path| read_image(path, None))
            .transpose()?;
        let object = object(&image, photograph.as_ref());
        albedo.push(TrueAlbedo {
            albedo: image,
            object,
        });
    }
    let scene: Option<Scene> = json(&folder.join("truth.json"))?;
    if environment.is_none() && occluders.is_none() && albedo.is_empty() && scene.is_none() {
        return Err(EvaluateError::NoTruth {
            path: folder.to_owned(),
        });
    }
    let specular = scene.filter(|scene| scene.bsdf != "lambert");
    let specular = specular.and_then(|scene| {
        Some(Specular {
            alpha: scene.alpha?,
            kappa: scene.kappa?,
        })
    });
    Ok(Truth {
        environment,
        occluders,
        albedo,
        specular,
    })
}

/// The scalars of `truth.json` that are compared.
#[derive(Deserialize)]
struct Scene {
    bsdf: String,
    alpha: Option<f64>,
    kappa: Option<f64>,
}

/// The part of `transforms.json` that names the photographs.
#[derive(Deserialize)]
struct Transforms {
    frames: Vec<TransformsFrame>,
}

#[derive(Deserialize)]
struct TransformsFrame {
    file_path: PathBuf,
}

/// The capture's photographs, whose alpha says which pixels are the object's.
fn coverage(truth: &Path) -> Result<Vec<PathBuf>, EvaluateError> {
    let capture = truth.join("..");
    let transforms: Option<Transforms> = json(&capture.join("transforms.json"))?;
    let frames = transforms
        .into_iter()
        .flat_map(|transforms| transforms.frames);
    Ok(frames
        .map(|frame| capture.join(frame.file_path))
        .filter(|path| path.is_file())
        .collect())
}

/// Object pixels: by the albedo's own alpha, else the photograph's, else those that are not black.
fn object(albedo: &Image, photograph: Option<&Image>) -> Vec<bool> {
    let with_alpha = |image: &&Image| {
        image.channels == 4 && (image.width, image.height) == (albedo.width, albedo.height)
    };
    match [Some(albedo), photograph]
        .into_iter()
        .flatten()
        .find(with_alpha)
    {
        Some(image) => image
            .data
            .chunks_exact(4)
            .map(|pixel| pixel[3] >= COVERED)
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

/// An image with three channels at least: grey ones are repeated.
fn colour(path: &Path) -> Result<Image, EvaluateError> {
    let image = read_exr(path)?;
    if image.channels >= 3 {
        return Ok(image);
    }
    let data = image
        .data
        .chunks_exact(image.channels)
        .flat_map(|pixel| [pixel[0]; 3])
        .collect();
    Ok(Image {
        channels: 3,
        data,
        ..image
    })
}

fn optional(path: &Path) -> Result<Option<Image>, EvaluateError> {
    if path.exists() {
        Ok(Some(colour(path)?))
    } else {
        Ok(None)
    }
}

fn json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, EvaluateError> {
    match fs::read(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(EvaluateError::Read {
            path: path.to_owned(),
            source,
        }),
        Ok(bytes) => {
            serde_json::from_slice(&bytes)
                .map(Some)
                .map_err(|source| EvaluateError::Json {
                    path: path.to_owned(),
                    source,
                })
        }
    }
}
