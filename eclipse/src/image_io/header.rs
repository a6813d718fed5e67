//! What an image file says of its size, read without decoding what it holds.

use std::{
    fs::{self, File},
    io::{self, BufRead, BufReader, Cursor, Seek},
    path::Path,
};

use super::{ImageIoError, MAX_FILE, openexr, raster};

/// The size of an image that is not decoded yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Samples (pixels × channels) that decoding holds at once, of OpenEXR those of all its layers.
    pub samples: usize,
}

/// Reads the size that the image file `path` declares, by its header alone (a JPEG file is read whole, but not decoded).
///
/// # Errors
/// [`ImageIoError`], as [`read_image`](super::read_image) for the same header; what comes after it is not looked at.
pub fn read_size(path: &Path) -> Result<ImageSize, ImageIoError> {
    let failed = |source: io::Error| ImageIoError::Read {
        path: path.into(),
        source,
    };
    let metadata = fs::metadata(path).map_err(failed)?;
    // A pipe or a device would make its reader wait, or read for ever.
    if !metadata.is_file() || metadata.len() > MAX_FILE {
        let reason = format!("it is not a regular file of at most {MAX_FILE} bytes");
        return Err(failed(io::Error::other(reason)));
    }
    of(BufReader::new(File::open(path).map_err(failed)?), path)
}

/// [`read_size`] from bytes; `path` only names them in errors.
pub fn decode_size(bytes: &[u8], path: &Path) -> Result<ImageSize, ImageIoError> {
    of(Cursor::new(bytes), path)
}

fn of(mut source: impl BufRead + Seek, path: &Path) -> Result<ImageSize, ImageIoError> {
    let head = source.fill_buf().map_err(|source| ImageIoError::Read {
        path: path.into(),
        source,
    })?;
    if head.starts_with(&openexr::MAGIC) {
        openexr::size(source, path)
    } else {
        raster::size(source, path)
    }
}

#[cfg(test)]
mod tests {
    use render::image::Image;

    use super::*;
    use crate::image_io::{write_exr, write_png8};

    #[test]
    fn sizes_are_those_of_the_decoded_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_exr(
            &path("a.exr"),
            &Image::filled(7, 5, 3, 0.5),
            &["R", "G", "B"],
        )
        .unwrap();
        write_png8(&path("a.png"), &Image::filled(9, 4, 4, 0.5)).unwrap();
        for (name, width, height, samples) in [("a.exr", 7, 5, 105), ("a.png", 9, 4, 144)] {
            let expected = ImageSize {
                width,
                height,
                samples,
            };
            assert_eq!(read_size(&path(name)).unwrap(), expected, "{name}");
        }
    }

    #[test]
    fn what_is_no_image_is_refused_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| read_size(path).unwrap_err().to_string();
        assert!(refused(folder.path()).contains("not a regular file"));
        assert!(refused(&folder.path().join("none.png")).contains("none.png"));
        for (name, bytes) in [("a.png", &b"no image"[..]), ("a.exr", &openexr::MAGIC)] {
            let path = folder.path().join(name);
            fs::write(&path, bytes).unwrap();
            let message = refused(&path);
            assert!(
                message.contains(name) && message.contains("damaged"),
                "{message}"
            );
        }
    }
}
