//! `eclipse evaluate`.

use std::{io::Write, path::PathBuf};

use clap::Args;

use super::{Failure, Outcome, print};
use crate::evaluate::{self, Evaluation};

#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  eclipse evaluate out/potatoes --truth tests/captures/potatoes/truth --json"
)]
pub(super) struct EvaluateArguments {
    /// Folder that reconstruct wrote.
    pub folder: PathBuf,
    /// Folder with the truth: environment.exr, occluders.exr, albedo_NNN.exr, truth.json, as far as known.
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn run(arguments: &EvaluateArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    let evaluation =
        evaluate::evaluate(&arguments.folder, &arguments.truth).map_err(Failure::bad_input)?;
    let text = if arguments.json {
        serde_json::to_string_pretty(&evaluation).map_err(Failure::failed)? + "\n"
    } else {
        table(&evaluation)
    };
    print(out, &text)?;
    Ok(Outcome::Done)
}

/// The scores for people, better ones told by the arrow's direction.
fn table(evaluation: &Evaluation) -> String {
    let Evaluation {
        environment,
        albedo,
        materials,
        occluders,
        photometric,
    } = evaluation;
    let rows = [
        (
            "environment  relative RMSE, aligned       ↓",
            environment.texels.relative_rmse_aligned,
        ),
        (
            "             … by solid angle             ↓",
            environment.solid_angle.relative_rmse_aligned,
        ),
        (
            "albedo       PSNR, aligned (dB)           ↑",
            albedo.psnr_aligned,
        ),
        (
            "materials    RMS error of α               ↓",
            materials.alpha_rmse,
        ),
        (
            "             RMS error of κ               ↓",
            materials.kappa_rmse,
        ),
        (
            "occluders    energy-weighted error        ↓",
            occluders.energy_weighted_error,
        ),
        ("             intersection over union      ↑", occluders.iou),
        (
            "photographs  PSNR (dB)                    ↑",
            photometric.psnr,
        ),
        (
            "             PSNR, held out (dB)          ↑",
            photometric.psnr_held_out,
        ),
    ];
    let row = |(name, value): (&str, Option<f64>)| {
        let value = value.map_or("–".to_owned(), |value| format!("{value:.3}"));
        format!("{name} {value:>9}\n")
    };
    rows.into_iter().map(row).collect()
}
