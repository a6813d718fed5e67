//! Any bytes as the labels of `eclipse study mismatch`: captures that they name lie inside the folder of captures, and effects are
//! known.

#![no_main]

use std::path::{Component, Path};

use eclipse::{cli::parse_labels, criticism::study_scores};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(labels) = parse_labels(bytes, Path::new("labels.json")) {
        let known = study_scores::names();
        for (name, label) in &labels {
            let mut parts = Path::new(name).components();
            assert!(!name.is_empty());
            assert!(parts.all(|part| matches!(part, Component::Normal(_))));
            assert!(label.effects.iter().all(|id| known.contains(&id.as_str())));
        }
    }
});
