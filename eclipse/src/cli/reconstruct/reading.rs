//! How the files of a capture are read, as far as it was said: a run that goes on reads them as its beginning did.

use std::path::PathBuf;

use crate::{
    capture::{LoadOptions, UpAxis},
    checkpoint::{Array, Checkpoint},
    cli::arguments::{ColorName, ReadingArguments},
    settings,
};

/// What is told of it, in the order of its fields.
const NAMES: [&str; 4] = ["color", "up", "max_size", "images"];
/// What checkpoints of before it was one of the settings tell of it.
const NUMBERED: [&str; 3] = ["color", "up", "max_size"];

/// What was said of each; nothing where nothing was.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::cli) struct Reading {
    pub color: Option<ColorName>,
    pub up: Option<UpAxis>,
    pub max_size: Option<u32>,
    pub images: Option<PathBuf>,
}

impl Reading {
    /// As it was typed.
    pub fn typed(arguments: &ReadingArguments) -> Self {
        Self {
            color: arguments.color,
            up: arguments.up,
            max_size: arguments.max_size,
            images: arguments.images.clone(),
        }
    }

    /// As the beginning read.
    pub fn of(begun: &Checkpoint) -> Self {
        Self::told(&begun.settings.reading).or(Self::of_arrays(begun))
    }

    /// As the settings of a run tell it; of what cannot be understood, nothing.
    pub fn told(kept: &settings::Reading) -> Self {
        Self {
            color: kept.color.as_deref().and_then(ColorName::named),
            up: kept.up.as_deref().and_then(|name| name.parse().ok()),
            max_size: kept.max_size,
            images: kept.images.clone(),
        }
    }

    /// The first thing in the settings of a run that cannot be understood and that nothing `typed` replaces: what it is, and what to do.
    pub fn misunderstood(kept: &settings::Reading, typed: Self) -> Option<String> {
        let told = Self::told(kept);
        let problem = |name, said: &Option<String>, understood: bool| {
            let said = said.as_ref().filter(|_| !understood)?;
            Some(format!(
                "`reading.{name}` is {said:?}, which is none that --{name} takes: correct it, or give --{name}"
            ))
        };
        let known = told.or(typed);
        problem("color", &kept.color, known.color.is_some())
            .or_else(|| problem("up", &kept.up, known.up.is_some()))
    }

    /// As a checkpoint kept it before it was one of the settings: by numbers.
    fn of_arrays(begun: &Checkpoint) -> Self {
        let [color, up, max_size] = NUMBERED.map(|name| match begun.arrays.get(name) {
            Some(Array::U64(values)) if values.len() == 1 => usize::try_from(values[0]).ok(),
            _ => None,
        });
        Self {
            color: color.and_then(|kept| ColorName::ALL.get(kept).copied()),
            up: up.and_then(|kept| UpAxis::ALL.get(kept).copied()),
            max_size: max_size.and_then(|kept| u32::try_from(kept).ok()),
            images: None,
        }
    }

    /// This and, where it says nothing, what `begun` says.
    pub fn or(self, begun: Self) -> Self {
        Self {
            color: self.color.or(begun.color),
            up: self.up.or(begun.up),
            max_size: self.max_size.or(begun.max_size),
            images: self.images.or(begun.images),
        }
    }

    /// What `begun` says and this does not, as it would be typed.
    pub fn inherited(&self, begun: &Self) -> Vec<String> {
        let options = [
            ("--color", self.color.is_none(), begun.color()),
            ("--up", self.up.is_none(), begun.up()),
            ("--max-size", self.max_size.is_none(), begun.max_size()),
            ("--images", self.images.is_none(), begun.images()),
        ];
        let untyped = options.into_iter().filter(|(_, untyped, _)| *untyped);
        let told = untyped.filter_map(|(option, _, told)| Some([option.to_owned(), told?]));
        told.flatten().collect()
    }

    /// The first in which two differ: its name, what this says and what `other` says.
    pub fn differing(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let said = |reading: &Self| {
            [
                reading.color().unwrap_or("what the capture says".into()),
                reading.up().unwrap_or(UpAxis::default().name().into()),
                reading.max_size().unwrap_or("none".into()),
                reading.images().unwrap_or("the capture's own".into()),
            ]
        };
        let both = said(self).into_iter().zip(said(other));
        let mut named = NAMES.into_iter().zip(both);
        let found = named.find(|(_, (this, other))| this != other);
        found.map(|(name, (this, other))| (name, this, other))
    }

    /// Puts it into the options a capture is loaded with.
    pub fn into_options(self, options: LoadOptions) -> LoadOptions {
        LoadOptions {
            color_encoding: self.color.map(ColorName::encoding),
            up: self.up.unwrap_or_default(),
            max_size: self.max_size.map(|side| side as usize),
            images: self.images,
            ..options
        }
    }

    /// What settings keep of it.
    pub fn kept(self) -> settings::Reading {
        settings::Reading {
            color: self.color(),
            up: self.up(),
            max_size: self.max_size,
            images: self.images,
        }
    }

    fn color(&self) -> Option<String> {
        self.color.map(|color| color.name().to_owned())
    }

    fn up(&self) -> Option<String> {
        self.up.map(|axis| axis.name().into())
    }

    fn max_size(&self) -> Option<String> {
        self.max_size.map(|side| side.to_string())
    }

    fn images(&self) -> Option<String> {
        let folder = self.images.as_ref();
        folder.map(|folder| folder.to_string_lossy().into_owned())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::settings::Settings;

    fn checkpoint(reading: settings::Reading, arrays: BTreeMap<String, Array>) -> Checkpoint {
        Checkpoint {
            settings: Settings {
                reading,
                ..Settings::default()
            },
            capture: 0,
            iteration: 0,
            seconds: 0.0,
            arrays,
        }
    }

    #[test]
    fn settings_keep_all_that_was_said_and_nothing_else() {
        let kept = |reading: Reading| Reading::of(&checkpoint(reading.kept(), BTreeMap::new()));
        assert_eq!(kept(Reading::default()), Reading::default());
        let oblique = "0.1,-0.9,0.3".parse().unwrap();
        for color in [None, Some(ColorName::Linear), Some(ColorName::Srgb)] {
            for up in UpAxis::ALL.into_iter().chain([oblique]) {
                let reading = Reading {
                    color,
                    up: Some(up),
                    max_size: Some(512),
                    images: Some("my photos".into()),
                };
                assert_eq!(kept(reading.clone()), reading);
            }
        }
    }

    #[test]
    fn checkpoints_of_before_say_it_by_numbers() {
        let numbers = [("color", 1), ("up", 4), ("max_size", 512)];
        let arrays = numbers.map(|(name, value)| (name.to_owned(), Array::U64(vec![value])));
        let begun = checkpoint(settings::Reading::default(), BTreeMap::from(arrays));
        let expected = Reading {
            color: Some(ColorName::Srgb),
            up: Some(UpAxis::NegY),
            max_size: Some(512),
            images: None,
        };
        assert_eq!(Reading::of(&begun), expected);
    }

    #[test]
    fn what_is_typed_counts_and_all_else_is_inherited() {
        let begun = Reading {
            color: Some(ColorName::Linear),
            up: Some(UpAxis::NegY),
            max_size: Some(512),
            images: Some("photos".into()),
        };
        let typed = Reading {
            up: Some(UpAxis::X),
            ..Reading::default()
        };
        let both = typed.clone().or(begun.clone());
        assert_eq!(both.up, Some(UpAxis::X));
        assert_eq!((both.color, both.max_size), (begun.color, begun.max_size));
        assert_eq!(both.images, begun.images);
        let inherited = typed.inherited(&begun).join(" ");
        assert_eq!(inherited, "--color linear --max-size 512 --images photos");
        let (name, then, now) = begun.differing(&both).unwrap();
        assert_eq!((name, &*then, &*now), ("up", "-y", "x"));
        // To say what is meant anyway changes nothing.
        let z = Reading {
            up: Some(UpAxis::Z),
            ..Reading::default()
        };
        assert_eq!(z.differing(&Reading::default()), None);
    }
}
