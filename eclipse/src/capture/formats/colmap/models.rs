//! Which of a capture's models is meant: COLMAP writes one for each group of photographs that it could join.

use std::{
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
};

use super::{Encoding, file, read_file, text};
use crate::capture::paths::Folder;

/// A model, and what to say of its choice where there were several.
pub(super) struct Chosen {
    pub place: PathBuf,
    pub encoding: Encoding,
    pub note: Option<String>,
}

/// The model of a capture: of those that are numbered in `sparse`, the one with the most images; else that in `sparse` or in the folder
/// itself.
pub(super) fn choose(folder: &Folder) -> Option<Chosen> {
    let sparse = folder.path().join("sparse");
    let numbered: Vec<(PathBuf, Encoding)> = numbered(&sparse)
        .into_iter()
        .filter_map(|place| Some((encoding_in(&place)?, place)))
        .map(|(encoding, place)| (place, encoding))
        .collect();
    match &*numbered {
        [] => {
            let places = [sparse, folder.path().into()];
            places.into_iter().find_map(|place| {
                Some(Chosen {
                    encoding: encoding_in(&place)?,
                    place,
                    note: None,
                })
            })
        }
        [(place, encoding)] => Some(Chosen {
            place: place.clone(),
            encoding: *encoding,
            note: None,
        }),
        several => Some(largest(folder, several)),
    }
}

/// The folders in `sparse` that are called by a number, in that order.
fn numbered(sparse: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(sparse).into_iter().flatten().flatten();
    let number = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let mut found: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| Some((number(&entry.path())?, entry.path())))
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

fn encoding_in(place: &Path) -> Option<Encoding> {
    let is_there = |encoding: &Encoding| file(place, "images", *encoding).is_file();
    Encoding::ALL.into_iter().find(is_there)
}

/// The model with the most images, the first of those with as many, and what to say of it.
fn largest(folder: &Folder, models: &[(PathBuf, Encoding)]) -> Chosen {
    let images: Vec<u64> = models
        .iter()
        .map(|(place, encoding)| registered(folder, place, *encoding).unwrap_or(0))
        .collect();
    let most = images.iter().copied().max().unwrap_or(0);
    let chosen = images.iter().position(|&count| count == most).unwrap_or(0);
    let name = |index: usize| {
        let (place, _) = &models[index];
        let within = place.strip_prefix(folder.path()).unwrap_or(place);
        within.display().to_string()
    };
    let others = (0..models.len()).filter(|&index| index != chosen);
    let others = others.map(|index| format!("{} has {}", name(index), images[index]));
    let note = format!(
        "of {} COLMAP models the one in {} is used, which has the most registered images, {most}; {}: merge them in COLMAP, or remove \
         what is not meant",
        models.len(),
        name(chosen),
        others.collect::<Vec<_>>().join(", ")
    );
    let (place, encoding) = models[chosen].clone();
    Chosen {
        place,
        encoding,
        note: Some(note),
    }
}

/// How many images a model says that it has; of one that cannot be read nothing, which whoever reads it tells of.
fn registered(folder: &Folder, place: &Path, encoding: Encoding) -> Option<u64> {
    let path = file(place, "images", encoding);
    folder.check_own(&path).ok()?;
    match encoding {
        Encoding::Binary => {
            let mut count = [0; 8];
            File::open(&path).ok()?.read_exact(&mut count).ok()?;
            Some(u64::from_le_bytes(count))
        }
        Encoding::Text => {
            let images = text::images(&read_file(&path).ok()?).ok()?;
            Some(images.len() as u64)
        }
    }
}
