//! `eclipse man`.

use std::io::Write;

use clap::{Args, Command, CommandFactory};
use clap_mangen::Man;

use super::{Failure, Outcome, arguments::Arguments, print};

const MAN_EXAMPLES: &str = "Examples:
  eclipse man > ~/.local/share/man/man1/eclipse.1
  eclipse man | man -l -";

#[derive(Args, Debug)]
#[command(after_help = MAN_EXAMPLES)]
pub(super) struct ManArguments {}

/// Prints one page: the program, then every command with its options.
pub(super) fn run(out: &mut dyn Write) -> Result<Outcome, Failure> {
    let page = page().map_err(Failure::failed)?;
    print(out, &String::from_utf8_lossy(&page))?;
    Ok(Outcome::Done)
}

fn page() -> std::io::Result<Vec<u8>> {
    // The pages of single commands that clap would refer to do not exist: their options follow on the same page.
    let mut root = Arguments::command().disable_help_subcommand(true);
    root.build();
    let man = Man::new(root.clone());
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    commands(&root, &mut page)?;
    page.extend(extra(&man, "EXIT STATUS")?);
    man.render_version_section(&mut page)?;
    Ok(page)
}

/// What follows the help, under a title that says what it is.
fn extra(man: &Man, title: &str) -> std::io::Result<Vec<u8>> {
    let mut section = Vec::new();
    man.render_extra_section(&mut section)?;
    let section = String::from_utf8_lossy(&section);
    // The title stands for the first word.
    let titled = section.replace(".SH EXTRA\n", &format!(".SH \"{title}\"\n"));
    Ok(titled
        .replace("\nExamples:\n", "\n")
        .replace("\nExample:\n", "\n")
        .into_bytes())
}

/// A section a command, those of commands with commands below them included.
fn commands(command: &Command, page: &mut Vec<u8>) -> std::io::Result<()> {
    for command in command.get_subcommands() {
        let name = command.get_bin_name().unwrap_or(command.get_name());
        writeln!(page, ".SH \"{}\"", name.to_uppercase())?;
        let man = Man::new(command.clone());
        let mut sections = Vec::new();
        man.render_synopsis_section(&mut sections)?;
        man.render_description_section(&mut sections)?;
        if command.get_arguments().next().is_some() {
            man.render_options_section(&mut sections)?;
        }
        if command.get_after_help().is_some() {
            sections.extend(extra(&man, "EXAMPLES")?);
        }
        // Sections of a command are subsections of the page.
        let sections = String::from_utf8_lossy(&sections).replace("\n.SH ", "\n.SS ");
        page.extend(sections.bytes());
        commands(command, page)?;
    }
    Ok(())
}
