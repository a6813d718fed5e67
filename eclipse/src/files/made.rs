//! Folders that are made for results, and go again where there are none.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use super::lock::{Lock, LockError};

/// How many times a folder is made that another run takes away as it ends.
const ATTEMPTS: usize = 100;

/// A folder to write to, held by one run. When it is dropped, what was made of it and is still empty is removed.
#[derive(Debug)]
pub struct MadeFolder {
    /// `None` once it was given back.
    lock: Option<Lock>,
    /// What was not there before, the innermost first.
    made: Vec<PathBuf>,
}

impl MadeFolder {
    /// Makes the folder and takes it.
    ///
    /// # Errors
    /// [`LockError::Held`] when another run has it, [`LockError::Io`] with the folder's own path where it cannot be made.
    pub fn make(folder: &Path) -> Result<Self, LockError> {
        let parts = folder
            .ancestors()
            .filter(|path| !path.as_os_str().is_empty());
        let mut taken = Self {
            lock: None,
            made: parts
                .take_while(|path| !path.exists())
                .map(Path::to_path_buf)
                .collect(),
        };
        for _ in 0..ATTEMPTS {
            match lock(folder) {
                // Another run that left nothing has removed the folder in between.
                Err(LockError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {}
                lock => {
                    taken.lock = Some(lock?);
                    return Ok(taken);
                }
            }
        }
        taken.lock = Some(lock(folder)?);
        Ok(taken)
    }
}

fn lock(folder: &Path) -> Result<Lock, LockError> {
    fs::create_dir_all(folder).map_err(|source| LockError::Io {
        path: folder.to_owned(),
        source,
    })?;
    Lock::acquire(folder)
}

impl Drop for MadeFolder {
    fn drop(&mut self) {
        // Before the folder: a lock's file is removed while it is held, and only then the folder can be empty. Whoever takes the
        // folder meanwhile puts their own file there, which keeps it.
        self.lock = None;
        for folder in &self.made {
            if fs::remove_dir(folder).is_err() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_made_and_stays_empty_goes() {
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("a/b/c");
        drop(MadeFolder::make(&folder).unwrap());
        assert!(base.path().is_dir() && !base.path().join("a").exists());

        fs::create_dir(base.path().join("a")).unwrap();
        drop(MadeFolder::make(&folder).unwrap());
        assert!(base.path().join("a").is_dir() && !base.path().join("a/b").exists());

        let made = MadeFolder::make(&folder).unwrap();
        fs::write(folder.join("result"), "").unwrap();
        drop(made);
        assert!(folder.join("result").is_file());
        // What an earlier run left is not this one's to remove.
        fs::remove_file(folder.join("result")).unwrap();
        drop(MadeFolder::make(&folder).unwrap());
        assert!(folder.is_dir());

        fs::write(base.path().join("file"), "").unwrap();
        let refused = MadeFolder::make(&base.path().join("file/a"));
        assert!(matches!(refused, Err(LockError::Io { .. })));
        assert!(base.path().join("file").is_file());
    }

    #[test]
    fn two_runs_are_kept_apart() {
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("a/b");
        let first = MadeFolder::make(&folder).unwrap();
        assert!(matches!(
            MadeFolder::make(&folder),
            Err(LockError::Held { .. })
        ));
        // The refused one takes nothing away from the first.
        assert!(folder.is_dir());
        drop(first);
        assert!(!base.path().join("a").exists());
    }

    #[test]
    fn runs_that_leave_nothing_do_not_trip_over_each_other() {
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("a/b");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        // Held by another is an answer; a folder that went away is none.
                        let made = MadeFolder::make(&folder);
                        assert!(
                            matches!(made, Ok(_) | Err(LockError::Held { .. })),
                            "{made:?}"
                        );
                    }
                });
            }
        });
        // A folder that one made while another wrote to it may stay; nothing else does.
        assert!(!folder.join(".lock").exists());
    }
}
