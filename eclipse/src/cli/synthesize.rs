//! `eclipse synthesize`.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use render::{bsdf::Model, convention::Convention, image::Image};

use super::{
    Failure, Outcome, print,
    shown::{self, ProgressArguments},
    stop_on_interrupt, units,
};
use crate::{
    capture,
    files::lock::Lock,
    image_io::{ColorEncoding, EnvironmentOptions, Rows, read_foreign_environment, read_image},
    mesh_io::read_mesh,
    progress::{PictureDisplay, Style},
    synthesize::{self, Occluders, Pattern, Scene, Shooting, SynthesizeError},
};

/// Rows of the environment that a capture is lit by and scored against.
const ENVIRONMENT_ROWS: usize = 50;

const EXAMPLES: &str = "Example:
  eclipse synthesize --mesh bunny.obj --environment sky.exr --operator \\
    --out my-capture
  eclipse reconstruct my-capture --out out/mine
  eclipse evaluate out/mine --truth my-capture/truth";

#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct SynthesizeArguments {
    /// The object: glTF, OBJ or PLY.
    #[arg(long, value_name = "FILE")]
    pub mesh: PathBuf,
    /// Light from all directions, an equirectangular EXR, HDR, PNG or JPEG.
    #[arg(long, value_name = "FILE")]
    pub environment: PathBuf,
    /// New folder for the capture; the truth goes to its folder `truth`.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How the environment is laid out: blender, mitsuba, openexr, threejs or skylibs [default: what the file says, else blender].
    #[arg(long, value_name = "NAME")]
    pub convention: Option<Convention>,
    /// Reflectance.
    #[arg(long, value_enum, default_value_t = Bsdf::Ggx)]
    pub bsdf: Bsdf,
    /// Mean albedo, linear R,G,B between 0 and 1.
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', num_args = 1, default_value = "0.5,0.45,0.4", allow_hyphen_values = true, value_parser = share)]
    pub albedo: Vec<f32>,
    /// How far smooth patches depart from the mean albedo.
    #[arg(long, value_name = "V", default_value_t = 0.25, allow_hyphen_values = true, value_parser = share)]
    pub variation: f32,
    /// Roughness α of the GGX lobe.
    #[arg(long, default_value_t = 0.6, allow_hyphen_values = true, value_parser = share)]
    pub alpha: f32,
    /// Specular reflectance κ at normal incidence.
    #[arg(long, default_value_t = 0.04, allow_hyphen_values = true, value_parser = share)]
    pub kappa: f32,
    /// A person stands behind each camera.
    #[arg(long, conflicts_with = "occluders")]
    pub operator: bool,
    /// Masks, one below the other, twice as wide as high: 1 where light passes.
    #[arg(long, value_name = "FILE")]
    pub occluders: Option<PathBuf>,
    /// Photographs.
    #[arg(long, value_name = "N", default_value_t = 24, allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub frames: u16,
    /// Pixels across and down.
    #[arg(long, value_name = "N", default_value_t = 128, allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(8..=4096))]
    pub resolution: u16,
    /// Distance of the cameras in bounding radii of the object.
    #[arg(long, value_name = "D", default_value_t = 5.0, allow_negative_numbers = true, value_parser = units::distance)]
    pub distance: f32,
    /// Standard deviation of the sensor's noise at a value of ¾.
    #[arg(long, value_name = "S", default_value_t = 0.004, allow_hyphen_values = true, value_parser = share)]
    pub noise: f32,
    /// Seed of the noise.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = units::at_least::<0>)]
    pub seed: u64,
    #[command(flatten)]
    pub progress: ProgressArguments,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum Bsdf {
    Ggx,
    Lambert,
}

pub(super) fn run(
    arguments: &SynthesizeArguments,
    out: &mut dyn Write,
) -> Result<Outcome, Failure> {
    let _lock = Lock::beside(&arguments.out).map_err(Failure::failed)?;
    capture::vacant(&arguments.out).map_err(Failure::failed)?;
    let style = arguments.progress.style(false);
    let scene = Scene {
        mesh: read_mesh(&arguments.mesh).map_err(Failure::bad_input)?,
        environment: environment(&arguments.environment, arguments.convention, style)?,
        model: match arguments.bsdf {
            Bsdf::Ggx => Model::Microfacet,
            Bsdf::Lambert => Model::Lambertian,
        },
        albedo: Pattern {
            mean: albedo(&arguments.albedo)?,
            variation: arguments.variation,
        },
        alpha: arguments.alpha,
        kappa: arguments.kappa,
        occluders: match &arguments.occluders {
            Some(path) => Occluders::Masks(masks(path)?),
            None if arguments.operator => Occluders::Operator,
            None => Occluders::None,
        },
    };
    let shooting = Shooting {
        frames: usize::from(arguments.frames),
        resolution: usize::from(arguments.resolution),
        distance: arguments.distance,
        noise: arguments.noise,
        seed: arguments.seed,
    };
    let stop = stop_on_interrupt()?;
    let display = PictureDisplay::new(shooting.frames, style);
    let progress = |frame: usize| {
        display.update(frame, 0.0);
        !stop.load(std::sync::atomic::Ordering::Relaxed)
    };
    let made = synthesize::synthesize(&scene, &shooting, progress);
    display.finish();
    let made = match made {
        Err(error @ SynthesizeError::Stopped) => {
            return Err(Failure {
                outcome: Outcome::Interrupted,
                message: error.to_string(),
            });
        }
        made => made.map_err(Failure::bad_input)?,
    };
    synthesize::write(&arguments.out, &scene, &made).map_err(Failure::failed)?;
    print(out, &format!("wrote {}\n", arguments.out.display()))?;
    Ok(Outcome::Done)
}

/// The environment in our convention, averaged onto the grid that reconstructions use.
fn environment(
    path: &Path,
    convention: Option<Convention>,
    style: Style,
) -> Result<Image, Failure> {
    let options = EnvironmentOptions {
        convention,
        rows: Rows::Exactly(ENVIRONMENT_ROWS),
        ..Default::default()
    };
    let read = read_foreign_environment(path, &options);
    let (map, clamped) = read.map_err(Failure::bad_input)?;
    if let Some(clamped) = clamped {
        shown::warn(style, &format!("note: {clamped}"));
    }
    Ok(map.image().clone())
}

/// Maps stacked one below the other.
fn masks(path: &Path) -> Result<Vec<Image>, Failure> {
    // Masks are shares of light, not light: no curve applies.
    let stack = read_image(path, Some(ColorEncoding::Linear)).map_err(Failure::bad_input)?;
    let height = stack.width / 2;
    if height == 0 || !stack.height.is_multiple_of(height) {
        let (width, height) = (stack.width, stack.height);
        return Err(Failure::bad_input(format!(
            "{} is {width} × {height}; expected maps twice as wide as high, stacked one below the other",
            path.display()
        )));
    }
    let maps = stack
        .data
        .chunks_exact(height * stack.width * stack.channels);
    let first = |map: &[f32]| {
        map.iter()
            .step_by(stack.channels)
            .map(|v| v.clamp(0.0, 1.0))
            .collect()
    };
    Ok(maps
        .map(|map| Image {
            width: stack.width,
            height,
            channels: 1,
            data: first(map),
        })
        .collect())
}

fn albedo(values: &[f32]) -> Result<[f32; 3], Failure> {
    values.try_into().map_err(|_| Failure {
        outcome: Outcome::Usage,
        message: format!("--albedo needs three numbers R,G,B, not {}", values.len()),
    })
}

fn share(text: &str) -> Result<f32, String> {
    units::number(text, 0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_io::write_png8;

    #[test]
    fn masks_are_shares_of_light_in_any_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("masks.png");
        let mut stack = Image::filled(4, 4, 1, 1.0);
        stack.data[..8].fill(0.2);
        write_png8(&path, &stack).unwrap();
        let Ok(maps) = masks(&path) else {
            panic!("two masks of 4 × 2 were expected");
        };
        assert_eq!(maps.len(), 2);
        assert_eq!(maps[0].data, [0.2; 8]);
        assert_eq!(maps[1].data, [1.0; 8]);
    }
}
