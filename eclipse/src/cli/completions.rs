//! `eclipse completions`.

use std::io::Write;

use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};

use super::{Failure, Outcome, arguments::Arguments, print};

const COMPLETIONS_EXAMPLES: &str = "Examples:
  eclipse completions bash \\
    > ~/.local/share/bash-completion/completions/eclipse
  eclipse completions zsh > ~/.zfunc/_eclipse
  eclipse completions fish > ~/.config/fish/completions/eclipse.fish";

#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS_EXAMPLES)]
pub(super) struct CompletionsArguments {
    /// Shell that the script is for.
    #[arg(value_enum)]
    pub shell: Shell,
}

pub(super) fn run(
    arguments: &CompletionsArguments,
    out: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let mut script = Vec::new();
    generate(
        arguments.shell,
        &mut Arguments::command(),
        "eclipse",
        &mut script,
    );
    print(out, &String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
