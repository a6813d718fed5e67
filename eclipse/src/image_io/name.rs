//! What image files are called.

/// Endings of image files that are read, upper or lower case; others belong to the name, as in `view.001`.
pub const EXTENSIONS: [&str; 5] = ["exr", "hdr", "png", "jpg", "jpeg"];

/// A file's path without the ending of an image; folders are told by `/`.
pub fn stem(path: &str) -> &str {
    let split = path.rsplit_once('.');
    match split.filter(|(_, end)| EXTENSIONS.contains(&&*end.to_ascii_lowercase())) {
        Some((stem, _)) if !stem.is_empty() && !stem.ends_with('/') => stem,
        _ => path,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_ending_of_an_image_is_taken_off() {
        for (path, expected) in [
            ("train/r_1.png", "train/r_1"),
            ("a.EXR", "a"),
            ("view.001", "view.001"),
            ("view.001.JPG", "view.001"),
            ("a.b/c", "a.b/c"),
            (".exr", ".exr"),
            ("a/.exr", "a/.exr"),
            ("a", "a"),
        ] {
            assert_eq!(stem(path), expected);
        }
    }
}
