//! One writer a folder: two runs that write to one place would mix their results.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, Read, Seek, Write},
    path::{Path, PathBuf},
};

use super::atomic::{PREFIX, sweep_folders};
use crate::layout::{ALBEDO_SD, MAPS, MATERIALS, OCCLUDERS, OCCLUDERS_SD, RENDERS};

/// The file that is locked. A killed run leaves it, which does no harm: only the lock on it means anything, and the system gives
/// that back however a run ends.
pub(super) const NAME: &str = ".lock";

/// The right to write to a folder, until it is dropped.
#[derive(Debug)]
pub struct Lock {
    file: File,
    /// The file goes with the lock.
    path: PathBuf,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Removed while it is still held: whoever waits finds that the file they opened is gone.
        let _ = fs::remove_file(&self.path);
        let _ = self.file.unlock();
    }
}

impl Lock {
    /// Takes the folder, which must be there; what a run left half-written when it was killed is removed.
    ///
    /// On a file system that knows no locks there is none, and no harm in it for whoever runs one at a time.
    ///
    /// # Errors
    /// [`LockError::Held`] when another run has it.
    pub fn acquire(folder: &Path) -> Result<Self, LockError> {
        let lock = Self::take(folder, folder.join(NAME))?;
        sweep(folder).map_err(|source| LockError::Io {
            path: folder.join(NAME),
            source,
        })?;
        Ok(lock)
    }

    /// Takes the name of a folder that is not there yet, and whose parent is made: by a file beside it, which is removed at the
    /// end. What a run that was to make it left when it was killed is removed.
    ///
    /// # Errors
    /// As [`acquire`](Self::acquire).
    pub fn beside(folder: &Path) -> Result<Self, LockError> {
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let path = folder.with_file_name(format!(".{name}.lock"));
        let failed = |source| LockError::Io {
            path: path.clone(),
            source,
        };
        if let Some(parent) = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
        {
            fs::create_dir_all(parent).map_err(failed)?;
        }
        let lock = Self::take(folder, path.clone())?;
        sweep_folders(folder).map_err(failed)?;
        Ok(lock)
    }

    fn take(folder: &Path, path: PathBuf) -> Result<Self, LockError> {
        loop {
            let lock = Self::once(folder, path.clone())?;
            // The file that was opened may have been removed by its owner before it was locked.
            if same(&lock.file, &path) {
                return Ok(lock);
            }
        }
    }

    fn once(folder: &Path, path: PathBuf) -> Result<Self, LockError> {
        let failed = |source| LockError::Io {
            path: path.clone(),
            source,
        };
        let options = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path);
        let mut file = options.map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut owner = String::new();
                // Whose lock it is only helps to find them.
                let _ = file.take(20).read_to_string(&mut owner);
                return Err(LockError::Held {
                    folder: folder.to_owned(),
                    owner: owner.trim().parse().ok(),
                });
            }
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        let owner = format!("{}\n", std::process::id());
        let named = file.set_len(0).and_then(|()| {
            file.rewind()?;
            file.write_all(owner.as_bytes())
        });
        // The number only helps people; on a full disk the lock holds without.
        let _ = named;
        Ok(Self { file, path })
    }
}

/// Whether `path` names the file that was opened.
#[cfg(unix)]
fn same(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let number = |metadata: io::Result<fs::Metadata>| metadata.map(|m| (m.dev(), m.ino())).ok();
    number(file.metadata()) == number(fs::metadata(path))
}

/// Elsewhere a file that is open cannot be removed.
#[cfg(not(unix))]
fn same(_file: &File, _path: &Path) -> bool {
    true
}

/// Removes files that were being written, here and in the folders of a run's images.
///
/// Other folders may have a writer of their own.
fn sweep(folder: &Path) -> io::Result<()> {
    let inner = [ALBEDO_SD, MAPS, MATERIALS, OCCLUDERS, OCCLUDERS_SD, RENDERS]
        .map(|name| folder.join(name));
    for folder in [folder.to_owned()].into_iter().chain(inner) {
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            entries => entries?,
        };
        for entry in entries {
            let entry = entry?;
            let written = entry.file_name().to_string_lossy().starts_with(PREFIX);
            if written && entry.file_type()?.is_file() {
                fs::remove_file(entry.path())?;
            }
        }
    }
    Ok(())
}

/// Why a folder could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another run writes to it.
    #[error(
        "{} is being written by another run{}; wait for it to end, or choose another folder with --out",
        folder.display(),
        owner.map_or(String::new(), |id| format!(" (process {id})"))
    )]
    Held {
        /// The folder.
        folder: PathBuf,
        /// The process that has it, where it could be read.
        owner: Option<u32>,
    },
    /// The file system refused.
    #[error("cannot take {}: {source}; choose another folder with --out", path.display())]
    Io {
        /// The file that is locked.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_writer_and_is_free_again_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let held = Lock::acquire(folder.path()).unwrap();
        let error = Lock::acquire(folder.path()).unwrap_err().to_string();
        let own = format!("(process {})", std::process::id());
        assert!(
            error.contains("another run") && error.contains(&own),
            "{error}"
        );
        drop(held);
        Lock::acquire(folder.path()).unwrap();
    }

    #[test]
    fn a_name_has_one_writer_and_no_file_stays_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/capture");
        let held = Lock::beside(&path).unwrap();
        let error = Lock::beside(&path).unwrap_err().to_string();
        assert!(error.contains("another run"), "{error}");
        drop(Lock::beside(&folder.path().join("new/other")).unwrap());
        drop(held);
        drop(Lock::beside(&path).unwrap());
        assert_eq!(fs::read_dir(folder.path().join("new")).unwrap().count(), 0);
    }

    #[test]
    fn what_was_half_written_is_swept_away_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".writing-a"), "x").unwrap();
        let inner = ["renders", "maps"].map(|name| folder.path().join(name));
        for inner in &inner {
            fs::create_dir(inner).unwrap();
            fs::write(inner.join(".writing-b"), "x").unwrap();
            fs::write(inner.join("000.exr"), "x").unwrap();
        }
        Lock::acquire(folder.path()).unwrap();
        assert!(!folder.path().join(".writing-a").exists());
        for inner in &inner {
            assert!(!inner.join(".writing-b").exists() && inner.join("000.exr").exists());
        }
    }

    #[test]
    fn a_folder_that_a_killed_run_was_making_is_swept_away_and_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("made");
        // Killed: what drops is not run.
        let stale = super::super::atomic::stage_folder(&path).unwrap().keep();
        fs::write(stale.join("000.exr"), "x").unwrap();
        let others = ["made-too", "ma", "other"]
            .map(|name| super::super::atomic::stage_folder(&folder.path().join(name)).unwrap());
        drop(Lock::beside(&path).unwrap());
        assert!(!stale.exists());
        assert!(others.iter().all(|other| other.path().is_dir()));
    }
}
