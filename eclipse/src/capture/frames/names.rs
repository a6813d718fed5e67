//! What frames are called, by their `file_path`.

use std::{
    collections::HashSet,
    path::{Component, Path},
};

use crate::{
    capture::{CaptureError, transforms::TransformsFrame},
    files::slashed,
    image_io::stem,
};

/// What makes a name of the parts of a path.
type Way<'a> = &'a dyn Fn(&[String]) -> String;

/// The frames' names: file names without the ending of an image or, where those repeat, paths with `_` between folders; with the
/// ending where even those repeat, as of `a.png` beside `a.jpg`.
pub(super) fn of(json: &Path, entries: &[TransformsFrame]) -> Result<Vec<String>, CaptureError> {
    let paths: Vec<Vec<String>> = entries
        .iter()
        .map(|entry| parts(&entry.file_path))
        .collect();
    if let Some(index) = paths.iter().position(Vec::is_empty) {
        return Err(CaptureError::NamelessFrame {
            path: json.into(),
            index,
            file_path: entries[index].file_path.clone(),
        });
    }
    let last = |path: &[String]| path.last().cloned().unwrap_or_default();
    let joined = |path: &[String]| path.join("_");
    let bare = |name: String| stem(&name).to_owned();
    let ways: [Way<'_>; 4] = [
        &|path| bare(last(path)),
        &|path| bare(joined(path)),
        &last,
        &joined,
    ];
    let mut fault = 0;
    for way in ways {
        let names: Vec<String> = paths.iter().map(|path| way(path)).collect();
        match at_fault(&names) {
            None => return Ok(names),
            Some(index) => fault = index,
        }
    }
    Err(CaptureError::DuplicateFrame {
        path: json.into(),
        file_path: entries[fault].file_path.clone(),
    })
}

/// The folders of a path and its file, whatever it begins with.
fn parts(file_path: &str) -> Vec<String> {
    let path = slashed(file_path);
    let parts = Path::new(&path).components().filter_map(|part| match part {
        Component::Normal(part) => Some(part.to_string_lossy().into_owned()),
        _ => None,
    });
    parts.collect()
}

/// The first name that is none, or that an earlier frame has.
fn at_fault(names: &[String]) -> Option<usize> {
    let mut seen = HashSet::new();
    names
        .iter()
        .position(|name| name.is_empty() || !seen.insert(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(file_paths: &[&str]) -> Result<Vec<String>, String> {
        let entry = |file_path: &&str| TransformsFrame {
            file_path: (*file_path).to_owned(),
            ..TransformsFrame::default()
        };
        let entries: Vec<_> = file_paths.iter().map(entry).collect();
        of(Path::new("transforms.json"), &entries).map_err(|error| error.to_string())
    }

    #[test]
    fn dots_of_a_name_that_end_no_image_belong_to_it() {
        let found = names(&["./images/view.001", "images/view.002", "a.b.JPG"]).unwrap();
        assert_eq!(found, ["view.001", "view.002", "a.b"]);
    }

    #[test]
    fn names_are_as_long_as_they_must_be() {
        let found = names(&["train\\r_0.png", "test/r_0.png"]).unwrap();
        assert_eq!(found, ["train_r_0", "test_r_0"]);
        let found = names(&["images/a.png", "./images/a.jpg"]).unwrap();
        assert_eq!(found, ["a.png", "a.jpg"]);
        let found = names(&["x/a.png", "x/a.jpg", "y/a.png"]).unwrap();
        assert_eq!(found, ["x_a.png", "x_a.jpg", "y_a.png"]);
    }

    #[test]
    fn one_file_cannot_be_two_frames_and_no_file_none() {
        let error = names(&["b.png", "a.png", "./a.png"]).unwrap_err();
        assert!(error.contains("names \"./a.png\" twice"), "{error}");
        let error = names(&["a.png", ""]).unwrap_err();
        assert!(
            error.contains("`frames[1].file_path` is \"\", which names no file"),
            "{error}"
        );
        assert!(names(&["..", "a.png"]).is_err());
    }
}
