//! What a run goes by: the options as they were typed and, where it goes on, those of its beginning for all others.

use std::{borrow::Cow, ffi::OsString};

use clap::{CommandFactory, parser::ValueSource};

use super::{
    super::arguments::{Arguments, ColorName},
    ReconstructArguments,
};
use crate::{
    capture::{Capture, LoadOptions},
    checkpoint::{self, Array, Checkpoint, CheckpointError},
    settings::Settings,
};

/// The name under which a checkpoint keeps how colours are stored: what it holds otherwise says nothing of files.
const COLOR: &str = "color";

/// The options of a run.
pub(super) struct Chosen {
    pub settings: Settings,
    /// How photographs store colours, where that was said.
    pub color: Option<ColorName>,
    /// Options of the beginning that were not typed again, as they would be.
    pub inherited: Vec<String>,
}

impl Chosen {
    /// Those of a new run, or of the one that goes on from `begun`; `words` is what was typed.
    pub fn of(
        arguments: &ReconstructArguments,
        words: &[OsString],
        begun: Option<&Checkpoint>,
    ) -> Self {
        let (now, color) = (arguments.settings(), arguments.reading.color);
        let Some(begun) = begun else {
            return Self {
                settings: now,
                color,
                inherited: Vec::new(),
            };
        };
        let typed = typed(words);
        let (settings, kept) = (continued(now, &begun.settings, &typed), color_of(begun));
        let mut inherited = inherited(&begun.settings, &typed);
        if let (None, Some(kept)) = (color, kept) {
            inherited.extend(["--color".to_owned(), kept.name().to_owned()]);
        }
        Self {
            settings,
            color: color.or(kept),
            inherited,
        }
    }

    /// How the capture is read.
    pub fn reading(&self, arguments: &ReconstructArguments) -> LoadOptions {
        let mesh = self.settings.mesh.as_deref();
        LoadOptions {
            color_encoding: self.color.map(ColorName::encoding),
            ..arguments.reading.options(mesh)
        }
    }

    /// Whether the run that left `begun` can go on so.
    ///
    /// # Errors
    /// As [`Checkpoint::check`]; colours that are read otherwise are told apart from another capture.
    pub fn check(&self, begun: &Checkpoint, capture: &Capture) -> Result<(), CheckpointError> {
        let checked = begun.check(&self.settings, checkpoint::fingerprint(capture));
        let then = color_of(begun);
        match checked {
            Err(CheckpointError::OtherCapture) if then != self.color => {
                let named = |color: Option<ColorName>| match color {
                    Some(color) => color.name().to_owned(),
                    None => "what the capture says".to_owned(),
                };
                Err(CheckpointError::OtherSettings {
                    field: COLOR.to_owned(),
                    then: named(then),
                    now: named(self.color),
                })
            }
            checked => checked,
        }
    }

    /// A checkpoint of the solver, with what it does not know of.
    pub fn kept_in<'a>(&self, checkpoint: &'a Checkpoint) -> Cow<'a, Checkpoint> {
        let Some(color) = self.color else {
            return Cow::Borrowed(checkpoint);
        };
        let mut checkpoint = checkpoint.clone();
        let array = Array::U64(vec![color as u64]);
        checkpoint.arrays.insert(COLOR.to_owned(), array);
        Cow::Owned(checkpoint)
    }
}

/// Tells of an option, by its field's name, whether it was typed.
fn typed(words: &[OsString]) -> impl Fn(&str) -> bool + use<> {
    let all = Arguments::command().try_get_matches_from(words).ok();
    let of_command = all.and_then(|mut all| all.remove_subcommand());
    move |option| match &of_command {
        Some((_, matches)) => matches.value_source(option) == Some(ValueSource::CommandLine),
        // These words were understood before. Were they not, nothing would be taken over unseen.
        None => true,
    }
}

/// The settings of a run that goes on: `now` for what was typed, `then` for all else.
fn continued(now: Settings, then: &Settings, typed: &dyn Fn(&str) -> bool) -> Settings {
    let mut settings = then.clone();
    // Either limit is meant in place of both.
    if typed("time_limit") || typed("iterations") {
        (settings.time_limit, settings.iterations) = (now.time_limit, now.iterations);
    }
    // A prior speaks of occluders, too: there are some.
    if typed("no_occluders") || typed("occluder_prior") {
        settings.occluders = now.occluders;
    }
    if typed("occluder_prior") {
        settings.occluder_prior = now.occluder_prior;
    }
    if typed("preset") {
        settings.preset = now.preset;
    }
    if typed("from") {
        settings.from = now.from;
    }
    if typed("lambertian") {
        settings.lambertian = now.lambertian;
    }
    if typed("mesh") {
        settings.mesh = now.mesh;
    }
    if typed("seed") {
        settings.seed = now.seed;
    }
    if typed("threads") {
        settings.threads = now.threads;
    }
    if typed("memory") {
        settings.memory = now.memory;
    }
    if typed("hold_out") {
        settings.hold_out = now.hold_out;
    }
    if typed("with") {
        settings.with = now.with;
    }
    settings
}

/// The options of `then` that were not typed again and that a new run would not take by itself, as they would be typed; threads
/// aside, on which nothing depends.
fn inherited(then: &Settings, typed: &dyn Fn(&str) -> bool) -> Vec<String> {
    let usual = Settings::default();
    let untyped = |options: &[&str]| !options.iter().any(|option| typed(option));
    let limits = untyped(&["time_limit", "iterations"]);
    let occluders = untyped(&["no_occluders", "occluder_prior"]);
    let path = |path: &Option<std::path::PathBuf>| {
        let path = path.as_ref();
        path.map(|path| path.to_string_lossy().into_owned())
    };
    let preset = (then.preset != usual.preset).then(|| then.preset.name().to_owned());
    // With iterations there is no time limit unless one is asked for.
    let limited = then.iterations.is_some() || then.time_limit != usual.time_limit;
    let time = then.time_limit.filter(|_| limited);
    let prior = then.occluders && then.occluder_prior != usual.occluder_prior;
    let prior = prior.then(|| then.occluder_prior.name().to_owned());
    let seed = (then.seed != usual.seed).then(|| then.seed.to_string());
    let memory = (then.memory != usual.memory).then(|| then.memory.to_string());
    let with = (!then.with.is_empty()).then(|| then.with.join(","));
    let values = [
        ("--preset", untyped(&["preset"]), preset),
        ("--from", untyped(&["from"]), path(&then.from)),
        ("--time-limit", limits, time.map(|time| format!("{time}s"))),
        (
            "--iterations",
            limits,
            then.iterations.map(|most| most.to_string()),
        ),
        ("--occluder-prior", occluders, prior),
        ("--mesh", untyped(&["mesh"]), path(&then.mesh)),
        ("--seed", untyped(&["seed"]), seed),
        ("--memory", untyped(&["memory"]), memory),
        (
            "--hold-out",
            untyped(&["hold_out"]),
            then.hold_out.map(|every| every.to_string()),
        ),
        ("--with", untyped(&["with"]), with),
    ];
    let flags = [
        ("--no-occluders", occluders && !then.occluders),
        ("--lambertian", untyped(&["lambertian"]) && then.lambertian),
    ];
    let values = values.into_iter().filter(|(_, untyped, _)| *untyped);
    let values = values.filter_map(|(option, _, value)| Some([option.to_owned(), value?]));
    let flags = flags.into_iter().filter(|(_, inherited)| *inherited);
    let flags = flags.map(|(flag, _)| flag.to_owned());
    values.flatten().chain(flags).collect()
}

/// How the beginning read colours, where that was said.
fn color_of(begun: &Checkpoint) -> Option<ColorName> {
    let Some(Array::U64(values)) = begun.arrays.get(COLOR) else {
        return None;
    };
    let all = [ColorName::Linear, ColorName::Srgb];
    all.into_iter().find(|color| values[..] == [*color as u64])
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use clap::Parser;

    use super::{super::super::arguments::Command, *};
    use crate::settings::{OccluderPrior, Preset};

    /// What is chosen for `text` after a run of `then`.
    fn chosen(text: &str, then: Settings) -> Chosen {
        let begun = Checkpoint {
            settings: then,
            capture: 0,
            iteration: 0,
            seconds: 0.0,
            arrays: BTreeMap::new(),
        };
        let words = format!("eclipse reconstruct c {text}");
        let words: Vec<OsString> = words.split_whitespace().map(OsString::from).collect();
        let Command::Reconstruct(arguments) = Arguments::try_parse_from(&words).unwrap().command
        else {
            unreachable!("the subcommand was given")
        };
        Chosen::of(&arguments, &words, Some(&begun))
    }

    fn unusual() -> Settings {
        Settings {
            preset: Preset::Paper,
            time_limit: Some(600.0),
            iterations: None,
            seed: 3,
            threads: 7,
            memory: 1 << 30,
            occluder_prior: OccluderPrior::None,
            lambertian: true,
            hold_out: Some(8),
            grid_rows: 40,
            harmonic_degree: 24,
            mesh: Some("my m.obj".into()),
            from: Some("out/first".into()),
            with: vec!["vignetting".into(), "black_level".into()],
            ..Settings::default()
        }
    }

    #[test]
    fn what_is_not_typed_is_the_beginnings() {
        let then = unusual();
        let chosen = chosen("--resume", then.clone());
        assert_eq!(chosen.settings, then);
        assert_eq!(
            chosen.inherited.join(" "),
            "--preset paper --from out/first --time-limit 600s --occluder-prior none --mesh my m.obj --seed 3 \
             --memory 1073741824 --hold-out 8 --with vignetting,black_level --lambertian"
        );
    }

    #[test]
    fn what_is_typed_is_taken_even_where_it_is_the_default() {
        let typed = "--resume --preset fast --seed 0 --hold-out 4 --threads 1 --memory 2GiB";
        let chosen = chosen(typed, unusual());
        let settings = &chosen.settings;
        assert_eq!((settings.preset, settings.seed), (Preset::Fast, 0));
        assert_eq!((settings.hold_out, settings.threads), (Some(4), 1));
        assert_eq!(settings.memory, 2 << 30);
        // Not options, but what the beginning worked with.
        assert_eq!((settings.grid_rows, settings.harmonic_degree), (40, 24));
        let inherited = chosen.inherited.join(" ");
        for option in ["--preset", "--seed", "--hold-out", "--memory"] {
            assert!(!inherited.contains(option), "{option}: {inherited}");
        }
    }

    #[test]
    fn either_limit_takes_the_place_of_both() {
        let then = Settings {
            time_limit: None,
            iterations: Some(7),
            ..Settings::default()
        };
        let kept = chosen("--resume", then.clone());
        assert_eq!(kept.settings, then);
        assert_eq!(kept.inherited, ["--iterations", "7"]);
        let longer = chosen("--resume --time-limit 1h", then);
        assert_eq!(longer.settings.time_limit, Some(3600.0));
        assert_eq!(longer.settings.iterations, None);
        assert_eq!(longer.inherited, [""; 0]);
    }

    #[test]
    fn a_prior_is_of_occluders() {
        let then = Settings {
            occluders: false,
            ..Settings::default()
        };
        assert_eq!(
            chosen("--resume", then.clone()).inherited,
            ["--no-occluders"]
        );
        let with = chosen("--resume --occluder-prior operator", then);
        assert!(with.settings.occluders);
    }

    #[test]
    fn how_colours_are_read_is_kept() {
        let mut begun = Checkpoint {
            settings: Settings::default(),
            capture: 0,
            iteration: 0,
            seconds: 0.0,
            arrays: BTreeMap::new(),
        };
        assert_eq!(color_of(&begun), None);
        for color in [ColorName::Linear, ColorName::Srgb] {
            let chosen = Chosen {
                settings: Settings::default(),
                color: Some(color),
                inherited: Vec::new(),
            };
            begun = chosen.kept_in(&begun).into_owned();
            assert_eq!(color_of(&begun), Some(color));
        }
    }
}
