//! Files that appear whole or not at all: written beside their place, flushed, then renamed.

use std::{fs::File, io, path::Path};

use tempfile::{Builder, NamedTempFile};

/// How the names of files begin that are being written.
pub(super) const PREFIX: &str = ".writing-";

/// Writes `path` through `write`, whole or not at all.
///
/// # Errors
/// Whatever `write` or the file system says; an earlier file of that name is untouched then.
pub fn write(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    stage(path, write)?.persist(path)?;
    Ok(())
}

/// Writes a file next to `path` that takes its place with `persist`, and is removed when dropped.
///
/// # Errors
/// As [`write()`].
pub fn stage(
    path: &Path,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<NamedTempFile> {
    let mut staged = Builder::new().prefix(PREFIX).tempfile_in(folder(path))?;
    write(staged.as_file_mut())?;
    staged.as_file().sync_all()?;
    open_to_readers(staged.as_file())?;
    Ok(staged)
}

/// The folder `path` lies in.
fn folder(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
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
