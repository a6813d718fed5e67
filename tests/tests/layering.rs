//! The invariants of ARCHITECTURE.md: who may know of whom.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Longest source file that a reader should face.
const MOST_LINES: usize = 450;

#[test]
fn the_engine_knows_nothing_of_light() {
    for word in ["render", "eclipse", "radiance", "albedo", "bsdf", "camera"] {
        absent("autodiff/src", word, &[]);
    }
    assert!(!manifest("autodiff").contains("render"));
    assert!(!manifest("autodiff").contains("eclipse"));
}

#[test]
fn the_renderer_knows_nothing_of_files_and_command_lines() {
    for path in [
        "eclipse::",
        "clap",
        "indicatif",
        "std::fs",
        "fs::read",
        "std::env",
        "println!",
        "serde",
    ] {
        absent("render/src", path, &[]);
    }
    assert!(!manifest("render").contains("eclipse"));
}

#[test]
fn sampling_and_geometry_never_see_a_tape() {
    for file in sources("render/src") {
        let name = file
            .file_stem()
            .and_then(|stem| stem.to_str())
            .unwrap_or_default()
            .to_owned();
        let plain = [
            "bsdf",
            "bvh",
            "camera",
            "environment",
            "image",
            "lat_long",
            "mesh",
            "path",
            "reference",
            "sampler",
            "transport",
            "visibility",
            "warp",
        ];
        if plain.contains(&name.as_str()) {
            assert!(
                !code(&file).contains("autodiff"),
                "{} uses the tape",
                file.display()
            );
        }
    }
}

#[test]
fn only_the_command_line_talks_to_people() {
    for path in [
        "clap",
        "ctrlc",
        "process::exit",
        "println!",
        "std::env::args",
    ] {
        absent("eclipse/src", path, &["cli", "main.rs"]);
    }
    for terminal in ["indicatif", "ratatui"] {
        absent("eclipse/src", terminal, &["progress.rs"]);
    }
}

#[test]
fn modules_use_lower_floors_only() {
    // Each module of the eclipse crate may use those before it.
    let floors: [&[&str]; 11] = [
        &["files", "layout", "settings", "wording"],
        &["image_io", "reconstruction"],
        &["mesh_io"],
        &["capture"],
        &["checkpoint", "evaluate", "report"],
        &["control", "output"],
        &["reconstruct", "progress", "relight", "synthesize"],
        &["criticism", "export", "inspect"],
        &["joint"],
        &["studies"],
        &["cli"],
    ];
    for (floor, modules) in floors.iter().enumerate() {
        for module in *modules {
            let upper = floors[floor + 1..].iter().copied().flatten();
            for forbidden in upper {
                for file in module_files(module) {
                    let code = code(&file);
                    let uses = |line: &str| {
                        line.contains(&format!("crate::{forbidden}::")) || imported(line, forbidden)
                    };
                    let found = code.lines().find(|line| uses(line));
                    assert!(
                        found.is_none(),
                        "{} uses `{forbidden}` above it: {found:?}",
                        file.display()
                    );
                }
            }
        }
    }
}

#[test]
fn randomness_never_comes_from_the_machine() {
    for folder in ["autodiff/src", "render/src", "eclipse/src"] {
        for source in [
            "thread_rng",
            "from_entropy",
            "from_os_rng",
            "rand::rng()",
            "getrandom",
            "RandomState",
        ] {
            absent(folder, source, &[]);
        }
    }
}

#[test]
fn nothing_asks_what_time_it_is() {
    // Times are counted from a start, which a clock that is set does not change.
    for folder in ["autodiff/src", "render/src", "eclipse/src"] {
        absent(folder, "SystemTime", &[]);
    }
}

#[test]
fn files_can_be_read_in_one_sitting() {
    for folder in ["render/src", "eclipse/src"] {
        for file in sources(folder) {
            let text = fs::read_to_string(&file).unwrap();
            // Unit tests stand below the code they test and are not needed to follow it.
            let lines = text
                .lines()
                .take_while(|line| *line != "#[cfg(test)]")
                .count();
            assert!(
                lines <= MOST_LINES,
                "{} has {lines} lines: split it",
                file.display()
            );
        }
    }
}

#[test]
fn every_file_of_tests_is_in_one_binary() {
    let manifest = fs::read_to_string(root().join("tests/Cargo.toml")).unwrap();
    let named = |line: &str| {
        let path = line.strip_prefix("path = \"tests/")?;
        Some(path.strip_suffix(".rs\"")?.to_owned())
    };
    let roots: Vec<String> = manifest.lines().filter_map(named).collect();
    let modules: Vec<String> = roots
        .iter()
        .flat_map(|name| {
            let path = root().join(format!("tests/tests/{name}.rs"));
            let text = fs::read_to_string(path).unwrap();
            let modules = text.lines().filter_map(|line| line.strip_prefix("mod "));
            let modules = modules.filter_map(|line| line.strip_suffix(";"));
            modules.map(str::to_owned).collect::<Vec<_>>()
        })
        .collect();
    let mut files = 0;
    for entry in fs::read_dir(root().join("tests/tests")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "rs") {
            continue;
        }
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        // Tests that nothing compiles cannot fail.
        let count = roots.iter().chain(&modules).filter(|known| **known == name);
        assert_eq!(count.count(), 1, "{name}.rs");
        files += 1;
    }
    assert!(files > roots.len());
}

/// Fails when code below `folder`, outside `except`, mentions `word`.
fn absent(folder: &str, word: &str, except: &[&str]) {
    for file in sources(folder) {
        let parts: Vec<_> = file
            .components()
            .map(|part| part.as_os_str().to_string_lossy())
            .collect();
        let stem = |part: &str| part.trim_end_matches(".rs").to_owned();
        if except
            .iter()
            .any(|name| parts.iter().any(|part| stem(part) == stem(name)))
        {
            continue;
        }
        let code = code(&file);
        let found = code.lines().find(|line| mentions(line, word));
        assert!(
            found.is_none(),
            "{} mentions `{word}`: {found:?}",
            file.display()
        );
    }
}

/// Whether `line` has `word` not as a part of a longer identifier.
fn mentions(line: &str, word: &str) -> bool {
    let part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    line.match_indices(word).any(|(at, _)| {
        let before = line[..at].chars().next_back().is_some_and(part);
        let after = line[at + word.len()..].chars().next().is_some_and(part);
        !(before || after && word.ends_with(part))
    })
}

/// Whether `line` imports `module` inside `use crate::{…}`, as rustfmt lays it out.
fn imported(line: &str, module: &str) -> bool {
    let line = line.trim_start();
    let names = |part: &str| part.starts_with(&format!("{module}::")) || part == module;
    match line.strip_prefix("use crate::{") {
        None => line.starts_with(&format!("{module}::")) || line == format!("{module},"),
        Some(list) => list
            .trim_end_matches("};")
            .split(',')
            .any(|part| names(part.trim())),
    }
}

fn module_files(module: &str) -> Vec<PathBuf> {
    let folder = format!("eclipse/src/{module}");
    let mut files = if root().join(&folder).is_dir() {
        sources(&folder)
    } else {
        Vec::new()
    };
    files.extend(
        [root().join(format!("{folder}.rs"))]
            .into_iter()
            .filter(|file| file.is_file()),
    );
    files
}

/// The Rust files below `folder`, at least one.
fn sources(folder: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    assert!(!files.is_empty(), "no sources in {folder}");
    files.sort();
    files
}

/// A file without comments: prose may name anything.
fn code(file: &Path) -> String {
    let text = fs::read_to_string(file).unwrap();
    text.lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// What a crate depends on, as its Cargo.toml says it.
fn manifest(krate: &str) -> String {
    let text = fs::read_to_string(root().join(krate).join("Cargo.toml")).unwrap();
    text.split_once("[dependencies]")
        .map_or(String::new(), |(_, dependencies)| dependencies.to_owned())
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}
