//! A reconstruction on disk: which file holds what, each whole or not at all.

mod bake;
mod mesh;

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use render::{convention::Convention, image::Image};
use serde::Serialize;

use crate::{
    capture::Capture,
    files::{atomic, remedy},
    image_io::{ExrOptions, ImageIoError, Precision, write_exr_with},
    layout::{
        ALBEDO_SD, CONVENTION, ENVIRONMENT, ENVIRONMENT_SD, MATERIAL_CHANNELS, MATERIALS, MESH,
        METRICS, NETWORK, OCCLUDERS, OCCLUDERS_SD, RENDERS, REPORT, SETTINGS, numbered,
    },
    mesh_io::MeshIoError,
    reconstruction::{Reconstruction, Uncertainty},
    report::{self, ReportOptions},
};

/// Writes everything a run leaves to `folder`; the report comes last, and that of an earlier run goes before its files are mixed with
/// others, so that it is there when all else is.
///
/// Numbered images and a network of an earlier run that this one does not replace are removed.
///
/// # Errors
/// [`OutputError`], naming the file. Files written so far stay; none is left half-written.
pub fn write(
    folder: &Path,
    capture: &Capture,
    reconstruction: &Reconstruction,
    options: &ReportOptions,
) -> Result<(), OutputError> {
    prepare(folder)?;
    let map = ExrOptions {
        precision: Precision::Float,
        metadata: BTreeMap::from([(CONVENTION.to_owned(), Convention::Blender.name().to_owned())]),
    };
    let half = ExrOptions {
        precision: Precision::Half,
        ..Default::default()
    };
    let rgb = ["R", "G", "B"];
    write_exr_with(
        &folder.join(ENVIRONMENT),
        &reconstruction.environment,
        &rgb,
        &map,
    )?;
    remove(&folder.join(REPORT))?;
    write_numbered(
        &folder.join(OCCLUDERS),
        &reconstruction.occluders,
        &["Y"],
        &map,
    )?;
    write_numbered(
        &folder.join(MATERIALS),
        &reconstruction.materials,
        &MATERIAL_CHANNELS,
        &half,
    )?;
    write_numbered(&folder.join(RENDERS), &reconstruction.renders, &rgb, &half)?;
    write_uncertainty(folder, reconstruction.uncertainty.as_ref(), &map, &half)?;
    mesh::write(&folder.join(MESH), capture, reconstruction)?;
    match &reconstruction.network {
        Some(network) => write_bytes(
            &folder.join(format!("materials.{}", network.extension)),
            &network.bytes,
        )?,
        None => remove(&folder.join(NETWORK))?,
    }
    write_json(&folder.join(METRICS), &reconstruction.metrics)?;
    write_json(&folder.join(SETTINGS), &reconstruction.settings)?;
    let page = report::html(capture, reconstruction, options)?;
    write_bytes(&folder.join(REPORT), page.as_bytes())
}

/// Makes `folder` and shows that it can be written to, before hours of work depend on it.
///
/// # Errors
/// [`OutputError::Prepare`] with the system's reason.
pub fn prepare(folder: &Path) -> Result<(), OutputError> {
    let failed = |source| OutputError::Prepare {
        path: folder.to_owned(),
        source,
    };
    fs::create_dir_all(folder).map_err(failed)?;
    atomic::stage(&folder.join(SETTINGS), |_| Ok(())).map_err(failed)?;
    Ok(())
}

/// Standard deviations, in place of those of an earlier run.
fn write_uncertainty(
    folder: &Path,
    uncertainty: Option<&Uncertainty>,
    map: &ExrOptions,
    half: &ExrOptions,
) -> Result<(), OutputError> {
    let (path, rgb) = (folder.join(ENVIRONMENT_SD), ["R", "G", "B"]);
    let none = Uncertainty::default();
    match uncertainty {
        Some(uncertainty) => write_exr_with(&path, &uncertainty.environment, &rgb, map)?,
        None => remove(&path)?,
    }
    let Uncertainty {
        occluders, albedo, ..
    } = uncertainty.unwrap_or(&none);
    write_numbered(&folder.join(OCCLUDERS_SD), occluders, &["Y"], map)?;
    write_numbered(&folder.join(ALBEDO_SD), albedo, &rgb, half)
}

fn write_numbered(
    folder: &Path,
    images: &[Image],
    channels: &[&str],
    options: &ExrOptions,
) -> Result<(), OutputError> {
    let failed = |source| OutputError::Write {
        path: folder.to_owned(),
        source,
    };
    if !images.is_empty() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    for (index, image) in images.iter().enumerate() {
        write_exr_with(&folder.join(numbered(index)), image, channels, options)?;
    }
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(failed)?,
    };
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        let number = path
            .file_stem()
            .and_then(|stem| stem.to_str()?.parse::<usize>().ok());
        let exr = path.extension().is_some_and(|extension| extension == "exr");
        if exr && number.is_some_and(|number| number >= images.len()) {
            fs::remove_file(&path).map_err(failed)?;
        }
    }
    Ok(())
}

/// Removes a file that an earlier run may have left.
fn remove(path: &Path) -> Result<(), OutputError> {
    match fs::remove_file(path) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => Err(OutputError::Write {
            path: path.to_owned(),
            source,
        }),
        _ => Ok(()),
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), OutputError> {
    let failed = |source: serde_json::Error| OutputError::Write {
        path: path.to_owned(),
        source: source.into(),
    };
    let mut text = serde_json::to_vec_pretty(value).map_err(failed)?;
    text.push(b'\n');
    write_bytes(path, &text)
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    atomic::write(path, |file| io::Write::write_all(file, bytes)).map_err(|source| {
        OutputError::Write {
            path: path.to_owned(),
            source,
        }
    })
}

/// Why outputs could not be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The file system refused.
    #[error("cannot write {}: {source}; {}", path.display(), remedy(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The same before anything was done that could be continued.
    #[error("cannot write to {}: {source}; {}", path.display(), first_remedy(source))]
    Prepare {
        /// The folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// An image could not be encoded or written.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// The mesh could not be encoded or written.
    #[error(transparent)]
    Mesh(#[from] MeshIoError),
}

/// The same before there is anything to continue.
fn first_remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space, or choose another folder with --out"
        }
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => remedy(error),
        _ => "choose another folder with --out",
    }
}
