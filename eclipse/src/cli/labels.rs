//! The labels that `eclipse study mismatch` scores verdicts against: what is true of each capture.

use std::{
    collections::BTreeMap,
    path::{Component, Path, PathBuf},
};

use serde::Deserialize;

use crate::{
    criticism::study_scores,
    files::json::{self, JsonError},
};

/// Largest file of labels that is read, in bytes.
pub(super) const MAX_LABELS: u64 = 1 << 24;
/// What it holds.
pub(super) const EXPECTED: &str =
    r#"{"a capture": {"effects": ["vignetting"]}, "another": {"effects": []}}"#;

/// What is true of a capture.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Label {
    /// Identifiers of the physics that its simulation lacks.
    pub effects: Vec<String>,
}

/// Why a file is no table of labels.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LabelsError {
    /// It is not the JSON that is expected.
    #[error(
        "{} is not a table of labels ({source}); expected {EXPECTED}", path.display()
    )]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        source: JsonError,
    },
    /// A name that leads out of the folder of captures, and out of that of the results.
    #[error(
        "{}: {name:?} is no name of a capture; expected that of a folder inside the folder of captures", path.display()
    )]
    Name {
        /// The file.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// Something that no diagnosis could ever match.
    #[error(
        "{}: the label of {name:?} names {id:?}, which is no effect; expected some of {known}", path.display()
    )]
    Effect {
        /// The file.
        path: PathBuf,
        /// The capture.
        name: String,
        /// What is no effect.
        id: String,
        /// All that are.
        known: String,
    },
}

/// The label of every capture, by its name; `path` only names the file in errors.
///
/// # Errors
/// [`LabelsError`] for what is no such table, and for names of captures and effects that cannot be ones.
pub fn parse_labels(bytes: &[u8], path: &Path) -> Result<BTreeMap<String, Label>, LabelsError> {
    let labels: BTreeMap<String, Label> =
        json::parse(bytes).map_err(|source| LabelsError::Json {
            path: path.into(),
            source,
        })?;
    let known = study_scores::names();
    for (name, label) in &labels {
        if !is_inside(Path::new(name)) {
            return Err(LabelsError::Name {
                path: path.into(),
                name: name.clone(),
            });
        }
        let unknown = |id: &&String| !known.contains(&id.as_str());
        if let Some(id) = label.effects.iter().find(unknown) {
            return Err(LabelsError::Effect {
                path: path.into(),
                name: name.clone(),
                id: id.clone(),
                known: known.join(", "),
            });
        }
    }
    Ok(labels)
}

/// Whether a path stays inside whatever folder it is joined to, and is not that folder itself.
fn is_inside(path: &Path) -> bool {
    let mut parts = path.components().peekable();
    parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let parsed = parse_labels(text.as_bytes(), Path::new("labels.json"));
        parsed.unwrap_err().to_string()
    }

    #[test]
    fn labels_are_read_by_the_names_of_captures() {
        let text =
            r#"{"hall": {"effects": []}, "day/hall": {"effects": ["outside", "vignetting"]}}"#;
        let labels = parse_labels(text.as_bytes(), Path::new("labels.json")).unwrap();
        assert!(labels["hall"].effects.is_empty());
        assert_eq!(labels["day/hall"].effects, ["outside", "vignetting"]);
    }

    #[test]
    fn names_that_lead_out_of_the_folder_are_refused() {
        for name in ["", ".", "..", "/etc", "a/../../b", "../hall"] {
            let message = refused(&format!(r#"{{"{name}": {{"effects": []}}}}"#));
            assert!(message.contains(&format!("{name:?}")), "{message}");
            assert!(message.contains("folder of captures"), "{message}");
        }
    }

    #[test]
    fn what_is_no_table_is_refused() {
        for text in [
            "",
            "[]",
            "3",
            r#"{"hall": []}"#,
            r#"{"hall": {"effects": "none"}}"#,
        ] {
            let message = refused(text);
            assert!(message.contains("not a table of labels"), "{message}");
        }
        let message = refused(r#"{"hall": {"effects": ["nonsense"]}}"#);
        assert!(message.contains("\"nonsense\"") && message.contains("vignetting"));
    }
}
