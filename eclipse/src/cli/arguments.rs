//! The commands; each one's arguments stand with what it does.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};

use super::{
    completions::CompletionsArguments, diagnose::DiagnoseArguments, evaluate::EvaluateArguments,
    export::ExportArguments, inspect::InspectArguments, man::ManArguments,
    reconstruct::ReconstructArguments, relight::RelightArguments, shown::ProgressArguments,
    study::StudyArguments, synthesize::SynthesizeArguments,
};
use crate::{
    capture::{LoadOptions, UpAxis},
    image_io::ColorEncoding,
};

/// Recovers light, materials and unseen occluders from posed photographs of an object whose shape is known.
#[derive(Parser, Debug)]
#[command(name = "eclipse", version, about, max_term_width = 100)]
#[command(
    after_help = "Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 130 interrupted; what was found until then is saved."
)]
pub(super) struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand, Debug)]
pub(super) enum Command {
    /// Recovers an environment map, materials and an occluder per photograph from a capture.
    Reconstruct(ReconstructArguments),
    /// Shows what is understood of a capture, and what a run will take, before anyone waits.
    Inspect(InspectArguments),
    /// Scores a reconstruction against a known truth.
    Evaluate(EvaluateArguments),
    /// Tells where a capture differs from its simulation, which physics was left out, and how much better it explains.
    Diagnose(DiagnoseArguments),
    /// Repeats an experiment of the paper, or scores a command over many captures.
    Study(StudyArguments),
    /// Renders a capture, with its truth, from a mesh, a material, an environment and occluders.
    Synthesize(SynthesizeArguments),
    /// Renders a recovered object in other light: stills and turntables.
    Relight(RelightArguments),
    /// Writes a result as other programs load it, with a small scene for them.
    Export(ExportArguments),
    /// Prints a script that completes commands and options in a shell.
    Completions(CompletionsArguments),
    /// Prints the manual page.
    Man(ManArguments),
}

impl Command {
    /// How its work is shown, of commands that take their time.
    pub fn progress(&self) -> Option<&ProgressArguments> {
        match self {
            Self::Reconstruct(arguments) => Some(&arguments.progress),
            Self::Diagnose(arguments) => Some(&arguments.progress),
            Self::Study(arguments) => Some(arguments.progress()),
            Self::Synthesize(arguments) => Some(&arguments.progress),
            Self::Relight(arguments) => Some(&arguments.progress),
            Self::Inspect(_)
            | Self::Evaluate(_)
            | Self::Export(_)
            | Self::Completions(_)
            | Self::Man(_) => None,
        }
    }
}

/// How a capture is read, for every command that takes one.
#[derive(Args, Debug, Default)]
pub(super) struct ReadingArguments {
    /// Let the capture name files outside its folder: for captures that you trust.
    #[arg(long)]
    pub allow_outside: bool,
    /// How all photographs store colours [default: what transforms.json says, else EXR and HDR linear, PNG and JPEG srgb].
    #[arg(long, value_enum, value_name = "ENCODING")]
    pub color: Option<ColorName>,
    /// Axis of the capture's world that points up: x, y, z, -x, -y, -z, or a direction between them as X,Y,Z [default: z]. Cameras
    /// and mesh are turned so that it is z in all that is written. COLMAP models need it: what is up in them is arbitrary. inspect
    /// tells which axis it probably is.
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<UpAxis>,
    /// Longest side of photographs, in pixels: larger ones, and their masks, are reduced by means over areas [default: none is; study real
    /// reduces them to 320, with --glance to 96, but with --full not].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..))]
    pub max_size: Option<u32>,
    /// Folder in which the photographs of a COLMAP model lie; it may be anywhere [default: images in the capture's folder].
    #[arg(long, value_name = "DIR")]
    pub images: Option<PathBuf>,
}

/// How stored values relate to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ColorName {
    /// In proportion.
    Linear,
    /// By the sRGB curve.
    Srgb,
}

impl ReadingArguments {
    /// What a capture is read by; `mesh` stands in for its own.
    pub fn options(&self, mesh: Option<&Path>) -> LoadOptions {
        LoadOptions {
            mesh: mesh.map(Path::to_path_buf),
            allow_outside: self.allow_outside,
            color_encoding: self.color.map(ColorName::encoding),
            up: self.up.unwrap_or_default(),
            max_size: self.max_size.map(|side| side as usize),
            images: self.images.clone(),
            ..LoadOptions::default()
        }
    }
}

impl ColorName {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Linear, Self::Srgb];

    /// The one that is typed so.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|color| color.name() == name)
    }

    /// As captures have it.
    pub fn encoding(self) -> ColorEncoding {
        match self {
            Self::Linear => ColorEncoding::Linear,
            Self::Srgb => ColorEncoding::Srgb,
        }
    }

    /// Of a capture's.
    pub fn of(encoding: ColorEncoding) -> Self {
        match encoding {
            ColorEncoding::Linear => Self::Linear,
            ColorEncoding::Srgb => Self::Srgb,
        }
    }

    /// As it is typed.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Srgb => "srgb",
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path};

    use clap::{Command, CommandFactory, error::ErrorKind};

    use super::Arguments;

    #[test]
    fn the_definition_is_consistent() {
        Arguments::command().debug_assert();
    }

    /// The lines of a text that call the program, without comments and without what a shell makes of the output.
    fn calls(text: &str) -> Vec<String> {
        let joined = text.replace("\\\n", " ");
        let call = |line: &str| {
            let line = line.trim_start();
            let by_cargo = line.strip_prefix("cargo run --release --locked -- ");
            let options = by_cargo.or_else(|| line.strip_prefix("eclipse "))?;
            let end = ["#", " > ", " | "].map(|end| options.find(end));
            let end = end.into_iter().flatten().min();
            Some(format!(
                "eclipse {}",
                &options[..end.unwrap_or(options.len())]
            ))
        };
        joined.lines().filter_map(call).collect()
    }

    /// What follows the help of a command and of all below it.
    fn examples(command: &Command) -> Vec<String> {
        let below = command.get_subcommands().flat_map(examples);
        let own = command.get_after_help().map(ToString::to_string);
        own.into_iter().chain(below).collect()
    }

    #[test]
    fn examples_of_the_help_are_not_broken_where_a_terminal_ends() {
        let texts = examples(&Arguments::command());
        // Prose begins a line, what is to be pasted is indented.
        let lines = texts.iter().flat_map(|text| text.lines());
        let pasted: Vec<&str> = lines.filter(|line| line.starts_with("  ")).collect();
        assert!(pasted.len() > 40, "{pasted:#?}");
        for line in pasted {
            let columns = line.chars().count();
            assert!(columns <= 78, "{columns} columns, split it by \\: {line}");
        }
    }

    #[test]
    fn every_call_that_help_and_documentation_show_is_understood() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut texts = examples(&Arguments::command());
        for file in [
            "README.md",
            "eclipse/docs/first_run.md",
            "eclipse/docs/when_it_fails.md",
            "eclipse/src/criticism/guide.md",
        ] {
            texts.push(fs::read_to_string(root.join(file)).expect("a file of the project"));
        }
        let calls: Vec<String> = texts.iter().flat_map(|text| calls(text)).collect();
        assert!(calls.len() > 60, "{calls:#?}");
        for call in calls {
            let parsed = Arguments::command().try_get_matches_from(call.split_whitespace());
            if let Err(error) = parsed
                && error.kind() != ErrorKind::DisplayHelp
            {
                panic!("{call}: {error}");
            }
        }
    }
}
