//! `eclipse relight`.

use std::{
    io::Write,
    path::{Path, PathBuf},
    sync::atomic::Ordering,
};

use clap::{ArgGroup, Args};
use render::{camera::Camera, convention::Convention, environment::EnvironmentMap};

use super::{
    Failure, Outcome, not_of_a_run, print,
    shown::{self, ProgressArguments},
    stop_on_interrupt, units,
};
use crate::{
    capture::{MAX_PICTURE_SIDE, UpAxis, read_cameras},
    image_io::{Clamped, EnvironmentOptions, Rows, read_foreign_environment},
    layout,
    progress::PictureDisplay,
    relight::{
        self, Axes, Folder, Lights, Object, Orbit, Quality, Record, RelightError, Stage, View,
        evenly, frame_names, number,
    },
    wording::counted,
};

/// Rows that a light's map is averaged to when it has more: a texel is then a sixth of a degree, a third of the sun.
const MOST_ROWS: usize = 1024;
/// Pixels across and down, of an orbit for which no size is asked.
const SIZE: [usize; 2] = [512, 512];
/// Pictures of an orbit for which no number is asked.
const ORBIT_FRAMES: u16 = 24;

const EXAMPLES: &str = "Examples:
  eclipse relight out/mine --environment studio.exr
  eclipse relight out/mine --environment sunset.hdr --frames 1 --azimuth 30 \\
    --exposure 1 --backdrop
  eclipse relight out/mine --environment out/other/environment.exr \\
    --rotate 90 --size 1024x768 --out out/turntable
  # from where four of its photographs were taken:
  eclipse relight out/mine --environment studio.exr --camera my-capture \\
    --frames 4
  # with the --up that reconstruct was told:
  eclipse relight out/colmap --environment studio.exr --camera my-colmap
  # Stanford-ORB; see eclipse evaluate --help:
  eclipse relight out/cup --environments ground_truth --axes camera \\
    --camera blender_HDR/cup_scene001/transforms_novel.json \\
    --names-from-cameras --size 512x512 --out out/cup/novel

The pictures are NNN.exr (linear, RGBA, colours multiplied by the coverage) and NNN.png (sRGB), in --out or else in DIR/relit. With --names-from-cameras \
they are called as the file's frames: as `file_path` without its extension, folders included; as scene_name/file where a frame has a \
`scene_name`. --environments takes the map of the frame a/b from DIR/a/b.exr (or .hdr, .png, .jpg) or DIR/a/env_map/b.exr.";

#[derive(Args, Debug)]
#[command(
    after_help = EXAMPLES,
    group = ArgGroup::new("light").args(["environment", "environments"]).required(true)
)]
pub(super) struct RelightArguments {
    /// Folder that reconstruct wrote.
    pub folder: PathBuf,
    /// Light from all directions, an equirectangular EXR, HDR, PNG or JPEG. Negative light counts as none, infinite light as the most of
    /// half precision (65504), and it is said of how many texels.
    #[arg(long, value_name = "FILE")]
    pub environment: Option<PathBuf>,
    /// A map for each picture, by the name of its frame.
    #[arg(long, value_name = "DIR")]
    pub environments: Option<PathBuf>,
    /// What the light's directions are told in: world, or camera, the axes of each view (x right, y up, z backwards).
    #[arg(long, value_name = "world|camera", default_value = "world")]
    pub axes: Axes,
    /// How the environment is laid out: blender, mitsuba, openexr, threejs or skylibs [default: what the file says, else blender;
    /// with --axes camera skylibs].
    #[arg(long, value_name = "NAME")]
    pub convention: Option<Convention>,
    /// Cameras: `orbit`, a circle around the object, or those of a transforms.json or of a capture's folder, COLMAP's too, in the frame
    /// of the object.
    #[arg(long, value_name = "orbit|PATH", default_value = "orbit")]
    pub camera: PathBuf,
    /// Axis of the world of those cameras, not of an orbit, that points up: x, y, z, -x, -y, -z or a direction as X,Y,Z [default: what reconstruct was
    /// told, as of the capture's own cameras; z is that of the world in which results are written].
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<UpAxis>,
    /// Let the cameras' capture name files outside its folder, as reconstruct may have been: for captures that you trust.
    #[arg(long)]
    pub allow_outside: bool,
    /// Call the pictures as the cameras' file or capture calls its frames, folders included.
    #[arg(long)]
    pub names_from_cameras: bool,
    /// Pictures: of an orbit [default: 24], or so many of those cameras, evenly spread [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    pub frames: Option<u16>,
    /// Height of the orbit above the horizon, in degrees.
    #[arg(long, value_name = "DEG", default_value_t = 20.0, allow_negative_numbers = true, value_parser = elevation)]
    pub elevation: f32,
    /// Where the orbit begins, in degrees from +x towards +y.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true, value_parser = degrees)]
    pub azimuth: f32,
    /// Distance of the orbit in bounding radii of the object.
    #[arg(long, value_name = "D", default_value_t = 5.0, allow_negative_numbers = true, value_parser = units::distance)]
    pub distance: f32,
    /// Exposure of the light, in stops.
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_negative_numbers = true, value_parser = exposure)]
    pub exposure: f32,
    /// Turns the light about the vertical axis, in degrees, counter-clockwise seen from above.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true, value_parser = degrees)]
    pub rotate: f32,
    /// Pixels across and down [default: 512x512, or those of the cameras].
    #[arg(long, value_name = "WxH", allow_hyphen_values = true, value_parser = size)]
    pub size: Option<[usize; 2]>,
    /// Light paths a pixel: four times as many, half the noise.
    #[arg(long, value_name = "N", default_value_t = 256, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub samples: u32,
    /// Shows the environment beside the object.
    #[arg(long)]
    pub backdrop: bool,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = units::at_least::<0>)]
    pub seed: u64,
    /// Threads; results do not depend on it [default: all].
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Folder for the pictures, new or of earlier ones [default: DIR/relit].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub progress: ProgressArguments,
}

pub(super) fn run(arguments: &RelightArguments, out: &mut dyn Write) -> Result<Outcome, Failure> {
    arguments.check_orbit()?;
    let object = Object::read(&arguments.folder).map_err(|error| {
        let missing = matches!(error, RelightError::Object { .. });
        not_of_a_run("relight", &arguments.folder, error, missing)
    })?;
    let views = arguments.views(&object)?;
    let (light, clamped, lights) = arguments.light(&views).map_err(Failure::bad_input)?;
    let style = arguments.progress.style(false);
    let tell = |clamped: &Clamped| shown::warn(style, &format!("note: {clamped}"));
    clamped.iter().for_each(tell);
    let record = Record {
        object: arguments.folder.clone(),
        environment: arguments.light_path().to_owned(),
        axes: arguments.axes.name(),
        convention: arguments.convention.map(Convention::name),
        exposure: arguments.exposure,
        rotate: arguments.rotate,
        backdrop: arguments.backdrop,
        samples: arguments.samples as usize,
        seed: arguments.seed,
        pictures: views.iter().map(|view| view.name.clone()).collect(),
        cameras: views
            .iter()
            .map(|view| relight::pose_rows(&view.camera, object.centre))
            .collect(),
    };
    let stage = Stage::new(object, light, arguments.exposure);
    let mut stage = stage.map_err(Failure::bad_input)?;
    let path = arguments.out();
    let folder = Folder::prepare(&path, &record).map_err(Failure::failed)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads.map_or(0, usize::from))
        .build();
    let pool = pool.map_err(|error| Failure::failed(format!("cannot start threads: {error}")))?;
    let stop = stop_on_interrupt()?;
    let display = PictureDisplay::new(views.len(), style);
    let progress = |index: usize, share: f32| {
        display.update(index, share);
        !stop.load(Ordering::Relaxed)
    };
    let quality = arguments.quality();
    let lights = lights.as_ref();
    let done =
        pool.install(|| relight::relight(&mut stage, &views, lights, &quality, &folder, &progress));
    display.finish();
    match done {
        Err(error @ RelightError::Stopped) => Err(Failure {
            outcome: Outcome::Interrupted,
            message: error.to_string(),
        }),
        // The map of a later view.
        Err(error @ (RelightError::Light(_) | RelightError::Exposure(_))) => {
            Err(Failure::bad_input(error))
        }
        done => {
            let later = done.map_err(Failure::failed)?;
            // That of the first view was told before.
            let later = later
                .iter()
                .filter(|later| Some(*later) != clamped.as_ref());
            later.for_each(tell);
            let pictures = counted(views.len(), "picture");
            print(out, &format!("wrote {pictures} to {}\n", path.display()))?;
            Ok(Outcome::Done)
        }
    }
}

impl RelightArguments {
    fn is_orbit(&self) -> bool {
        self.camera == Path::new("orbit")
    }

    /// Refuses what an orbit has no use for.
    fn check_orbit(&self) -> Result<(), Failure> {
        if !self.is_orbit() {
            return Ok(());
        }
        let message = if self.names_from_cameras {
            "--names-from-cameras takes the names of a file: name it with --camera"
        } else if self.up.is_some() {
            "--up is of the cameras that --camera names: an orbit goes around the z axis of the world in which results are written, \
             which points up whatever reconstruct was told; leave it out, or add --camera PATH"
        } else {
            return Ok(());
        };
        Err(Failure {
            outcome: Outcome::Usage,
            message: message.to_owned(),
        })
    }

    /// What is to be seen, with the names of the pictures.
    fn views(&self, object: &Object) -> Result<Vec<View>, Failure> {
        let count = self.frames.map(usize::from);
        // A file whose names nobody needs may have any.
        let named = self.names_from_cameras || self.environments.is_some();
        let frames = match named && !self.is_orbit() {
            true => {
                let names = frame_names(&self.camera, self.allow_outside);
                Some(evenly(names.map_err(Failure::bad_input)?, count))
            }
            false => None,
        };
        let cameras = if self.is_orbit() {
            self.orbit(object)
        } else {
            let up = self.up()?;
            let cameras = read_cameras(&self.camera, self.size, self.allow_outside);
            let cameras = cameras.map_err(Failure::bad_input)?.into_iter();
            let cameras = cameras.map(|(_, camera)| up.turned(camera)).collect();
            relight::recentred(object, evenly(cameras, count)).map_err(Failure::bad_input)?
        };
        let view = |(index, camera): (usize, Camera)| {
            let frame = frames.as_ref().and_then(|frames| frames.get(index));
            let frame = frame.map_or_else(|| number(index), String::clone);
            let name = match self.names_from_cameras {
                true => frame.clone(),
                false => number(index),
            };
            View {
                name,
                frame,
                camera,
            }
        };
        Ok(cameras.into_iter().enumerate().map(view).collect())
    }

    /// Which axis of the cameras' world points up: as asked, or as the run read its capture.
    fn up(&self) -> Result<UpAxis, Failure> {
        if let Some(up) = self.up {
            return Ok(up);
        }
        let reading = relight::reading(&self.folder).map_err(Failure::bad_input)?;
        let Some(name) = reading.up else {
            return Ok(UpAxis::default());
        };
        name.parse::<UpAxis>().map_err(|expected| {
            let path = self.folder.join(layout::SETTINGS);
            Failure::bad_input(format!(
                "{}: `reading.up` is {name:?}; {expected}: correct it, or give --up",
                path.display()
            ))
        })
    }

    /// Cameras on a circle.
    fn orbit(&self, object: &Object) -> Vec<Camera> {
        let orbit = Orbit {
            frames: usize::from(self.frames.unwrap_or(ORBIT_FRAMES)),
            size: self.size.unwrap_or(SIZE),
            elevation: self.elevation,
            azimuth: self.azimuth,
            distance: self.distance,
        };
        orbit.cameras(object.mesh.bounding_radius())
    }

    /// The light of the first view, with what was changed of its map, and the light of each where they differ.
    fn light(
        &self,
        views: &[View],
    ) -> Result<(EnvironmentMap, Option<Clamped>, Option<Lights>), RelightError> {
        let options = EnvironmentOptions {
            convention: self.convention,
            rotate: self.rotate,
            rows: Rows::AtMost(MOST_ROWS),
        };
        let path = self.light_path();
        let lights = match (&self.environments, self.axes) {
            (Some(_), axes) => Lights::of_each(path, views, options, axes)?,
            (None, Axes::Camera) => Lights::of_one(path, views, options, Axes::Camera),
            (None, Axes::World) => {
                let (light, clamped) = read_foreign_environment(path, &options)?;
                return Ok((light, clamped, None));
            }
        };
        // Before a folder is made for the pictures.
        let (first, clamped) = lights.read(0, &views[0].camera)?;
        Ok((first, clamped, Some(lights)))
    }

    /// The file of the light, or the folder of all.
    fn light_path(&self) -> &Path {
        let given = self.environments.as_ref().or(self.environment.as_ref());
        // One of the two is required.
        given.map_or(Path::new(""), PathBuf::as_path)
    }

    fn quality(&self) -> Quality {
        Quality {
            samples: self.samples as usize,
            seed: self.seed,
            backdrop: self.backdrop,
        }
    }

    fn out(&self) -> PathBuf {
        self.out
            .clone()
            .unwrap_or_else(|| self.folder.join("relit"))
    }
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let possible = 1..=MAX_PICTURE_SIDE;
    let side = |text: &str| text.parse().ok().filter(|side| possible.contains(side));
    let sides = text.split_once(['x', 'X', '×']);
    sides
        .and_then(|(width, height)| Some([side(width)?, side(height)?]))
        .ok_or_else(|| {
            format!(
                "`{text}` is not a size; write for example 800x600, each from 1 to {MAX_PICTURE_SIDE}"
            )
        })
}

fn elevation(text: &str) -> Result<f32, String> {
    units::number(text, -90.0, 90.0)
}

fn degrees(text: &str) -> Result<f32, String> {
    units::number(text, -360.0, 360.0)
}

fn exposure(text: &str) -> Result<f32, String> {
    units::number(text, -30.0, 30.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(size("800x600"), Ok([800, 600]));
        for text in ["", "800", "x600", "0x600", "800x600x3", "9000x1", "-1x2"] {
            assert!(size(text).is_err(), "{text}");
        }
    }
}
