//! `eclipse study NAME` for the paper's experiments.

use std::{io::Write, path::PathBuf};

use clap::{Args, Subcommand};

use super::{Failure, Outcome, print};
use crate::studies::{self, Evidence, Scale, Study, page};

#[derive(Subcommand, Debug)]
pub(super) enum PaperStudy {
    /// Fig. 2: a matt sphere and a mirror that look the same, and an occluder that tells them apart.
    Ambiguity(PaperArguments),
    /// Fig. 3: singular values of what is observed, over the number of occluders.
    Conditioning(PaperArguments),
    /// Fig. S8 and S9: masks as waves, light as a pyramid.
    Theory(PaperArguments),
    /// Every experiment of the paper that is here, one after the other.
    All(PaperArguments),
}

#[derive(Args, Debug)]
pub(super) struct PaperArguments {
    /// What settles the claim in minutes [default].
    #[arg(long)]
    pub quick: bool,
    /// The paper's scale.
    #[arg(long, conflicts_with = "quick")]
    pub full: bool,
    /// Folder for a folder of each study.
    #[arg(long, value_name = "DIR", default_value = "out/studies")]
    pub out: PathBuf,
    /// Print JSON: one summary, or a list of them for `all`.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn run(
    study: &PaperStudy,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let (name, arguments) = match study {
        PaperStudy::Ambiguity(arguments) => ("ambiguity", arguments),
        PaperStudy::Conditioning(arguments) => ("conditioning", arguments),
        PaperStudy::Theory(arguments) => ("theory", arguments),
        PaperStudy::All(arguments) => return every(arguments, out, err),
    };
    let study = studies::by_name(name)
        .ok_or_else(|| Failure::failed(format!("there is no study called {name}")))?;
    let evidence = one(study, arguments, err)?;
    let text = if arguments.json {
        serde_json::to_string_pretty(&evidence.summary()).map_err(Failure::failed)? + "\n"
    } else {
        evidence.first_line() + "\n"
    };
    print(out, &text)?;
    Ok(Outcome::Done)
}

fn every(
    arguments: &PaperArguments,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let mut found = Vec::new();
    for study in studies::all() {
        let evidence = one(*study, arguments, err)?;
        if !arguments.json {
            print(
                out,
                &format!("{}: {}\n", evidence.name, evidence.first_line()),
            )?;
        }
        found.push(evidence);
    }
    if arguments.json {
        let summaries: Vec<_> = found.iter().map(Evidence::summary).collect();
        let text = serde_json::to_string_pretty(&summaries).map_err(Failure::failed)?;
        print(out, &(text + "\n"))?;
    }
    Ok(Outcome::Done)
}

/// Runs a study and writes its folder.
fn one(
    study: &dyn Study,
    arguments: &PaperArguments,
    err: &mut dyn Write,
) -> Result<Evidence, Failure> {
    let scale = if arguments.full {
        Scale::Full
    } else {
        Scale::Quick
    };
    let evidence = study.run(scale).map_err(Failure::failed)?;
    let folder = arguments.out.join(study.name());
    page::write(&folder, &evidence).map_err(Failure::failed)?;
    // A message that nobody reads is no failure.
    let _ = writeln!(err, "{}", folder.join(page::PAGE).display());
    Ok(evidence)
}
