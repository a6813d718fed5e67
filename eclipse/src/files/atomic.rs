//! Files and folders that appear whole or not at all: written beside their place, then renamed.

use std::{
    fs::{self, File},
    io,
    path::Path,
};

use tempfile::{Builder, NamedTempFile, TempDir};

use super::folder_of;

/// How the names of files begin that are being written.
pub(super) const PREFIX: &str = ".writing-";
/// Letters and digits at the end of such a folder's name.
const RANDOM: usize = 6;

/// Writes `path` through `write`, whole or not at all.
///
/// # Errors
/// Whatever `write` or the file system says; an earlier file of that name is untouched then.
pub fn write(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    persist(stage(path, write)?, path)
}

/// Writes a file next to `path` that takes its place with `persist`, and is removed when dropped.
///
/// # Errors
/// As [`write()`].
pub fn stage(
    path: &Path,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<NamedTempFile> {
    let mut staged = Builder::new().prefix(PREFIX).tempfile_in(folder_of(path))?;
    write(staged.as_file_mut())?;
    staged.as_file().sync_all()?;
    open_to_readers(staged.as_file())?;
    Ok(staged)
}

/// Gives a [`stage`]d file its place, and its folder's list of names to the disk: or a power cut might bring back what was there.
///
/// # Errors
/// Whatever the file system says; an earlier file of that name is untouched then.
pub fn persist(staged: NamedTempFile, path: &Path) -> io::Result<()> {
    staged.persist(path)?;
    // The file is whole and in its place by now: a file system that cannot do more for it is no error.
    #[cfg(unix)]
    let _ = File::open(folder_of(path)).and_then(|folder| folder.sync_all());
    Ok(())
}

/// Makes a folder next to `path`, to be renamed to it; it is removed when dropped.
///
/// # Errors
/// Whatever the file system says.
pub fn stage_folder(path: &Path) -> io::Result<TempDir> {
    let prefix = prefix(path);
    let mut builder = Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    // Temporary folders are private by default; what comes of this one is an ordinary folder.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o755));
    }
    builder.tempdir_in(folder_of(path))
}

/// Removes folders that killed runs left next to `path` when they were about to write it.
pub(super) fn sweep_folders(path: &Path) -> io::Result<()> {
    let prefix = prefix(path);
    for entry in fs::read_dir(folder_of(path))? {
        let entry = entry?;
        let name = entry.file_name();
        // The longer name of another folder does not end in so few letters and digits.
        let stale = name
            .to_str()
            .and_then(|name| name.strip_prefix(&prefix))
            .is_some_and(|rest| {
                rest.len() == RANDOM && rest.bytes().all(|byte| byte.is_ascii_alphanumeric())
            });
        if stale && entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

/// How the names of folders begin that are to become `path`: others may be written beside it at the same time.
fn prefix(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!("{PREFIX}{name}-")
}

/// Temporary files are private to their owner; outputs are readable like any other file.
#[cfg(unix)]
fn open_to_readers(file: &File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn open_to_readers(_file: &File) -> io::Result<()> {
    Ok(())
}
