//! `eclipse evaluate`.

use std::{io::Write, path::PathBuf};

use clap::{ArgGroup, Args};

use super::{Failure, Outcome, not_of_a_run, print};
use crate::{
    evaluate::{
        self, Evaluation,
        stanford_orb::{self, Scale, Split, StanfordOrbScore},
    },
    layout::ENVIRONMENT,
};

const EXAMPLES: &str = "Examples:
  eclipse evaluate out/potatoes --truth tests/captures/potatoes/truth --json

Stanford-ORB, new views in the recovered light, then in that of other scenes, whose maps the benchmark has in ground_truth:
  eclipse relight out/cup --environment out/cup/environment.exr \\
    --camera blender_HDR/cup_scene001/transforms_test.json \\
    --names-from-cameras --size 512x512 --out out/cup/views
  eclipse evaluate out/cup/views/test --stanford-orb blender_HDR/cup_scene001
  eclipse relight out/cup --environments ground_truth --axes camera \\
    --camera blender_HDR/cup_scene001/transforms_novel.json \\
    --names-from-cameras --size 512x512 --out out/cup/novel
  eclipse evaluate out/cup/novel --split novel \\
    --stanford-orb blender_HDR/cup_scene001

With --stanford-orb the folder holds a prediction a view, 512 x 512 pixels, by its name: 0003.exr (linear) or 0003.png (sRGB); for \
the novel split in a folder for each scene, such as cup_scene002/0003.exr.";

#[derive(Args, Debug)]
#[command(
    after_help = EXAMPLES,
    group = ArgGroup::new("against").args(["truth", "stanford_orb"]).required(true)
)]
pub(super) struct EvaluateArguments {
    /// Folder that reconstruct wrote; with --stanford-orb, of predicted views.
    pub folder: PathBuf,
    /// Folder with the truth, or capture with a folder truth: environment.exr, occluders.exr, albedo_NNN.exr, truth.json, as far as
    /// known.
    #[arg(long, value_name = "DIR")]
    pub truth: Option<PathBuf>,
    /// Scores by the scripts of Stanford-ORB: PSNR-H, PSNR-L and SSIM against a scene of blender_HDR.
    #[arg(long, value_name = "SCENE")]
    pub stanford_orb: Option<PathBuf>,
    /// Views of the scene: train, test (the same light) or novel (other light).
    #[arg(
        long,
        value_name = "SPLIT",
        default_value = "test",
        requires = "stanford_orb",
        conflicts_with = "truth"
    )]
    pub split: Split,
    /// Do not scale the channels of predictions first.
    #[arg(long, requires = "stanford_orb", conflicts_with = "truth")]
    pub unscaled: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

pub(super) fn run(arguments: &EvaluateArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    let text = match (&arguments.truth, &arguments.stanford_orb) {
        (_, Some(scene)) => {
            let scale = if arguments.unscaled {
                Scale::None
            } else {
                Scale::Best
            };
            let score = stanford_orb::score(&arguments.folder, scene, arguments.split, scale);
            let score = score.map_err(Failure::bad_input)?;
            if arguments.json {
                serde_json::to_string_pretty(&score).map_err(Failure::failed)? + "\n"
            } else {
                views(&score)
            }
        }
        (Some(truth), None) => {
            let evaluation = evaluate::evaluate(&arguments.folder, truth).map_err(|error| {
                // What is wrong with the truth says nothing of the run.
                let missing = !arguments.folder.join(ENVIRONMENT).is_file();
                not_of_a_run("evaluate", &arguments.folder, error, missing)
            })?;
            if arguments.json {
                serde_json::to_string_pretty(&evaluation).map_err(Failure::failed)? + "\n"
            } else {
                table(&evaluation)
            }
        }
        (None, None) => {
            return Err(Failure {
                outcome: Outcome::Usage,
                message: "give --truth or --stanford-orb".to_owned(),
            });
        }
    };
    print(out, &text)?;
    Ok(Outcome::Done)
}

/// A line a view, the mean last.
fn views(score: &StanfordOrbScore) -> String {
    let width = score.views.iter().map(|(name, _)| name.len()).max();
    let width = width.unwrap_or(0).max("mean".len());
    let mut text = format!("{:width$}   PSNR-H   PSNR-L     SSIM\n", "view");
    let mean = ("mean".to_owned(), score.mean);
    for (name, s) in score.views.iter().chain([&mean]) {
        text += &format!(
            "{name:width$} {:>8.3} {:>8.3} {:>8.4}\n",
            s.psnr_h, s.psnr_l, s.ssim
        );
    }
    text
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
