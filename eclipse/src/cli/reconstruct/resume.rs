//! What a run goes by: the options as they were typed and, where it goes on, those of its beginning for all others.

use std::ffi::OsString;

use clap::{CommandFactory, parser::ValueSource};

use super::{super::arguments::Arguments, ReconstructArguments, reading::Reading};
use crate::{
    capture::{Capture, LoadOptions},
    checkpoint::{self, Checkpoint, CheckpointError},
    settings::Settings,
};

/// The options of a run.
pub(super) struct Chosen {
    pub settings: Settings,
    /// How files are read, where that was said.
    pub reading: Reading,
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
        let (now, typed_reading) = (arguments.settings(), Reading::typed(&arguments.reading));
        let (mut settings, reading, inherited) = match begun {
            None => (now, typed_reading, Vec::new()),
            Some(begun) => {
                let (settings, mut inherited) = continued(&now, &begun.settings, &typed(words));
                let kept = Reading::of(begun);
                inherited.extend(typed_reading.inherited(&kept));
                (settings, typed_reading.or(kept), inherited)
            }
        };
        settings.reading = reading.clone().kept();
        Self {
            settings,
            reading,
            inherited,
        }
    }

    /// What the capture is loaded with.
    pub fn options(&self, arguments: &ReconstructArguments) -> LoadOptions {
        let mesh = self.settings.mesh.as_deref();
        let options = LoadOptions {
            max_memory: self.settings.memory,
            ..arguments.reading.options(mesh)
        };
        self.reading.clone().into_options(options)
    }

    /// Whether the run that left `begun` can go on so.
    ///
    /// # Errors
    /// As [`Checkpoint::check`]; files that are read otherwise are told apart from another capture.
    pub fn check(&self, begun: &Checkpoint, capture: &Capture) -> Result<(), CheckpointError> {
        let checked = begun.check(&self.settings, checkpoint::fingerprint(capture));
        let differing = Reading::of(begun).differing(&self.reading);
        match (checked, differing) {
            (Err(CheckpointError::OtherCapture), Some((field, then, now))) => {
                Err(CheckpointError::OtherSettings {
                    field: field.to_owned(),
                    then,
                    now,
                })
            }
            (checked, _) => checked,
        }
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

/// A choice that a run that goes on need not be told again.
struct Choice {
    /// Options by their fields' names: where any of them was typed, what it says is meant.
    options: &'static [&'static str],
    /// Takes it over from the second settings.
    take: fn(&mut Settings, &Settings),
    /// How it would be typed where it is not as the second settings, the usual ones, have it.
    told: fn(&Settings, &Settings) -> Vec<String>,
}

/// All of them, in the order of the command that repeats a run.
const CHOICES: [Choice; 12] = [
    Choice {
        options: &["preset"],
        take: |s, now| s.preset = now.preset,
        told: |s, usual| {
            option(
                "--preset",
                (s.preset != usual.preset).then(|| s.preset.name()),
            )
        },
    },
    Choice {
        options: &["from"],
        take: |s, now| s.from.clone_from(&now.from),
        told: |s, _| option("--from", s.from.as_ref().map(|path| path.to_string_lossy())),
    },
    // Either limit is meant in place of both.
    Choice {
        options: &["time_limit", "iterations"],
        take: |s, now| (s.time_limit, s.iterations) = (now.time_limit, now.iterations),
        told: |s, usual| {
            // With iterations there is no time limit unless one is asked for.
            let limited = s.iterations.is_some() || s.time_limit != usual.time_limit;
            let time = s.time_limit.filter(|_| limited);
            let time = option("--time-limit", time.map(|time| format!("{time}s")));
            [time, option("--iterations", s.iterations)].concat()
        },
    },
    Choice {
        options: &["occluder_prior"],
        take: |s, now| s.occluder_prior = now.occluder_prior,
        told: |s, usual| {
            let prior = s.occluders && s.occluder_prior != usual.occluder_prior;
            option("--occluder-prior", prior.then(|| s.occluder_prior.name()))
        },
    },
    Choice {
        options: &["mesh"],
        take: |s, now| s.mesh.clone_from(&now.mesh),
        told: |s, _| option("--mesh", s.mesh.as_ref().map(|path| path.to_string_lossy())),
    },
    Choice {
        options: &["seed"],
        take: |s, now| s.seed = now.seed,
        told: |s, usual| option("--seed", (s.seed != usual.seed).then_some(s.seed)),
    },
    Choice {
        options: &["memory"],
        take: |s, now| s.memory = now.memory,
        told: |s, usual| option("--memory", (s.memory != usual.memory).then_some(s.memory)),
    },
    Choice {
        options: &["hold_out"],
        take: |s, now| s.hold_out = now.hold_out,
        told: |s, _| option("--hold-out", s.hold_out),
    },
    Choice {
        options: &["with"],
        take: |s, now| s.with.clone_from(&now.with),
        told: |s, _| option("--with", (!s.with.is_empty()).then(|| s.with.join(","))),
    },
    // A prior speaks of occluders, too: there are some.
    Choice {
        options: &["no_occluders", "occluder_prior"],
        take: |s, now| s.occluders = now.occluders,
        told: |s, _| flag("--no-occluders", !s.occluders),
    },
    Choice {
        options: &["lambertian"],
        take: |s, now| s.lambertian = now.lambertian,
        told: |s, _| flag("--lambertian", s.lambertian),
    },
    // Nothing depends on them.
    Choice {
        options: &["threads"],
        take: |s, now| s.threads = now.threads,
        told: |_, _| Vec::new(),
    },
];

fn option(name: &str, value: Option<impl ToString>) -> Vec<String> {
    let pair = |value: &dyn ToString| vec![name.to_owned(), value.to_string()];
    value.map_or_else(Vec::new, |value| pair(&value))
}

fn flag(name: &str, set: bool) -> Vec<String> {
    set.then(|| name.to_owned()).into_iter().collect()
}

/// The settings of a run that goes on, `now` for what was typed and `then` for all else; and what is not typed and a new run would
/// not take by itself, as it would be typed.
fn continued(
    now: &Settings,
    then: &Settings,
    typed: &dyn Fn(&str) -> bool,
) -> (Settings, Vec<String>) {
    let (mut settings, usual) = (then.clone(), Settings::default());
    let any = |choice: &&Choice| choice.options.iter().any(|option| typed(option));
    let (typed, untyped): (Vec<&Choice>, Vec<&Choice>) = CHOICES.iter().partition(any);
    for choice in typed {
        (choice.take)(&mut settings, now);
    }
    let told = |choice: &Choice| (choice.told)(&settings, &usual);
    let inherited = untyped.into_iter().flat_map(told).collect();
    (settings, inherited)
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
    fn settings_say_how_files_are_read() {
        let then = chosen(
            "--up -y --max-size 512 --images photos",
            Settings::default(),
        )
        .settings;
        assert_eq!(then.reading.up.as_deref(), Some("-y"));
        let reading = then.reading.clone();
        let kept = chosen("--resume", then);
        assert_eq!(kept.settings.reading, reading);
        assert_eq!(
            kept.inherited.join(" "),
            "--up -y --max-size 512 --images photos"
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
}
