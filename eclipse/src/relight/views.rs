//! What is to be seen of an object, and what the pictures are called.

use std::{
    collections::HashMap,
    path::{Component, Path},
};

use render::camera::Camera;

use super::RelightError;
use crate::{capture::read_described, files::slashed, image_io::stem};

/// A picture to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// What its files are called, without their extension; folders lie within that of the pictures.
    pub name: String,
    /// What the frame is called that its camera is of, by which its light is found.
    pub frame: String,
    /// Through which it is seen, in the frame whose origin is the object's centre.
    pub camera: Camera,
}

/// The name of picture `index` where nothing else names it.
pub fn number(index: usize) -> String {
    format!("{index:03}")
}

/// What the frames of the cameras file or capture `path` are called, in its order: their `file_path` without an image's extension; of a
/// frame with a `scene_name` (Stanford-ORB's `transforms_novel.json`) that folder and the name of the file alone, as predictions of the
/// benchmark are.
///
/// # Errors
/// A file that cannot be read, [`RelightError::Name`] for a name that leads elsewhere or that two frames have.
pub fn frame_names(path: &Path, allow_outside: bool) -> Result<Vec<String>, RelightError> {
    let frames = read_described(path, allow_outside)?.frames;
    let mut seen = HashMap::new();
    let mut names = Vec::with_capacity(frames.len());
    for (index, frame) in frames.iter().enumerate() {
        let wrong = |field, name: &str, problem: String| RelightError::Name {
            path: path.into(),
            frame: index,
            field,
            name: name.to_owned(),
            problem,
        };
        let file = &frame.file_path;
        let elsewhere = || "is no path of plain folder and file names".to_owned();
        let checked =
            |field, name: &str| plain(name).ok_or_else(|| wrong(field, name, elsewhere()));
        let own = checked("file_path", file)?;
        let own = stem(&own);
        let name = match &frame.scene_name {
            None => own.to_owned(),
            Some(scene) => {
                let name = own.rsplit('/').next().unwrap_or(own);
                format!("{}/{name}", checked("scene_name", scene)?)
            }
        };
        if let Some(earlier) = seen.insert(name.clone(), index) {
            let problem = format!("gives it the name {name:?}, which frame {earlier} has");
            return Err(wrong("file_path", file, problem));
        }
        names.push(name);
    }
    Ok(names)
}

/// `name` with its folders by `/` and without needless dots; `None` where it leads out of the folder it is in, or nowhere.
pub(super) fn plain(name: &str) -> Option<String> {
    let name = slashed(name);
    let mut parts = Vec::new();
    for component in Path::new(&name).components() {
        match component {
            Component::Normal(part) => parts.push(part.to_str()?),
            Component::CurDir => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    let control = parts.iter().any(|part| part.contains(char::is_control));
    (!parts.is_empty() && !control).then(|| parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(frames: &str) -> Result<Vec<String>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        std::fs::write(&path, format!(r#"{{"frames":[{frames}]}}"#)).unwrap();
        frame_names(&path, false).map_err(|error| error.to_string())
    }

    #[test]
    fn frames_are_called_as_their_photographs() {
        let frames = r#"{"file_path":"test/0000"},{"file_path":"./train/r_1.png"},{"file_path":"images\\view.001"},
            {"file_path":"a/.exr"}"#;
        let expected = ["test/0000", "train/r_1", "images/view.001", "a/.exr"];
        assert_eq!(names(frames).unwrap(), expected);
    }

    #[test]
    fn frames_of_other_scenes_are_called_as_the_benchmark_calls_predictions() {
        let frames = r#"{"file_path":"test/0003","scene_name":"cup_scene002"},
            {"file_path":"test/0003.exr","scene_name":"cup_scene003"}"#;
        assert_eq!(
            names(frames).unwrap(),
            ["cup_scene002/0003", "cup_scene003/0003"]
        );
    }

    #[test]
    fn names_that_lead_elsewhere_or_meet_are_refused() {
        for name in ["../a", "a/../../b", "/etc/a", "", "."] {
            let error = names(&format!(r#"{{"file_path":"{name}"}}"#)).unwrap_err();
            assert!(
                error.contains("cameras.json: frame 0: `file_path`"),
                "{error}"
            );
        }
        let error = names(r#"{"file_path":"a\u0000b"}"#).unwrap_err();
        assert!(
            error.contains("`file_path` has control characters"),
            "{error}"
        );
        let scene = r#"{"file_path":"a","scene_name":".."}"#;
        let error = names(scene).unwrap_err();
        assert!(
            error.contains("`scene_name` \"..\" is no path of plain"),
            "{error}"
        );
        let twice = r#"{"file_path":"a/0.png"},{"file_path":"a/0.exr"}"#;
        let error = names(twice).unwrap_err();
        assert!(
            error.contains(
                "frame 1: `file_path` \"a/0.exr\" gives it the name \"a/0\", which frame 0 has"
            ),
            "{error}"
        );
    }
}
