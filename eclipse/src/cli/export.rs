//! `eclipse export`.

use std::{io::Write, path::PathBuf};

use clap::Args;

use super::{Failure, Outcome, not_of_a_run, print};
use crate::{
    export::{self, ExportError, Program},
    layout::ENVIRONMENT,
    relight::RelightError,
};

const EXAMPLES: &str = "Examples:
  eclipse export out/mine --for blender
  eclipse export out/mine --for mitsuba --out scenes/mine
  eclipse export out/mine --for threejs

Each leaves the light (environment.exr) in the program's own layout, so that it loads unrotated, the object with its materials \
(mesh.glb, KHR_materials_specular; for Mitsuba mesh.ply too) and a small scene: scene.py, scene.xml or index.html.";

#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct ExportArguments {
    /// Folder that reconstruct wrote.
    pub folder: PathBuf,
    /// The program: blender, mitsuba or threejs.
    #[arg(long = "for", value_name = "PROGRAM")]
    pub program: Program,
    /// Folder for the files, new or of an earlier export [default: DIR/<program>].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

pub(super) fn run(arguments: &ExportArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    let program = arguments.program;
    let own = || arguments.folder.join(program.name());
    let folder = arguments.out.clone().unwrap_or_else(own);
    export::export(&arguments.folder, program, &folder).map_err(|error| match error {
        ExportError::Object(_) | ExportError::Light(_) | ExportError::Read { .. } => {
            let missing = matches!(&error, ExportError::Object(RelightError::Object { .. }))
                || !arguments.folder.join(ENVIRONMENT).is_file();
            not_of_a_run("export", &arguments.folder, error, missing)
        }
        _ => Failure::failed(error),
    })?;
    let scene = folder.join(program.scene());
    print(out, &format!("wrote {}\n", scene.display()))?;
    Ok(Outcome::Done)
}
