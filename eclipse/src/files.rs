//! Reading files that a stranger may have made.

pub mod atomic;
pub mod json;
pub mod lock;
pub mod made;

use std::{
    fs::{self, File},
    io::{self, Read},
    path::Path,
};

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// Devices, pipes and folders are refused, so that a capture cannot make a reader wait or swallow memory for ever.
pub fn read_limited(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let metadata = fs::metadata(path)?;
    if !metadata.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    if metadata.len() > limit {
        return Err(io::Error::other(format!(
            "it has {} bytes, more than the {limit} allowed",
            metadata.len()
        )));
    }
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    // A file may grow between the two calls: the limit is enforced on what is read as well.
    File::open(path)?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// A path that a file gives, with its folders by `/`: files made on Windows may carry its separators.
pub fn slashed(path: &str) -> String {
    path.replace('\\', "/")
}

/// The folder that `path` lies in: the present one, where it is a name alone.
pub fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// What to do about a write that failed.
pub fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space, then continue with --resume"
        }
        io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied => {
            "choose another folder with --out"
        }
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
            "a file is in the way: choose another folder with --out"
        }
        _ => "check the folder, then continue with --resume",
    }
}

/// Makes the folder `path`, or takes one that holds the file `marker`, by which earlier results of the same kind are known.
///
/// Returns whether it is one's own: `false` when it holds anything else, which must not be written over.
///
/// # Errors
/// A folder that can be neither made nor listed.
pub fn claim(path: &Path, marker: &str) -> io::Result<bool> {
    fs::create_dir_all(path)?;
    if path.join(marker).is_file() {
        return Ok(true);
    }
    for entry in fs::read_dir(path)? {
        let name = entry?.file_name();
        // A run that is about to begin, or was killed then, has left no more than this.
        let is_ours = name == lock::NAME || name.to_string_lossy().starts_with(atomic::PREFIX);
        if !is_ours {
            return Ok(false);
        }
    }
    Ok(true)
}
